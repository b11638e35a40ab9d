"""What stands beside a model's columns: what was published of the real thing."""

from edgectl.model.evidence import Reality
from edgectl.model.scenario import Scenario


def published(scenario: Scenario) -> Reality:
    """What the scenario's file quotes."""
    return Reality(word="published", figures=scenario.published)
