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
from ..supervise import spawn
from . import ending, record, runner

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, NoReturn

# Create, start and the calls between them, each with its own bound.
REPORT_S = runner.CREATE_S + runner.START_S + 35.0
_MAX_NOTES_BYTES = 65536


class ContainerCommand:
    """Starts the runner, hears its notes, finds and signals what is in the container."""

    def __init__(self, folder: str, identity: Document, spec: Document) -> None:
        self._folder, self._identity, self._spec = folder, identity, spec
        self.notes = -1
        self._data = b""
        # (pid, start ticks) of the first process in the container.
        self.main = (0, -1)
        # Why the container ended, where its exit code does not say it.
        self.detail = ""

    def start(self, lock: int, *, patient: bool) -> "tuple[int, int]":
        """Create and start the container: (pid of the runner, read end of its output).

        ``patient``: return at once, and wait for an engine that does not answer; else only once it runs.

        Raises:
            OSError: it did not start.
        """
        self.detail, self.main = "", (0, -1)
        pid, output = self._fork(lock, lambda found: found.run(patient=patient))
        if not patient:
            self._await_start(pid, output)
        return pid, output

    def resume(self, lock: int) -> "tuple[int, int]":
        """Follow the living container of the record: (pid of the runner, read end of its output)."""
        found = record.read_container(self._folder)
        self.main = int(found.get("pid", 0)), int(found.get("ticks", -1))
        return self._fork(lock, lambda each: each.resume())

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
            found = runner.ContainerRunner(self._folder, self._identity, self._spec, notes)
            code = work(found)
        except (runner.StartError, RefusalError) as error:
            _fail(notes, error.message, error.hint)
        except Exception as error:  # noqa: BLE001 - the pipe is the only channel left
            _fail(notes, "%s: %s" % (type(error).__name__, error), "")
        finally:
            os._exit(code)

    def _await_start(self, pid: int, output: int) -> None:
        """Wait for the first note."""
        deadline = time.monotonic() + REPORT_S
        while time.monotonic() < deadline:
            select.select([self.notes], [], [], 0.5)
            for note in self.read_notes():
                if note["event"] == "started":
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
        if self.notes < 0:
            return []
        try:
            data = os.read(self.notes, _MAX_NOTES_BYTES)
        except BlockingIOError:
            return []
        if not data:
            self.close()
        *lines, self._data = (self._data + data).split(b"\n")
        found = [fast_json.loads(line.decode("ascii")) for line in lines]
        for note in found:
            if note["event"] == "started":
                self.main = int(note["pid"]), int(note["ticks"])
            elif note["event"] == "ended":
                self.detail = str(note["detail"])
            elif note["event"] == "failed":
                self.detail = str(note["reason"])
        return found

    def close(self) -> None:
        """Close the pipe of the notes."""
        if self.notes >= 0:
            os.close(self.notes)
        self.notes, self._data = -1, b""

    def find_processes(self, table: "dict[int, proc.Process]") -> "set[int]":
        """Find the processes in the container."""
        return record.find_container_processes(self._folder, table)

    def signal_step(
        self,
        number: int,
        left: "set[int]",
        table: "dict[int, proc.Process]",
        sent: "set[tuple[int, int, int]]",
    ) -> "set[tuple[int, int, int]]":
        """Send one step of a stop."""
        return ending.signal_step(self._folder, number, left, table, sent)


def describe_loss(note: Document) -> str:
    """Describe that the engine does not answer."""
    what = "the container runs on without it" if note["alive"] else "waiting for it to start the container"
    return "%s does not answer: %s" % (note["engine"], what)


def _fail(notes: int, reason: str, hint: str) -> None:
    text = "%s; %s" % (reason, hint) if hint else reason
    document = {"event": "failed", "reason": text, "hint": hint}
    try:
        os.write(notes, fast_json.dumps(document).encode("ascii") + b"\n")
    except OSError:
        pass
