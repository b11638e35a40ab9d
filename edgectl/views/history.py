# SPDX-License-Identifier: Apache-2.0
"""The history of a fleet: its revisions, and one of them in full."""

import math
from collections.abc import Iterable, Sequence

from edgectl.formats.document import Document
from edgectl.model.revision import Revision, RevisionOutcome
from edgectl.units import format_duration, format_instant
from edgectl.views.glossary import head
from edgectl.views.output import ItemView, ListView
from edgectl.views.output_format import NAMED_FORMATS
from edgectl.views.results import encode_action_result, render_actions
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns

_HEAD = head("revision", "started_at", "user", "verb", "duration_s", "outcome", "counts")


class HistoryView(ListView):
    """Revisions without their actions, oldest first."""

    kind = "revision"
    formats = NAMED_FORMATS

    def __init__(self, revisions: Iterable[Revision]) -> None:
        self._revisions = list(revisions)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per revision."""
        return _render_revisions(self._revisions, look) if self._revisions else ""

    def notes(self) -> Sequence[str]:
        """That there are none."""
        return [] if self._revisions else ["nothing was applied yet"]

    def items(self) -> Sequence[Document]:
        """The revisions as JSON types."""
        return [_encode_revision(value) for value in self._revisions]

    def names(self) -> Sequence[str]:
        """The numbers, as revision/N."""
        return [f"revision/{value.number}" for value in self._revisions]


class RevisionView(ItemView):
    """One revision with its actions and the placements after it."""

    kind = "revision"
    formats = NAMED_FORMATS

    def __init__(self, revision: Revision) -> None:
        self._revision = revision

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The line of the history, then each action with its phases."""
        return _render_revisions([self._revision], look) + "\n" + render_actions(self._revision.actions, look)

    def item(self) -> Document:
        """The revision as JSON types."""
        placements = self._revision.placements
        return {
            **_encode_revision(self._revision),
            "actions": [encode_action_result(action) for action in self._revision.actions],
            "placements": None if placements is None else dict(placements),
        }

    def names(self) -> Sequence[str]:
        """The tasks that were changed."""
        return [f"task/{action.task}" for action in self._revision.actions]


def _render_revisions(values: Iterable[Revision], look: RenderOptions) -> str:
    return render_columns([_HEAD, *map(_render_revision_row, values)], look, right={0, 4})


def _render_revision_row(value: Revision) -> Row:
    return (
        Cell(str(value.number), "name"),
        format_instant(math.floor(value.began_at)),
        value.user or "-",
        value.verb or "-",
        "-" if value.seconds is None else format_duration(value.seconds),
        Cell(value.ending.value, "good" if value.ending is RevisionOutcome.DONE else "bad"),
        ", ".join(f"{count} {action}" for action, count in value.counts.items()) or "-",
    )


def _encode_revision(value: Revision) -> Document:
    return {
        "revision": value.number,
        "started_at": format_instant(value.began_at),
        "user": value.user,
        "verb": value.verb,
        "outcome": value.ending.value,
        "duration_s": value.seconds,
        "counts": dict(value.counts),
    }
