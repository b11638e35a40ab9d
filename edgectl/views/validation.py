# SPDX-License-Identifier: Apache-2.0
"""The contents of an inventory and task files without faults, and the versions of the program."""

from collections.abc import Mapping

from edgectl.formats.document import Document
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from edgectl.views.output import ItemView
from edgectl.views.output_format import ITEM_FORMATS, VALIDATION_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, render_columns, style_text


class ValidationView(ItemView):
    """Hosts and tasks of valid files."""

    kind = "validation"
    formats = VALIDATION_FORMATS

    def __init__(self, inventory: Inventory, tasks: Tasks) -> None:
        self._inventory, self._tasks = inventory, tasks

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line of counts."""
        return style_text("ok:", "good", look) + f" {self._count_contents()}\n"

    def _count_contents(self) -> str:
        inventory, tasks = self._inventory, self._tasks.tasks
        sizes = {"edge": len(inventory.edges), "robot": len(inventory.robots), "task": len(tasks)}
        counts = [f"{count} {noun}{'' if count == 1 else 's'}" for noun, count in sizes.items()]
        unmanaged = sum(not task.managed for task in tasks.values())
        return ", ".join([*counts, *([f"{unmanaged} not managed"] if unmanaged else [])])

    def item(self) -> Document:
        """The names and the digests."""
        return {
            "edge_names": [host.name for host in self._inventory.edges],
            "robot_names": [host.name for host in self._inventory.robots],
            "task_names": list(self._tasks.tasks),
            "inventory_digest": self._inventory.digest,
            "tasks_digest": self._tasks.digest,
        }


class VersionView(ItemView):
    """Versions by program."""

    kind = "version"
    formats = ITEM_FORMATS

    def __init__(self, versions: Mapping[str, str]) -> None:
        self._versions = versions

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per program."""
        return render_columns([(Cell(name, "name"), text) for name, text in self._versions.items()], look)

    def item(self) -> Document:
        """The versions as JSON types."""
        return dict(self._versions)
