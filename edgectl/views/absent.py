"""What is known of a task that no host reports, and of a host that does not answer."""

from dataclasses import dataclass

from edgectl.model.memory import Memory
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task
from edgectl.units import format_duration


@dataclass(frozen=True, slots=True, kw_only=True)
class Absent:
    """``state``: completed, unknown, not running or (unmanaged) not found. Where unknown: the last ``host`` and its ``contact``."""

    state: str
    host: str | None = None
    contact: float | None = None


def absent(task: Task, value: Snapshot) -> Absent:
    """What became of ``task``, which no host of the snapshot reports."""
    memory = value.memory or Memory()
    placement = memory.placements.get(task.name)
    if memory.done.get(task.name) == task.spec_hash:
        return Absent(state="completed")
    if placement is not None and placement.host in value.hosts and not value.hosts[placement.host].ok:
        return Absent(state="unknown", host=placement.host, contact=memory.contact.get(placement.host))
    return Absent(state="not running" if task.managed else "not found")


def silence(contact: float | None, now: float) -> str:
    """How long a host has been silent, in brackets; nothing where that is not known."""
    return "" if contact is None else f" (silent for {format_duration(max(0.0, now - contact))})"


def standing(host: str, memory: Memory | None) -> str:
    """How the operator closed a host: fenced, draining, cordoned, or nothing."""
    if memory is None:
        return ""
    words = {"fenced": memory.fenced, "draining": memory.draining, "cordoned": memory.cordons}
    return next((word for word, hosts in words.items() if host in hosts), "")
