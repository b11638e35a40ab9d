# SPDX-License-Identifier: Apache-2.0
"""Readiness check of one task: repeated, the longer it takes the more rarely, until it succeeds once."""

import time

from ..link.fast_json import Document
from . import spec_check

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Mapping

# From one try to the next: a share of the time since the start, so that ready is seen at most so late; and a
# multiple of the time that the last one took, for one that sources the files of ROS needs a core.
_SHARE, _COST = 0.1, 4.0
_MIN_PAUSE_S, _MAX_PAUSE_S, _MAX_TRY_S = 0.1, 5.0, 10.0
# Half of that, as far as the check takes an eighth of the time at most.
_CHEAP_SHARE, _CHEAP_COST, _MIN_CHEAP_PAUSE_S = 0.05, 8.0, 0.05
# Nothing tells the end of the check's process; so often it is looked for.
_POLL_S = 0.5


def compute_pause_s(since_s: float, took_s: float) -> float:
    """Compute the seconds from one try to the next; ``since_s``: since the start, ``took_s``: of the last."""
    usual_s = max(_MIN_PAUSE_S, _SHARE * since_s)
    cheap_s = max(_MIN_CHEAP_PAUSE_S, _CHEAP_SHARE * since_s, _CHEAP_COST * took_s)
    return min(_MAX_PAUSE_S, max(min(usual_s, cheap_s), _COST * took_s))


class ReadyCheck:
    """The check of one task; without ``ready`` in its spec there is never anything to run."""

    def __init__(
        self, spec: Document, env: "Mapping[str, str]", find_main: "Callable[[], int]" = lambda: 0
    ) -> None:
        """``find_main``: the main process of the command, which a check gets as EDGECTL_PID."""
        self._spec, self._env, self._find_main = spec, env, find_main
        self._running: "spec_check.RunningCheck | None" = None
        # Why the last try failed, where it was a question to the ROS graph.
        self.fault = ""
        self._next: "float | None" = None
        self._began = self._asked = 0.0

    def begin(self) -> None:
        """Check from now on, anew for each start of the command."""
        self._began = time.monotonic()
        self._next = self._began if self._spec.get("ready") else None
        self.fault = ""

    def poll(self) -> bool:
        """Whether the check has just succeeded. Starts it where it is due."""
        if self._running is not None:
            result = self._running.poll()
            if result is None:
                return False
            self._running, now = None, time.monotonic()
            # The end of a question to the graph is seen late, and asking costs little.
            took_s = 0.0 if self._spec["ready"].get("graph") else now - self._asked
            self._next = self._asked + compute_pause_s(now - self._began, took_s)
            if result["exit"] == 0:
                self._next, self.fault = None, ""
                return True
            if self._spec["ready"].get("graph"):
                self.fault = spec_check.describe_fault(self._spec["ready"], result)
        elif self._next is not None and time.monotonic() >= self._next:
            self._asked = time.monotonic()
            self._running = self._start()
        return False

    def _start(self) -> "spec_check.RunningCheck":
        env = dict(self._env, EDGECTL_PID=str(self._find_main()))
        return spec_check.start_check(spec_check.build_ready_rule(self._spec), self._spec, env, _MAX_TRY_S)

    def compute_wait_s(self, now: float) -> "float | None":
        """Seconds until `poll` has something to do; None: never."""
        if self._running is not None:
            return min(_POLL_S, self._running.deadline - now)
        return None if self._next is None else self._next - now

    def owns_process(self, pid: int) -> bool:
        """Whether ``pid`` is the process of the running check, which reaps it itself."""
        return self._running is not None and pid == self._running.pid

    def cancel(self) -> None:
        """Kill a running check and start no other."""
        self._next, self.fault = None, ""
        if self._running is not None:
            self._running.end()
            self._running = None
