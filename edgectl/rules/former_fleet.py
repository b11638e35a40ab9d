# SPDX-License-Identifier: Apache-2.0
"""Tasks that a fleet without a stated name would start beside itself, because it had another name before."""

from collections.abc import Iterable

from edgectl.dataclass import dataclass
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Step
from edgectl.model.snapshot import Snapshot
from edgectl.names import natural_key


@dataclass(frozen=True, slots=True, kw_only=True)
class FormerFleet:
    """The ``fleet`` of which ``host`` runs ``tasks`` that a plan would start once more."""

    fleet: str
    host: str
    tasks: tuple[str, ...]

    @property
    def message(self) -> str:
        """Why the plan is not to be carried out."""
        named = ", ".join(self.tasks)
        return (
            f"{self.host} runs {named} of fleet {self.fleet}, started by you; no fleet is stated here: "
            f"{'it' if len(self.tasks) == 1 else 'they'} would be started a second time"
        )

    @property
    def hint(self) -> str:
        """The line that mends it."""
        return f"add fleet: {self.fleet} to the inventory; if that is another fleet, add a name of its own"


def find_former_fleet(
    inventory: Inventory, steps: Iterable[Step], snapshot: Snapshot, manager: str
) -> FormerFleet | None:
    """The fleet that this one seems to have been until its file was renamed, or until the one of several
    files that stated the name was left out.

    Only for a fleet whose name is derived from a path, and tasks that ``manager`` (user and machine) started:
    whoever states a name says that the fleets are two.
    """
    if inventory.is_fleet_named:
        return None
    started = {step.task for step in steps if step.action is Action.START}
    for name in sorted(snapshot.hosts, key=natural_key):
        theirs = [
            each
            for each in snapshot.hosts[name].foreign_tasks
            if each.task in started and each.fleet and each.started_by == manager
        ]
        if theirs:
            tasks = {each.task for each in theirs if each.fleet == theirs[0].fleet}
            return FormerFleet(fleet=theirs[0].fleet, host=name, tasks=tuple(sorted(tasks, key=natural_key)))
    return None
