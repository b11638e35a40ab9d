"""Why a command that was told to be quiet does not end with 0: one line per host or task."""

import dataclasses
from collections.abc import Collection

from edgectl.model.plan import Action, Plan
from edgectl.model.snapshot import Snapshot
from edgectl.views.reasons import reason
from edgectl.views.sections import silent
from edgectl.views.text import harmless


def unanswered(value: Snapshot, names: Collection[str]) -> str:
    """The hosts of ``names``, each with its cause, what mends it and how long it has been silent."""
    hosts = {name: host for name, host in value.hosts.items() if name in names}
    return "".join(f"{harmless(line)}\n" for line in silent(dataclasses.replace(value, hosts=hosts)))


def unplaced(value: Plan) -> str:
    """The tasks that have no host."""
    return "".join(f"{harmless(f'{step.task}: {reason(step)}')}\n" for step in value.steps if step.action is Action.UNPLACED)
