# SPDX-License-Identifier: Apache-2.0
"""Transitions of an instance, prepared and then run by a request: a command, or one of a ROS 2 lifecycle."""

import os
import time

from ..link import protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import metrics, proc
from . import shell, signals, switch_lock
from .activation import LIFECYCLE_S, build_transition
from .held_shell import HeldShell
from .liveness import InstanceRecord

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping

# Set-up files of ROS take a second, more on a small board.
_PREPARE_S = 20.0


class Transition:
    """One transition with the lock of the role, which its command inherits."""

    def __init__(self, lock: int) -> None:
        self.lock = lock

    def run(self) -> str:
        """Run it; why it failed, empty where it did not."""
        raise NotImplementedError

    def end_command(self) -> None:
        """End what is left of it, and keep the lock."""

    def end(self) -> None:
        """End it and release the lock."""
        self.end_command()
        os.close(self.lock)


class CommandTransition(Transition):
    """A command whose shell waits."""

    def __init__(self, check: Document, spec: Document, env: "Mapping[str, str]", lock: int) -> None:
        super().__init__(lock)
        self._timeout_s = float(check["timeout_s"])
        setup = (spec.get("ros") or {}).get("setup") or ()
        cwd = shell.resolve_workdir(spec.get("workdir"), env)
        prelude = spec.get("prelude") or ""
        self._shell: "HeldShell | None" = HeldShell(check["command"], prelude, env, setup, cwd, lock)
        fault = self._shell.await_prepared(_PREPARE_S)
        if fault:
            self.end_command()
            raise RefusalError("not-prepared", "the command cannot be prepared: " + fault)

    def run(self) -> str:
        """As ``Transition.run``."""
        held, self._shell = self._shell, None
        if held is None:
            return "it was run already"
        held.go(self._timeout_s)
        result = held.result()
        if result["timed_out"]:
            return "it did not end within %g s" % self._timeout_s
        said = ": %s" % result["output"][-200:] if result["output"] else ""
        return "it ended with %s%s" % (result["exit"], said) if result["exit"] != 0 else ""

    def end_command(self) -> None:
        """As ``Transition.end_command``."""
        if self._shell is not None:
            self._shell.end()
            self._shell = None


class LifecycleTransition(Transition):
    """A transition of a node, made by the helper for ROS 2."""

    def __init__(
        self, node: str, name: str, root: int, spec: Document, env: "Mapping[str, str]", lock: int
    ) -> None:
        super().__init__(lock)
        from ..ros import graph2

        self._ask, self._no_helper = graph2.ask_helper, graph2.NoHelperError
        setup = list((spec.get("ros") or {}).get("setup") or ())
        self._helper = graph2.build_helper_name(env, setup)
        self._asked = build_transition(node, name)
        warm = {"node": node, "warm": True, "within_s": _PREPARE_S, "root": root}
        fault = self._put(warm, _PREPARE_S, graph2.CONNECT_S)
        if fault:
            raise RefusalError("not-prepared", fault)

    def run(self) -> str:
        """As ``Transition.run``."""
        return self._put(self._asked, LIFECYCLE_S, 0.0)

    def _put(self, asked: Document, seconds: float, patience_s: float) -> str:
        try:
            return self._ask(self._helper, asked, time.monotonic() + seconds, patience_s)
        except self._no_helper as error:
            return str(error)


def prepare_transition(record: InstanceRecord, spec: Document, wanted: str, lock: int = -1) -> Transition:
    """Prepare an instance's way to the role ``wanted``; ``lock``: an open one of its role, if there is one.

    Raises:
        RefusalError: it cannot be prepared; nothing was done.
    """
    own = switch_lock.open_switch_lock(record.folder) if lock < 0 else lock
    try:
        return _build_transition(record, spec, wanted, own)
    except BaseException:
        if lock < 0:
            os.close(own)
        raise


def _build_transition(record: InstanceRecord, spec: Document, wanted: str, lock: int) -> Transition:
    rule, env = spec["activation"], _build_environment(record, spec)
    name = "activate" if wanted == protocol.ROLE_ACTIVE else "deactivate"
    if rule.get("lifecycle"):
        return LifecycleTransition(
            str(rule["lifecycle"]), name, int(record.status.get("pid", 0)), spec, env, lock
        )
    return CommandTransition(rule[name], spec, env, lock)


def _build_environment(record: InstanceRecord, spec: Document) -> "dict[str, str]":
    """Build the environment of the task for a command beside it, without the mark of its processes."""
    env = shell.build_environment(spec.get("env"))
    env["EDGECTL_INSTANCE"] = str(record.instance.get("instance"))
    env["EDGECTL_METRICS"] = metrics.get_metrics_path(record.folder)
    main = signals.find_main_process(int(record.status.get("pid", 0)), proc.read_process_table())
    env["EDGECTL_PID"] = str(main)
    return env
