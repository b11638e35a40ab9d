# SPDX-License-Identifier: Apache-2.0
"""The container of a task as its supervisor sees it: a runner below it in place of the command."""

import _signal as signal
import os
import select
import time

from ..link import fast_json
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import proc
from ..supervise import signals, spawn
from ..supervise.command import Command
from . import ending, engine, record, runner
from .create import NAME_VARIABLE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, NoReturn

    from ..supervise.logfile import LogWriter

# Create, start and the calls between them, each with its own bound.
REPORT_S = runner.CREATE_S + runner.START_S + 35.0
_MAX_NOTES_BYTES = 65536


class ContainerCommand(Command):
    """Starts the runner, hears its notes, finds and signals what is in the container."""

    def __init__(self, folder: str, lock: int, log: "LogWriter", identity: Document, spec: Document) -> None:
        """As a command; ``identity`` and ``spec`` of the task."""
        super().__init__(folder, lock, log)
        self._folder, self._identity, self._spec = folder, identity, spec
        self._data = b""
        # (pid, start ticks) of the first process in the container.
        self._main = (0, -1)
        # Why the container ended, where its exit code does not say it.
        self._detail = ""
        self._ran = False
        self._name = ""
        # Read before the supervisor could hear it.
        self._heard: "list[Document]" = []

    def start(self, spec: Document, env: "dict[str, str]") -> None:
        """Start a run: the first one until the container runs, a later one at once, which then waits for an
        engine that does not answer. So does a first one of which a swarm does not say whether it starts.

        Raises:
            OSError: it did not start.
        """
        del spec, env  # the runner has its own
        self.take_lock()
        self.resumed, self.waits = False, self._ran
        self._detail, self._main, self.interrupted = "", (0, -1), False
        pid, pipe = self._fork(self.lock, lambda found: found.run(patient=self._ran))
        if not self.waits:
            self._await_start(pid, pipe)
        self.pid, self.pipe, self._ran = pid, pipe, True
        self.log.begin_run()
        self.ticks, self.started = self._main[1], time.monotonic()

    def take_over(self, status: Document) -> None:
        """Follow the container of an orphan by a runner of our own, which has the lock."""
        del status
        self.take_lock()
        found = record.read_container(self._folder)
        self._main = int(found.get("pid", 0)), int(found.get("ticks", -1))
        self._name = str(found.get("name") or "")
        self.pid, self.pipe = self._fork(self.lock, lambda each: each.resume())
        self.resumed, self._ran, self.ticks = True, True, self._main[1]
        self.started = time.monotonic() - proc.age_s_from_ticks(self.ticks)
        self.log.begin_run()

    def get_main(self) -> "tuple[int, int]":
        """Get (pid, start ticks) of the first process in the container."""
        return self._main

    def find_main_process(self) -> int:
        """Find the process that checks mean."""
        return self._main[0]

    def get_variables(self) -> "dict[str, str]":
        """Get the name of the container, which checks are given."""
        return {NAME_VARIABLE: self._name} if self._name else {}

    def describe_end(self, code: int) -> Document:
        """Describe the end of the container by the wait status of its runner."""
        self.read_notes()
        outcome = spawn.describe_exit(code)
        return dict(outcome, detail=self._detail or outcome["detail"])

    def _fork(self, lock: int, work: "Callable[[runner.ContainerRunner], int]") -> "tuple[int, int]":
        self.close()
        output, output_end = os.pipe()
        self.notes, notes_end = os.pipe()
        os.set_blocking(self.notes, False)
        pid = os.fork()
        if pid == 0:
            self._become_runner(lock, output_end, notes_end, work)
        os.close(output_end)
        os.close(notes_end)
        return pid, output

    def _become_runner(
        self, lock: int, output: int, notes: int, work: "Callable[[runner.ContainerRunner], int]"
    ) -> "NoReturn":
        """In the child: run, and end with the exit code of the container."""
        code = 1
        try:
            os.setsid()
            signal.set_wakeup_fd(-1)
            spawn.reset_signals()
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
                # A stop asks the container, whose end is this one's.
                signal.signal(number, signal.SIG_IGN)
            os.dup2(output, 1)
            os.dup2(output, 2)
            spawn.close_other_fds({0, 1, 2, lock, notes})
            code = work(self._build_runner(notes, lock))
        except (runner.StartError, RefusalError) as error:
            _fail(notes, error.message, error.hint)
        except Exception as error:  # noqa: BLE001 - the pipe is the only channel left
            _fail(notes, "%s: %s" % (type(error).__name__, error), "")
        finally:
            os._exit(code)

    def _build_runner(self, notes: int, lock: int) -> runner.ContainerRunner:
        if self._spec["image"].get("engine") != engine.SWARM:
            return runner.ContainerRunner(self._folder, self._identity, self._spec, notes)
        from .service_runner import ServiceRunner

        return ServiceRunner(self._folder, self._identity, self._spec, notes, lock)

    def _await_start(self, pid: int, output: int) -> None:
        """Wait for the first note."""
        deadline = time.monotonic() + REPORT_S
        while time.monotonic() < deadline:
            select.select([self.notes], [], [], 0.5)
            for note in self.read_notes():
                if note["event"] == "started":
                    return
                if note["event"] == "lost":
                    self.waits, self._heard = True, [note]
                    return
                if note["event"] == "failed":
                    os.close(output)
                    os.waitpid(pid, 0)
                    self.close()
                    raise OSError(note["reason"])
            if self.notes < 0:
                break
        os.close(output)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        raise OSError("the container did not start in time")

    def read_notes(self) -> "list[Document]":
        """Read what the runner has to say, without waiting; the pipe is closed at its end."""
        heard, self._heard = self._heard, []
        if self.notes < 0:
            return heard
        try:
            data = os.read(self.notes, _MAX_NOTES_BYTES)
        except BlockingIOError:
            return heard
        if not data:
            self.close()
        *lines, self._data = (self._data + data).split(b"\n")
        found = [fast_json.loads(line.decode("ascii")) for line in lines]
        for note in found:
            if note["event"] == "started":
                self._main, self._name = (int(note["pid"]), int(note["ticks"])), str(note["name"])
                self.ticks, self.started = self._main[1], time.monotonic()
            elif note["event"] == "interrupted":
                self.interrupted = True
            elif note["event"] == "ended":
                self._detail = str(note["detail"])
            elif note["event"] == "failed":
                self._detail = str(note["reason"])
        return heard + found

    def close(self) -> None:
        """Close the pipe of the notes."""
        if self.notes >= 0:
            os.close(self.notes)
        self.notes, self._data = -1, b""

    def _find_tree(self, table: "dict[int, proc.Process]") -> "set[int]":
        """Find the runner, what it has started, and the processes in the container."""
        inside = record.find_container_processes(self._folder, table)
        return super()._find_tree(table) | inside

    def _signal_step(
        self,
        step: "tuple[str, str, float]",
        left: "set[int]",
        table: "dict[int, proc.Process]",
        sent: "set[tuple[int, int, int]]",
    ) -> "set[tuple[int, int, int]]":
        """Send one step of a stop."""
        return ending.signal_step(self._folder, signals.parse_signal(step[0]), left, table, sent)


def describe_loss(note: Document) -> str:
    """Describe that the engine does not answer, or that a swarm has not started the container yet."""
    if note["asked"]:
        return "waiting for %s to start the container" % note["engine"]
    what = "the container runs on without it" if note["alive"] else "waiting for it to start the container"
    return "%s does not answer: %s" % (note["engine"], what)


def _fail(notes: int, reason: str, hint: str) -> None:
    text = "%s; %s" % (reason, hint) if hint else reason
    document = {"event": "failed", "reason": text, "hint": hint}
    try:
        os.write(notes, fast_json.dumps(document).encode("ascii") + b"\n")
    except OSError:
        pass
