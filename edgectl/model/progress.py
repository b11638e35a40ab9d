"""What a live view is told while a plan is carried out."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, Phase, PhaseResult


class Stage(StrEnum):
    """Which moment of an action a progress event reports."""

    ACTION_BEGIN = "action-begin"
    PHASE_BEGIN = "phase-begin"
    PHASE_END = "phase-end"
    ACTION_END = "action-end"


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """One event. ``phase`` and ``host`` on the phase stages, ``ended`` on PHASE_END, ``result`` on ACTION_END."""

    stage: Stage
    task: str
    action: Action
    phase: Phase | None = None
    host: str | None = None
    ended: PhaseResult | None = None
    result: ActionResult | None = None


Listener = Callable[[Progress], None]


def unheard(_event: Progress) -> None:
    """Listen to nothing."""
