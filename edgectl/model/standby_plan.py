"""Decisions of a plan about the inactive copies of a task."""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.encoding import Signed, in_document
from edgectl.model.resource import Usage

_WRITTEN = in_document(always=True)


class StandbyAction(StrEnum):
    """Action on one copy.

    ``ACTIVATE``: the copy becomes the task itself, by a move or a start to its host. ``DEACTIVATE``: the
    instance that a move leaves stays as a copy. ``RESTART``: its spec has changed. ``NONE``: wanted, and no
    host may take it.
    """

    KEEP = "keep"
    START = "start"
    STOP = "stop"
    RESTART = "restart"
    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    NONE = "none"

    @property
    def changes(self) -> bool:
        """Whether the action touches a host by itself: other than with the step of its task."""
        return self in (StandbyAction.START, StandbyAction.STOP, StandbyAction.RESTART)

    @property
    def stays(self) -> bool:
        """Whether a copy stands on the host afterwards."""
        return self not in (StandbyAction.STOP, StandbyAction.ACTIVATE, StandbyAction.NONE)


class StandbyReason(StrEnum):
    """Reason of a standby step; ``views`` holds the text of each."""

    RUNNER_UP = "runner-up"
    STILL_BEST = "still-best"
    BELOW_MARGIN = "below-move-margin"
    DWELL = "dwell"
    MOVES_FROZEN = "moves-frozen"
    HELD = "task-held"
    OUTRANKED = "outranked"
    EXCLUDED = "host-excluded"
    NO_ROOM = "no-room"
    NO_HOST = "no-host"
    FAILED = "failed-there"
    NOT_WANTED = "not-wanted"
    NOT_PLACED = "task-not-placed"
    TASK_HERE = "task-here"
    SPEC_CHANGED = "spec-changed"
    ORPHANED = "orphaned"
    LEFT_FILE = "left-the-file"
    OPERATOR = "operator"


@dataclass(frozen=True, slots=True, kw_only=True)
class StandbyStep:
    """One copy of a task on ``host`` (None: no host may take it).

    ``instance``: the one that stands there, or the active one that becomes a copy. ``subject``: the host
    that the reason is about; ``amount``: its number (lead of the other host, seconds of dwell that are left).
    ``total``: eq. (4) of the task on the host. ``demand``: what is reserved for the copy.
    """

    host: str | None = field(metadata=_WRITTEN)
    action: StandbyAction
    reason: StandbyReason
    instance: str = ""
    subject: str | None = None
    amount: Signed | None = None
    total: Signed | None = None
    demand: Usage = field(default=Usage(), metadata=in_document(by_resource=("demand",), host_only=True))


def stop_copies(copies: Mapping[str, str], reason: StandbyReason) -> tuple[StandbyStep, ...]:
    """The steps that stop these copies, given by host with their instances."""
    return tuple(
        StandbyStep(host=host, action=StandbyAction.STOP, reason=reason, instance=instance)
        for host, instance in copies.items()
    )
