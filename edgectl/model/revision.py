# SPDX-License-Identifier: Apache-2.0
"""Revision: one past apply, as recorded in the journal."""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.result import ActionResult, Results


class RevisionOutcome(StrEnum):
    """End of a revision: all done, some or none of it, stopped by its user, or cut off with its manager."""

    DONE = "done"
    PARTLY = "partly"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    CUT_OFF = "cut off"


@dataclass(frozen=True, slots=True, kw_only=True)
class Revision:
    """One numbered change of the fleet.

    ``began_at``: s since 1970; ``seconds`` None where it was cut off. ``counts``: planned actions by their
    name. ``placements``: host of every placed task afterwards; None where that was not recorded.
    """

    number: int
    began_at: float
    verb: str = ""
    user: str = ""
    ending: RevisionOutcome = RevisionOutcome.CUT_OFF
    seconds: float | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    actions: tuple[ActionResult, ...] = ()
    placements: Mapping[str, str] | None = None

    @property
    def results(self) -> Results:
        """The same in the form in which an apply reports."""
        return Results(
            revision=self.number,
            actions=self.actions,
            seconds=self.seconds or 0.0,
            interrupted=self.ending is RevisionOutcome.INTERRUPTED,
        )
