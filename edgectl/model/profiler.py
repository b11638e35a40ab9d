"""The profiler that stays on a host, as the host tells of it."""

from dataclasses import dataclass
from enum import StrEnum


class ProfilerState(StrEnum):
    """``stalled``: it lives, but its last sample is old. ``unreachable``: the host did not say."""

    STARTED = "started"
    ALREADY_RUNNING = "already-running"
    REPLACED = "replaced"
    RUNNING = "running"
    STALLED = "stalled"
    STOPPED = "stopped"
    NOT_RUNNING = "not-running"
    UNREACHABLE = "unreachable"

    @property
    def alive(self) -> bool:
        """Whether there is a profiler."""
        return self not in (ProfilerState.STOPPED, ProfilerState.NOT_RUNNING, ProfilerState.UNREACHABLE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Profiler:
    """One host's profiler. Times are in seconds; what only a living one has is 0 or None without it.

    ``every``: period that was asked for; ``period``: as it is, longer where a sample costs much. ``samples``:
    taken since the start. ``sample_age``: of the last sample; None before the first. ``used_cores``,
    ``used_bytes``: its own, on average and now. ``ttl``: it ends when no edgectl called for so long;
    ``ttl_left``: until then. ``current``: whether it measures what the files want now. ``detail``: why it is
    gone. ``error`` and ``hint``: why the host did not say, and what mends it.
    """

    host: str
    state: ProfilerState
    pid: int = 0
    age: float = 0.0
    every: float = 0.0
    period: float = 0.0
    samples: int = 0
    sample_age: float | None = None
    used_cores: float = 0.0
    used_bytes: float = 0.0
    ttl: float = 0.0
    ttl_left: float = 0.0
    current: bool = True
    detail: str = ""
    error: str = ""
    hint: str = ""
