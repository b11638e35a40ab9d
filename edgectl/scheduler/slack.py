"""Slack (ADR 0061): by how much the load of a host may exceed its capacity before a task must leave."""

from edgectl.model.resource import Resource

# Shares of the capacity. Too little CPU or network makes a task slower; too little memory ends it.
COMPRESSIBLE_SLACK, MEMORY_SLACK = 0.05, 0.02


def get_slack(resource: Resource) -> float:
    """The share of its capacity by which ``resource`` may be exceeded."""
    return COMPRESSIBLE_SLACK if resource.compressible else MEMORY_SLACK
