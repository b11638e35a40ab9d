# SPDX-License-Identifier: Apache-2.0
"""Marks that a command has set on hosts and tasks, or removed from them."""

from collections.abc import Sequence
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.formats.document import Document
from edgectl.views.output import ListView
from edgectl.views.output_format import NAMED_FORMATS
from edgectl.views.text import PLAIN, RenderOptions, style_text

# After what a dry run would have done, as kubectl prints it.
DRY_RUN_SUFFIX = " (dry run)"


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """One mark: ``subject`` is edge, robot, task, or host where it left the inventory; ``act`` is in words.

    ``again``: it was so before. ``details``: further keys of its document.
    """

    subject: str
    name: str
    act: str
    again: bool = False
    details: Document = field(default_factory=dict)


class MarksView(ListView):
    """One line per host or task, as kubectl prints it: ``edge/edge1 cordoned``."""

    kind = "mark"
    formats = NAMED_FORMATS

    def __init__(
        self, verb: str, marks: Sequence[Mark], warnings: Sequence[str] = (), *, dry_run: bool
    ) -> None:
        self._verb, self._marks, self._warnings, self._dry_run = verb, marks, warnings, dry_run

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The lines; a mark that was set before is no error."""
        suffix = DRY_RUN_SUFFIX if self._dry_run else ""
        return "".join(
            style_text(name, "name", look) + f" {'already ' if each.again else ''}{each.act}{suffix}\n"
            for name, each in zip(self.names(), self._marks, strict=True)
        )

    def warnings(self) -> Sequence[str]:
        """What the mark does not change."""
        return self._warnings

    def items(self) -> Sequence[Document]:
        """The marks as JSON types."""
        return [
            {
                "host": None if each.subject == "task" else each.name,
                "task": each.name if each.subject == "task" else None,
                "verb": self._verb,
                "message": each.act,
                "changed": not each.again,
                "dry_run": self._dry_run,
                **each.details,
            }
            for each in self._marks
        ]

    def names(self) -> Sequence[str]:
        """The hosts and tasks, as KIND/NAME."""
        return [f"{each.subject}/{each.name}" for each in self._marks]
