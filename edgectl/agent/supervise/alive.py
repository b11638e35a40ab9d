# SPDX-License-Identifier: Apache-2.0
"""Liveness check of one task: asked again and again while it runs."""

import time

from ..link import protocol
from ..link.fast_json import Document
from . import spec_check

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping

# Between the end of one question and the next.
_PAUSE_S, _MAX_TRY_S = 3.0, 10.0
# Nothing tells the end of a question; so often it is looked for.
_POLL_S = 0.5
# Starts of the node within so long, under one command, that are no accident.
_MOST_CHANGES, _UNREST_S = 3, 60


class AliveCheck:
    """The check of one task; without ``alive`` in its spec there is never anything to ask."""

    def __init__(self, spec: Document, env: "Mapping[str, str]") -> None:
        self._spec, self._env = spec, env
        self._rule: Document = spec.get("alive") or {}
        self._running: "spec_check.RunningCheck | None" = None
        self._next: "float | None" = None
        self._since: "float | None" = None
        self._process = ""
        self._changes: "list[float]" = []

    def begin(self) -> None:
        """Ask from now on; without effect where it is asked already."""
        if self._rule and self._running is None and self._next is None:
            self._next = time.monotonic()

    def poll(self) -> "str | None":
        """What has just been learnt: empty for alive, else why it has not been for its time.

        None: nothing new. Starts the question where it is due.
        """
        if self._running is not None:
            result = self._running.poll()
            if result is None:
                return None
            self._running, self._next = None, time.monotonic() + min(_PAUSE_S, self._get_after_s())
            return self._judge(result)
        if self._next is not None and time.monotonic() >= self._next:
            self._next = None
            self._running = spec_check.start_check(self._rule, self._spec, self._env, _MAX_TRY_S)
        return None

    def _judge(self, result: Document) -> "str | None":
        if result["exit"] == 0:
            self._since = None
            return self._find_unrest(str(result["output"])) if self._rule.get("graph") else ""
        if self._rule.get("graph") and result["exit"] == protocol.UNKNOWN_EXIT:
            # Nobody could be asked: that says nothing of the task.
            return None
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        return (
            spec_check.describe_fault(self._rule, result)
            if now - self._since >= self._get_after_s()
            else None
        )

    def _find_unrest(self, process: str) -> str:
        """Find whether the node is started again and again, which a launcher that respawns it hides."""
        now = time.monotonic()
        if self._process and process != self._process:
            self._changes.append(now)
        self._process = process
        self._changes = [each for each in self._changes if now - each < _UNREST_S]
        if len(self._changes) < _MOST_CHANGES:
            return ""
        return "node %s was started %d times within %d s: is its name used twice?" % (
            self._rule["graph"]["node"],
            len(self._changes),
            _UNREST_S,
        )

    def _get_after_s(self) -> float:
        return float(self._rule.get("after_s") or 0.0)

    def compute_wait_s(self, now: float) -> "float | None":
        """Seconds until `poll` has something to do; None: never."""
        if self._running is not None:
            return max(0.0, min(_POLL_S, self._running.deadline - now))
        return None if self._next is None else self._next - now

    def owns_process(self, pid: int) -> bool:
        """Whether ``pid`` is the process of the running question, which reaps it itself."""
        return self._running is not None and pid == self._running.pid

    def cancel(self) -> None:
        """Give up a running question and ask no other until `begin`."""
        self._next = self._since = None
        self._process, self._changes = "", []
        if self._running is not None:
            self._running.end()
            self._running = None
