# SPDX-License-Identifier: Apache-2.0
"""Operations ``save-state`` and ``load-state``: run what prints the state of an instance, and what reads it.

Neither the state nor more than the end of a command's error output is ever part of a reply.
"""

import hashlib
import os
import select
import sys
import time

from ..link import protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..ros.local import fill_request, list_setup_files
from . import shell, state_dir, state_spool, status, task_dirs
from .liveness import InstanceRecord

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, Callable

_BLOCK = 1 << 18
_POLL_S, _FIRST_POLL_S, _RETRY_S = 0.02, 0.001, 0.3
_KEPT_BYTES, _MOST_WORDS = 2048, 300
# By so much the program for a topic ends before the request.
_TOPIC_MARGIN_S = 2.0
_KILL_SIGNAL = 9


class StateCommand:
    """A running command; its whole process group ends with it, also at the deadline of the request.

    Only its standard output or input is the state: the end of its error output is kept for a message.
    """

    def __init__(self, argv: "list[str]", env: "dict[str, str]", cwd: str, stdin: "int | None") -> None:
        import subprocess

        self.kept = b""
        self.process = subprocess.Popen(
            argv,
            stdin=subprocess.DEVNULL if stdin is None else stdin,
            stdout=subprocess.PIPE if stdin is None else subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=env,
            cwd=cwd,
            start_new_session=True,
        )
        shell.ShellCommand.running.add(self)
        self._out = self.process.stdout.fileno() if self.process.stdout else -1
        self._error = self.process.stderr.fileno() if self.process.stderr else -1
        self._open = {fd for fd in (self._out, self._error) if fd >= 0}
        for fd in self._open:
            os.set_blocking(fd, False)

    def finish(self, deadline: float, take: "Callable[[bytes], None]") -> "int | None":
        """Pass its output to ``take`` until it has ended: the exit status, None at the ``deadline``."""
        pause = _FIRST_POLL_S
        try:
            while True:
                ended = (
                    os.waitid(os.P_PID, self.process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
                )
                if ended:
                    self._kill()
                moved = self._drain(take)
                while ended and moved and time.monotonic() < deadline:
                    moved = self._drain(take)
                if ended or time.monotonic() >= deadline:
                    return self.end() if ended else None
                if not moved:
                    select.select(list(self._open), [], [], pause if not self._open else _POLL_S)
                    pause = min(_POLL_S, 2 * pause) if not self._open else pause
        finally:
            self.end()

    def _drain(self, take: "Callable[[bytes], None]") -> bool:
        """Read one block of each output; False where there is none."""
        moved = False
        for fd in list(self._open):
            try:
                data = os.read(fd, _BLOCK)
            except BlockingIOError:
                continue
            moved = moved or bool(data)
            if not data:
                self._open.discard(fd)
            elif fd == self._error:
                self.kept = (self.kept + data)[-_KEPT_BYTES:]
            else:
                take(data)
        return moved

    def _kill(self) -> None:
        try:
            os.killpg(self.process.pid, _KILL_SIGNAL)
        except OSError:
            pass

    def end(self) -> int:
        """Kill what is left of its process group and reap it."""
        if self in shell.ShellCommand.running:
            shell.ShellCommand.running.discard(self)
            self._kill()
            self.process.wait()
            for pipe in (self.process.stdout, self.process.stderr):
                if pipe is not None:
                    pipe.close()
        return int(self.process.returncode)


def save_state(request: Document) -> Document:
    """Keep what the command (or the latched topic) of the request says to be the state of the instance.

    Raises:
        RefusalError: the instance does not run here; the command failed, hung, printed nothing, or more than
            ``max_bytes``.
        OSError: the disk is full.
    """
    record = _find_instance(request)
    shell.install_deadline_handlers()
    began, most, size, digest = time.monotonic(), int(request["max_bytes"]), 0, hashlib.sha256()
    fd = state_spool.open_new_spool(record.folder)

    def take(data: bytes) -> None:
        nonlocal size
        size += len(data)
        if size > most:
            raise RefusalError(
                "too-large",
                "the state of %s is larger than %d bytes" % (request["task"], most),
                "raise max_size of its state, or have save print less",
            )
        digest.update(data)
        view = memoryview(data)
        while view:
            view = view[os.write(fd, view) :]

    try:
        command = _start_command(request, record, None)
        _check_exit(request, command, command.finish(began + float(request["timeout_s"]), take), "save")
        _check_size(request, size)
    except (OSError, RefusalError):
        task_dirs.drop_spools(request["host"], request["task"])
        raise
    finally:
        os.close(fd)
    seconds = round(time.monotonic() - began, 4)
    return {"state": "saved", "size": size, "sha256": digest.hexdigest(), "seconds": seconds}


def load_state(request: Document) -> Document:
    """Check the state that was sent here, and give it to the instance.

    ``repeat``: an instance that was just started may not take it yet; the command is repeated until its
    timeout.

    Raises:
        RefusalError: the state is not what was saved, the instance does not run here, or the command failed.
    """
    record = _find_instance(request)
    shell.install_deadline_handlers()
    began = time.monotonic()
    fd = state_spool.open_spool(request["host"], request["task"])
    try:
        if _hash_file(fd) != (int(request["size"]), request["sha256"]):
            message = "the state of %s did not arrive as it was saved" % request["task"]
            raise RefusalError("bad-state", message, "apply again")
        tries = _repeat_load(request, record, fd)
    finally:
        os.close(fd)
    return {"state": "loaded", "seconds": round(time.monotonic() - began, 4), "tries": tries}


def _repeat_load(request: Document, record: InstanceRecord, fd: int) -> int:
    """Run ``load`` until it succeeds; returns how often it ran."""
    deadline, tries = time.monotonic() + float(request["timeout_s"]), 0
    while True:
        tries += 1
        os.lseek(fd, 0, os.SEEK_SET)
        command = _start_command(request, record, fd)
        code = command.finish(deadline, lambda _: None)
        if code == 0:
            return tries
        if not request.get("repeat") or code is None or time.monotonic() + _RETRY_S >= deadline:
            _check_exit(request, command, code, "load")
        _find_instance(request)
        time.sleep(_RETRY_S)


def _hash_file(fd: int) -> "tuple[int, str]":
    """Compute (size, SHA-256) block by block: a state is larger than what a request may take of memory."""
    size, digest = 0, hashlib.sha256()
    while True:
        data = os.pread(fd, _BLOCK, size)
        if not data:
            return size, digest.hexdigest()
        size += len(data)
        digest.update(data)


def _find_instance(request: Document) -> InstanceRecord:
    """Find the living instance. Raises RefusalError where another one lives here, or none."""
    host, task = state_dir.check_name(request["host"]), state_dir.check_name(request["task"])
    status.check_generation(host, task, int(request["generation"]))
    record, alive = status.find_current(host, task)
    if record is None or not alive or request["instance"] not in (None, record.instance.get("instance")):
        message = "instance %s of %s does not run here" % (request["instance"], task)
        raise RefusalError(protocol.NOT_RUNNING, message, "apply again")
    return record


def _start_command(request: Document, record: InstanceRecord, stdin: "int | None") -> StateCommand:
    filled = fill_request(request)
    env = shell.build_environment(filled.get("env"))
    env["EDGECTL_PID"] = str(record.status.get("pid", 0))
    env["EDGECTL_INSTANCE"] = str(record.instance.get("instance", ""))
    setup, command = list_setup_files(filled), str(filled["command"])
    folder = shell.resolve_workdir(filled.get("workdir"), env)
    if filled.get("topic"):
        env.update(_build_topic_variables(filled, record.folder))
        command, folder = 'exec python3 -c "$EDGECTL_STATE_PROGRAM" %s', "/"
        command %= "save" if stdin is None else "load"
    return StateCommand(shell.build_argv(command, filled.get("prelude") or "", setup), env, folder, stdin)


def _build_topic_variables(request: Document, folder: str) -> "dict[str, str]":
    """Build what the program for a topic needs; it is run by the Python that the task has."""
    loader: "Any" = sys.modules[__name__].__loader__
    topic = request["topic"]
    program = loader.read_sources()["edgectl_agent/ros/latched%d.py" % topic["version"]]
    return {
        "EDGECTL_STATE_PROGRAM": str(program, "utf-8"),
        "EDGECTL_STATE_TOPIC": str(topic["name"]),
        "EDGECTL_STATE_OF": folder,
        "EDGECTL_STATE_SECONDS": str(max(1.0, float(request["timeout_s"]) - _TOPIC_MARGIN_S)),
    }


def _check_exit(request: Document, command: StateCommand, code: "int | None", word: str) -> None:
    """Raise RefusalError unless the command has succeeded."""
    if code == 0:
        return
    why = "exit code %d" % code if code is not None else "no end within %g s" % float(request["timeout_s"])
    said = command.kept.decode("utf-8", "replace").strip().splitlines()
    words = ": " + said[-1][:_MOST_WORDS] if said else ""
    message = "%s of %s failed: %s%s" % (word, request["task"], why, words)
    raise RefusalError(word + "-failed", message, _build_hint(word))


def _check_size(request: Document, size: int) -> None:
    """Raise RefusalError where nothing was printed: an empty state is taken for a mistake."""
    if not size:
        message = "save of %s printed nothing" % request["task"]
        raise RefusalError("no-state", message, _build_hint("save"))


def _build_hint(word: str) -> str:
    return "run %s by hand on the host, or remove state: of the task" % word
