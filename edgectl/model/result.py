# SPDX-License-Identifier: Apache-2.0
"""Results of a plan that was carried out."""

from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.plan import Action
from edgectl.model.standby_plan import StandbyAction


class Outcome(StrEnum):
    """Outcome of one action. ``unreachable``: its host did not answer, so nothing was sent."""

    DONE = "done"
    FAILED = "failed"
    DEFERRED = "deferred"
    SKIPPED = "skipped"
    UNREACHABLE = "unreachable"


class Phase(StrEnum):
    """One part of an action, in the words of the handoff contract.

    ``reach`` (the host answers) and ``needs`` (predecessors are far enough) change nothing and are not in
    results. ``heard``: the robot hears the old instance, and later the new one. ``standby``: an inactive
    copy is started and can be activated. ``pull``: the new host has the image of the task.
    """

    REACH = "reach"
    NEEDS = "needs"
    PULL = "pull"
    SAFE = "safe"
    HOLD = "hold"
    STANDBY = "standby"
    SAVE = "save"
    TRANSFER = "transfer"
    LOAD = "load"
    DEACTIVATE = "deactivate"
    STOP = "stop"
    START = "start"
    ACTIVATE = "activate"
    ADOPT = "adopt"
    READY = "ready"
    RELEASE = "release"
    RESTORE = "restore"
    HEARD = "heard"


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseResult:
    """One phase on one host, with its duration in seconds."""

    phase: Phase
    host: str
    seconds: float
    ok: bool
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class CarriedState:
    """The state that a move took along: its size and SHA-256, the bytes that its transfer took, how long each
    part took in seconds, and its age when it was loaded.

    ``host``: where it was loaded last; empty where it was not.
    """

    size_bytes: int
    sha256: str
    save_s: float
    sent_bytes: int = 0
    transfer_s: float = 0.0
    load_s: float = 0.0
    age_s: float = 0.0
    host: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionResult:
    """One step of the plan as it went.

    ``downtime_s``: stop to ready of a move or restart; None where there was none. ``host`` and
    ``previous_host`` are the plan's; ``located`` is where the task stands after the action (None: nowhere).
    ``instance``: the start that was sent last; empty where none was. ``state``: what the move saved.
    ``gap_s``: the longest silence of the task at its robot, where that is heard.
    """

    task: str
    action: Action
    outcome: Outcome
    host: str | None = None
    previous_host: str | None = None
    phases: tuple[PhaseResult, ...] = ()
    downtime_s: float | None = None
    error: str = ""
    hint: str = ""
    located: str | None = None
    instance: str = ""
    state: CarriedState | None = None
    gap_s: float | None = None

    @property
    def felt_gap_s(self) -> float | None:
        """The gap as the robot heard it, else from stop to ready."""
        return self.downtime_s if self.gap_s is None else self.gap_s


@dataclass(frozen=True, slots=True, kw_only=True)
class StandbyResult:
    """What became of one inactive copy of a task: started or stopped on ``host`` within ``seconds``."""

    task: str
    host: str
    action: StandbyAction
    outcome: Outcome
    seconds: float = 0.0
    error: str = ""
    hint: str = ""
    instance: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """All actions of one apply.

    ``revision`` counts applies of this fleet; ``seconds`` is the whole duration. ``standbys``: the inactive
    copies that were started or stopped by themselves.
    """

    revision: int
    actions: tuple[ActionResult, ...]
    seconds: float
    interrupted: bool = False
    standbys: tuple[StandbyResult, ...] = ()

    @property
    def done(self) -> bool:
        """Whether every action was carried out."""
        outcomes = [action.outcome for action in self.actions] + [copy.outcome for copy in self.standbys]
        return not self.interrupted and all(outcome is Outcome.DONE for outcome in outcomes)
