# SPDX-License-Identifier: Apache-2.0
"""Activation of one instance by its supervisor, which obeys the record of the role.

A new process is inactive. As soon as it can be activated, it is, where the record says ``active``; the
operations ``activate`` and ``deactivate`` change the record, and the process with it.
"""

import os
import time

from ..link import protocol
from ..link.fast_json import Document
from . import role, shell, spec_check
from .ready import ReadyCheck

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Union

    from ..ros.question import GraphQuestion
    from .held_shell import HeldShell

    Effect = Union[HeldShell, GraphQuestion]

# What `Activation.poll` has to say.
PREPARED, ACTIVE, STANDBY, FAILED = "prepared", "active", "standby", "failed"
# Without a check, a process that cannot start ends within this time.
_SETTLE_S = 0.3
# A change is signalled; so often it is looked for in case the signal was lost, and while the lock is held.
_LOOK_S, _RETRY_S, _POLL_S = 2.0, 0.1, 0.5
# A transition of a lifecycle, which has no time-out of its own.
LIFECYCLE_S = 20.0


def build_transition(node: str, name: str, root: int = 0) -> Document:
    """Build the question that the helper for ROS 2 answers once the node has made the transition.

    ``root``: the node must be of a process below this one.
    """
    return {"version": 2, "node": node, "change": name, "within_s": LIFECYCLE_S, "root": root}


class Activation:
    """The part of the supervisor; without ``activation`` in the spec it has nothing to do."""

    def __init__(
        self,
        folder: str,
        instance: str,
        spec: Document,
        env: "dict[str, str]",
        find_main: "Callable[[], int]",
    ) -> None:
        self._folder, self._instance, self._spec, self._env = folder, instance, spec, env
        self._find_main = find_main
        self.rule: Document = spec.get("activation") or {}
        # What is still to be checked; without anything, the process only has to run for its time.
        self._left: "list[ReadyCheck]" = []
        self._waits = True
        self._pid, self._ticks, self._begun = 0, -1, 0.0
        self._next = 0.0
        self._effect: "Effect | None" = None
        self._lock = -1
        self.prepared = self.active = False
        # Why it is not prepared yet, or why its activation failed.
        self.fault = ""

    def begin(self, pid: int, ticks: int) -> None:
        """Prepare a new process, which is inactive."""
        self._pid, self._ticks, self._begun = pid, ticks, time.monotonic()
        self._next, self.prepared, self.active, self.fault = 0.0, False, False, ""
        self._left = self._build_checks()
        self._waits = not self._left
        if self._left:
            self._left[0].begin()

    def _build_checks(self) -> "list[ReadyCheck]":
        checks = [self.rule.get("ready")]
        if self.rule.get("lifecycle"):
            question = build_transition(str(self.rule["lifecycle"]), "configure", self._pid)
            checks.insert(0, {"command": "", "graph": question, "timeout_s": LIFECYCLE_S})
        return [
            ReadyCheck(dict(self._spec, ready=check), self._env, self._find_main) for check in checks if check
        ]

    def adopt(self, pid: int, ticks: int, status: Document) -> None:
        """Go on with a process that another supervisor has started."""
        self.begin(pid, ticks)
        self.prepared, self.active = bool(status.get("prepared")), bool(status.get("active"))

    def look(self) -> None:
        """Read the record at the next `poll`."""
        self._next = 0.0

    def is_standby(self) -> bool:
        """Whether the record says that the instance is inactive."""
        found = role.read_role(self._folder, self._instance) if self.rule else {}
        return found.get("role") == protocol.ROLE_STANDBY

    def poll(self, may_activate: "Callable[[], bool]") -> str:
        """What is new: one of the constants above, or nothing. Starts an activation that is due."""
        if not self.rule or not self._pid:
            return ""
        if not self.prepared:
            return self._poll_checks()
        if self._effect is not None:
            return self._poll_effect()
        if time.monotonic() < self._next:
            return ""
        self._next = time.monotonic() + _LOOK_S
        return self._obey(may_activate)

    def _poll_checks(self) -> str:
        """Whether it can be activated from now on."""
        if self._waits and time.monotonic() - self._begun < self._get_up_s():
            return ""
        if self._left:
            check = self._left[0]
            if not check.poll():
                self.fault = check.fault
                return ""
            del self._left[0]
            if self._left:
                self._left[0].begin()
                return ""
        self.prepared, self.fault = True, ""
        return PREPARED

    def _get_up_s(self) -> float:
        return max(_SETTLE_S, float(self.rule.get("up_s") or 0.0))

    def _obey(self, may_activate: "Callable[[], bool]") -> str:
        found = role.read_role(self._folder, self._instance)
        if found.get("role") == protocol.ROLE_STANDBY:
            was, self.active = self.active, False
            return STANDBY if was else ""
        if role.is_proven_active(found, self._pid, self._ticks):
            was, self.active = self.active, True
            return "" if was else ACTIVE
        if found and may_activate():
            self._begin_effect()
        return ""

    def _begin_effect(self) -> None:
        """Activate the process, unless a request is at it."""
        # Imported on demand: few tasks have an activation.
        from . import switch_lock

        lock = switch_lock.open_switch_lock(self._folder)
        if not switch_lock.take_switch_lock(lock, 0.0):
            return self._close_lock(lock)
        found = role.read_role(self._folder, self._instance)
        if found.get("role") != protocol.ROLE_ACTIVE or role.is_proven_active(found, self._pid, self._ticks):
            self._next = 0.0
            return self._close_lock(lock, retry=False)
        self._lock = lock
        try:
            role.write_role(self._folder, dict(found, pid=self._pid, ticks=self._ticks, done=False))
            self._effect = self._start_effect(lock)
        except OSError as error:
            self.fault = "activate: %s" % error
            self._release()
            self._next = time.monotonic() + _LOOK_S
        return None

    def _start_effect(self, lock: int) -> "Effect":
        setup = (self._spec.get("ros") or {}).get("setup") or []
        if self.rule.get("lifecycle"):
            from ..ros.question import GraphQuestion

            question = build_transition(str(self.rule["lifecycle"]), "activate", self._pid)
            return GraphQuestion(question, self._env, LIFECYCLE_S, setup)
        from .held_shell import HeldShell

        check = self.rule["activate"]
        env = dict(self._env, EDGECTL_PID=str(self._find_main()))
        cwd = shell.resolve_workdir(self._spec.get("workdir"), env)
        started = HeldShell(check["command"], self._spec.get("prelude") or "", env, setup, cwd, lock)
        started.go(float(check["timeout_s"]))
        return started

    def _poll_effect(self) -> str:
        result = self._effect.poll() if self._effect is not None else None
        if result is None:
            return ""
        self._effect = None
        if result["exit"] != 0:
            check = {"graph": True} if self.rule.get("lifecycle") else {}
            self.fault = "activate: " + spec_check.describe_fault(check, result)
            self._release()
            return FAILED
        return self._record_activation()

    def _record_activation(self) -> str:
        found = role.read_role(self._folder, self._instance)
        try:
            role.write_role(self._folder, dict(found, switching=False, done=True))
        except OSError as error:
            # Not proven: it is activated once more.
            self.fault, self._next = "activate: %s" % error, time.monotonic() + _LOOK_S
            return ""
        finally:
            self._release()
        self.active, self.fault = True, ""
        return ACTIVE

    def _close_lock(self, lock: int, *, retry: bool = True) -> None:
        os.close(lock)
        if retry:
            self._next = time.monotonic() + _RETRY_S

    def _release(self) -> None:
        if self._lock >= 0:
            self._close_lock(self._lock, retry=False)
            self._lock = -1

    def compute_wait_s(self, now: float) -> "float | None":
        """Seconds until `poll` has something to do; None: never."""
        if not self.rule or not self._pid:
            return None
        if self._effect is not None:
            return max(0.0, min(_POLL_S, self._effect.deadline - now))
        if self.prepared:
            return self._next - now
        if self._left:
            return self._left[0].compute_wait_s(now)
        return self._begun + self._get_up_s() - now

    def owns_process(self, pid: int) -> bool:
        """Whether ``pid`` is a process of this activation, which reaps it itself."""
        owned = self._effect is not None and pid == self._effect.pid
        return owned or any(check.owns_process(pid) for check in self._left)

    def cancel(self) -> None:
        """Before the process is ended: give up what runs; the record goes on saying what may be."""
        for check in self._left:
            check.cancel()
        self._left, self._pid = [], 0
        if self._effect is not None:
            self._effect.end()
            self._effect = None
        self._release()
