# SPDX-License-Identifier: Apache-2.0
"""Checks of one task while it runs: prepared, active, ready, alive; as changes of its status."""

import time

from ..link import protocol
from ..link.fast_json import Document
from . import activation, spec_check
from .ready import ReadyCheck

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Mapping

# Between the end of one question and the next.
_PAUSE_S, _MAX_TRY_S = 3.0, 10.0
# Nothing tells the end of a question; so often it is looked for.
_POLL_S = 0.5
# Starts of the node within so long, under one command, that are no accident.
_MOST_CHANGES, _UNREST_S = 3, 60


class AliveCheck:
    """The check whether a task is alive; without ``alive`` in its spec there is never anything to ask."""

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


class TaskChecks:
    """All checks of one task. Those that learn something return what its status is to say."""

    def __init__(
        self,
        folder: str,
        instance: str,
        spec: Document,
        env: "dict[str, str]",
        find_main: "Callable[[], int]",
    ) -> None:
        self._spec = spec
        self._ready, self._alive = ReadyCheck(spec, env, find_main), AliveCheck(spec, env)
        self.activation = activation.Activation(folder, instance, spec, env, find_main)

    def begin(self, pid: int, ticks: int) -> Document:
        """Check a command that has just started."""
        if self.activation.rule:
            self.activation.begin(pid, ticks)
            return {"state": protocol.STARTING, "prepared": False, "active": False}
        self._ready.begin()
        return {"state": protocol.STARTING if self._spec.get("ready") else protocol.RUNNING}

    def adopt(self, pid: int, ticks: int, status: Document) -> None:
        """Go on with a command that another supervisor has started."""
        if self.activation.rule:
            self.activation.adopt(pid, ticks, status)
        if status.get("state") == protocol.STARTING and self._is_active():
            self._ready.begin()

    def _is_active(self) -> bool:
        """Whether the task is to be ready and alive: not while it waits for its activation."""
        return not self.activation.rule or self.activation.active

    def follow_role(self, status: Document, may_activate: "Callable[[], bool]") -> "tuple[Document, str]":
        """Make the process what the record of the role says; also why it cannot be activated."""
        news = self.activation.poll(may_activate)
        if news == activation.FAILED:
            return {}, self.activation.fault
        if news == activation.ACTIVE:
            self._ready.begin()
            state = protocol.STARTING if self._spec.get("ready") else protocol.RUNNING
            return {"state": state, "prepared": True, "active": True, "detail": ""}, ""
        if news and self.activation.is_standby():
            self._ready.cancel()
            self._alive.cancel()
            return {"state": protocol.READY, "prepared": True, "active": False, "detail": ""}, ""
        if news == activation.PREPARED:
            return {"prepared": True, "detail": ""}, ""
        return _describe_change(status, self.activation.fault), ""

    def ask_readiness(self, status: Document) -> Document:
        """Ask whether the task is ready, until it is."""
        if self._ready.poll():
            return {"state": protocol.READY, "detail": ""}
        return _describe_change(status, self._ready.fault)

    def ask_health(self, status: Document, is_leaving: "Callable[[], bool]") -> "tuple[Document, str]":
        """Ask whether the task is alive; also why it is to be restarted, where its spec says so.

        ``is_leaving``: what happens to it then is no fault of it.
        """
        if status["state"] == protocol.STARTING or not self._is_active():
            return {}, ""
        self._alive.begin()
        fault = self._alive.poll()
        if fault is None or (fault and is_leaving()):
            return {}, ""
        if fault and self._spec["alive"].get("restart"):
            return {"state": protocol.UNHEALTHY, "detail": fault}, "not alive: " + fault
        if fault and (status["state"], status["detail"]) != (protocol.UNHEALTHY, fault):
            return {"state": protocol.UNHEALTHY, "detail": fault}, ""
        if not fault and status["state"] == protocol.UNHEALTHY:
            state = protocol.READY if self._spec.get("ready") else protocol.RUNNING
            return {"state": state, "detail": ""}, ""
        return {}, ""

    def compute_wait_s(self, now: float) -> "float | None":
        """Seconds until one of them has something to do; None: never."""
        waits = [each.compute_wait_s(now) for each in (self._ready, self._alive, self.activation)]
        known = [each for each in waits if each is not None]
        return min(known) if known else None

    def owns_process(self, pid: int) -> bool:
        """Whether ``pid`` is the process of a running check, which reaps it itself."""
        return any(each.owns_process(pid) for each in (self._ready, self._alive, self.activation))

    def cancel(self) -> None:
        """Give up what is running, and ask nothing until `begin`."""
        self._ready.cancel()
        self._alive.cancel()
        self.activation.cancel()

    def cancel_health(self) -> None:
        """Ask no more whether it is alive: it is being stopped."""
        self._alive.cancel()


def _describe_change(status: Document, fault: str) -> Document:
    return {"detail": fault} if fault and status["detail"] != fault else {}
