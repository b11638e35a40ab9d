"""Events of the fleet, one line each."""

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
