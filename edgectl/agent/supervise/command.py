# SPDX-License-Identifier: Apache-2.0
"""Command of a task under its supervisor: its start, output and metrics, and the end of its process tree."""

import os
import select
import time

from ..link.fast_json import Document
from ..measure import metrics, proc
from . import liveness, lockfile, shell, signals, spawn

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Sequence

    from ..measure.latency_tail import LatencyTail
    from .logfile import LogWriter

_BLOCK_BYTES = 65536
_KILL = ("KILL", "tree", 10.0)
_TURN_S = 0.05


class Command:
    """The processes of one task. ``pid``: of the shell of the present run, 0 without one."""

    def __init__(self, folder: str, lock: int, log: "LogWriter") -> None:
        """``lock`` is -1 while a task that is taken over holds it."""
        self.folder, self.lock, self.log = folder, lock, log
        self.pid, self.ticks, self.pipe, self.started, self.code = 0, 0, -1, 0.0, 0
        self.adopted = False
        # Of a container: the pipe of its runner, whether its start goes on, whether an orphan's is followed.
        self.notes, self.waits, self.resumed = -1, False, False
        # Of a container: its engine has ended it.
        self.interrupted = False

    def get_main(self) -> "tuple[int, int]":
        """Get (pid, start ticks) of the task itself."""
        return self.pid, self.ticks

    def get_variables(self) -> "dict[str, str]":
        """Get what checks are given in their environment of the present run."""
        return {}

    def read_notes(self) -> "list[Document]":
        """Read what a runner has to say."""
        return []

    def describe_end(self, code: int) -> Document:
        """Describe the end of the main process by its wait status."""
        return spawn.describe_exit(code)

    def take_lock(self) -> None:
        """Take the lock of the task where an orphan has had it.

        Raises:
            OSError: a process of an earlier run has it still.
        """
        if self.lock < 0:
            self.lock = lockfile.take_lock(self.folder)
            if self.lock < 0:
                raise OSError("the lock of the task is held by a process that it left")

    def start(self, spec: Document, env: "dict[str, str]") -> None:
        """Start a run.

        Raises:
            OSError: the directory or the program does not exist, or a process of an earlier run has the lock.
        """
        self.take_lock()
        self.adopted = False
        argv = shell.build_argv(
            spec["command"], spec.get("prelude") or "", (spec.get("ros") or {}).get("setup") or ()
        )
        self.pid, self.pipe = spawn.spawn_command(argv, env, spec.get("workdir"), self.lock)
        self.log.begin_run()
        process = proc.read_process(self.pid)
        self.ticks, self.started = process.ticks if process is not None else -1, time.monotonic()

    def take_over(self, status: Document) -> None:
        """Continue from the status of an orphan, whose processes are no children of this one."""
        self.adopted, self.code = True, spawn.UNKNOWN_EXIT
        self.pid, self.ticks = int(status.get("pid", 0)), int(status.get("ticks", -1))
        # Without a main process there is an end to handle: only leftovers live.
        self.pid, self.started = self.pid or -1, time.monotonic() - proc.age_s_from_ticks(self.ticks)

    def find_main_process(self) -> int:
        """Find the process that checks and signals mean."""
        return signals.find_main_process(self.pid, proc.read_process_table())

    def copy_output(self) -> None:
        """Write to the log what the command has said."""
        data = os.read(self.pipe, _BLOCK_BYTES)
        if data:
            return self.log.write(data)
        os.close(self.pipe)
        self.pipe = -1
        return None

    def reap(self, is_of_check: "Callable[[int], bool]") -> "int | None":
        """Reap every child that ended; the wait status of the main process where it is among them, or is
        adopted and gone. ``is_of_check``: whether a process is that of a check, which reaps it itself.
        """
        ended = None
        if self.adopted and self.pid and not proc.is_process_alive(self.pid, self.ticks):
            ended = spawn.UNKNOWN_EXIT
        while True:
            try:
                seen = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            except ChildProcessError:
                return ended
            if seen is None or is_of_check(seen.si_pid):
                return ended
            pid, code = os.waitpid(seen.si_pid, 0)
            if pid == self.pid:
                self.code = ended = code

    def end_tree(
        self,
        steps: "Sequence[tuple[str, str, float]]",
        may_signal: "Callable[[], bool]",
        each_turn: "Callable[[], object]",
    ) -> "list[int]":
        """Signal all below this process, step by step and finally with KILL, until nothing is left.

        Returns the remaining pids. While not ``may_signal`` their end is only awaited. ``each_turn`` reaps.
        """
        pending, since = [*steps, _KILL], time.monotonic()
        sent: "set[tuple[int, int, int]]" = set()
        while True:
            each_turn()
            table = proc.read_process_table()
            left = self._find_tree(table)
            if not left:
                break
            if may_signal():
                if time.monotonic() - since > pending[0][2]:
                    since = time.monotonic()
                    del pending[0]
                if not pending:
                    break
                sent |= self._signal_step(pending[0], left, table, sent)
            self._copy_output_for(_TURN_S)
        self._copy_output_for(0.0)
        if self.pipe >= 0:
            os.close(self.pipe)
            self.pipe = -1
        return sorted(left)

    def _find_tree(self, table: "dict[int, proc.Process]") -> "set[int]":
        """Find the processes of the task; those of an orphan are found as they are without a supervisor."""
        left = proc.find_descendants({os.getpid()}, table)
        if self.adopted:
            left |= liveness.find_orphans(liveness.read_instance(self.folder), table)
        return left - {os.getpid()}

    def _signal_step(
        self,
        step: "tuple[str, str, float]",
        left: "set[int]",
        table: "dict[int, proc.Process]",
        sent: "set[tuple[int, int, int]]",
    ) -> "set[tuple[int, int, int]]":
        """Send one step to the remaining processes.

        The main process gets its signal once, newcomers of the tree get it too.
        """
        if step[1] == "main":
            left = set() if sent else {signals.find_main_process(self.pid, table)} & left
        return signals.send_signals(
            [(pid, table[pid].ticks) for pid in sorted(left)], signals.parse_signal(step[0]), sent
        )

    def _copy_output_for(self, seconds: float) -> None:
        """Write the log for ``seconds``."""
        deadline = time.monotonic() + seconds
        while self.pipe >= 0 and select.select([self.pipe], [], [], max(0.0, deadline - time.monotonic()))[0]:
            self.copy_output()
        time.sleep(max(0.0, deadline - time.monotonic()))


class MetricsKeeper:
    """The metrics file of one task while it runs: its size, and the latencies that are written to it."""

    def __init__(self, folder: str, instance: str) -> None:
        self._folder, self._instance = folder, instance
        self._latency: "LatencyTail | None" = None
        self.next_check = 0.0

    def check_if_due(self) -> None:
        """`check` where its time has come."""
        if time.monotonic() >= self.next_check:
            self.next_check = time.monotonic() + self.check()

    def check(self) -> float:
        """Count the new values of the latency, then limit the file; the seconds until the next check."""
        if self._latency is None and os.path.exists(os.path.join(self._folder, "latency-rule")):
            from ..measure.latency_tail import LatencyTail

            self._latency = LatencyTail(self._folder, self._instance)
        if self._latency is not None:
            self._latency.poll()
        pause_s, size = metrics.limit_metrics_file(self._folder)
        if self._latency is not None and size is not None:
            self._latency.cut_to(size)
        return pause_s

    def reset(self) -> None:
        """Empty the file for the next run of the task."""
        self.check()
        metrics.reset_metrics_file(self._folder)
        if self._latency is not None:
            self._latency.cut_to(0)
