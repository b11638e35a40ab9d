"""Events of the fleet, one line each."""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.dataclass import dataclass


class EventKind(StrEnum):
    """Kind of an event. The word stays the same from release to release."""

    HOST_LOST = "host-lost"
    HOST_BACK = "host-back"
    HOST_REBOOTED = "host-rebooted"
    ROAMED = "roamed"
    LINK_DOWN = "link-down"
    LINK_BACK = "link-back"
    TASK_STARTED = "task-started"
    TASK_STOPPED = "task-stopped"
    TASK_MOVED = "task-moved"
    TASK_RESTARTED = "task-restarted"
    TASK_ADOPTED = "task-adopted"
    TASK_READY = "task-ready"
    TASK_COMPLETED = "task-completed"
    TASK_FAILED = "task-failed"
    TASK_CRASHLOOP = "task-crashloop"
    TASK_UNHEALTHY = "task-unhealthy"
    TASK_LOST = "task-lost"
    NODES_REMOVED = "nodes-removed"
    TASK_DEFERRED = "task-deferred"
    TASK_UNPLACED = "task-unplaced"
    TASK_OVERUSE = "task-overuse"
    ACTION_FAILED = "action-failed"
    PLANNED = "planned"


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One thing that happened, or was first seen, at ``at`` (s since 1970, the manager's clock).

    ``id`` is given by the store and grows from event to event; 0 before it is stored.
    """

    at: float
    kind: EventKind
    host: str | None = None
    task: str | None = None
    message: str = ""
    id: int = 0


# What a person should look at, and that it is well again.
DEFAULT_HOOK_KINDS = (
    EventKind.HOST_LOST,
    EventKind.HOST_BACK,
    EventKind.LINK_DOWN,
    EventKind.TASK_FAILED,
    EventKind.TASK_CRASHLOOP,
    EventKind.TASK_UNHEALTHY,
    EventKind.TASK_LOST,
    EventKind.TASK_UNPLACED,
    EventKind.ACTION_FAILED,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class EventHook:
    """An entry of ``on_event``: a program that is told of events of ``kinds`` (ADR 0069).

    ``command`` is an argument vector; else ``notifier`` names a plugin, which receives ``options``. It is
    ended after ``timeout`` s, and started at most once in ``every`` s; events in between come together.
    """

    command: tuple[str, ...] = ()
    notifier: str = ""
    options: Mapping[str, str] = field(default_factory=dict)
    kinds: tuple[EventKind, ...] = DEFAULT_HOOK_KINDS
    timeout: float = 10.0
    every: float = 10.0

    @property
    def subject(self) -> str:
        """The hook in a message."""
        return f"on_event {self.command[0] if self.command else f'notifier {self.notifier}'}"
