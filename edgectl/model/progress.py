# SPDX-License-Identifier: Apache-2.0
"""Progress of a plan under way, for live views."""

from collections.abc import Callable
from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, Phase, PhaseResult


class ProgressStage(StrEnum):
    """Which moment of an action a progress event reports."""

    ACTION_BEGIN = "action-begin"
    PHASE_BEGIN = "phase-begin"
    PHASE_END = "phase-end"
    ACTION_END = "action-end"


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgressEvent:
    """One event.

    ``phase`` and ``host`` on the phase stages, ``ended`` on PHASE_END, ``result`` on ACTION_END.
    """

    stage: ProgressStage
    task: str
    action: Action
    phase: Phase | None = None
    host: str | None = None
    ended: PhaseResult | None = None
    result: ActionResult | None = None


ProgressListener = Callable[[ProgressEvent], None]


def ignore_progress(_event: ProgressEvent) -> None:
    """Listen to nothing."""
