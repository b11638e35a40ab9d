# SPDX-License-Identifier: Apache-2.0
"""The resident profiler of a host, as the host reports it."""

from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.resource import Usage


class ProfilerState(StrEnum):
    """``stalled``: it lives, but its last sample is old. ``unreachable``: the host did not answer."""

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
    """One host's profiler. Times are in seconds; figures of a living one are 0 or None without it.

    ``every``: requested period; ``period``: the actual one, longer where a sample is expensive. ``samples``:
    taken since the start. ``sample_age``: of the last sample; None before the first. ``used``: its
    own usage, of the CPU on average. ``ttl``: it ends after so long without a request;
    ``ttl_left``: until then. ``current``: whether it measures what the files ask for now. ``detail``: reason
    of its end. ``error`` and ``hint``: reason for which the host did not answer, and the remedy.
    """

    host: str
    state: ProfilerState
    pid: int = 0
    age: float = 0.0
    every: float = 0.0
    period: float = 0.0
    samples: int = 0
    sample_age: float | None = None
    used: Usage = Usage()
    ttl: float = 0.0
    ttl_left: float = 0.0
    current: bool = True
    detail: str = ""
    error: str = ""
    hint: str = ""
