# SPDX-License-Identifier: Apache-2.0
"""edgectl in processes that are forked from one that has imported it: real processes that need no start of Python.

The start and the imports are two thirds of the CPU time of a short command. A forked edgectl has its own pid, session,
environment and files, like a started one; only its modules are loaded already, and ``/proc/PID/environ`` is that of the
server. What a start itself does is tested in `tests/cli` with started processes.

``python -m tests.forkserver FD`` is the server: it serves requests on the socket FD until that is closed, and has no
threads. A request is one JSON document with four files: the three standard streams, and a pipe for pid and wait status.
"""

import atexit
import ctypes
import gc
import importlib
import json
import os
import pkgutil
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

EDGECTL = "import sys; from edgectl.cli.main import main; sys.exit(main(sys.argv[1:]))"
_ROOMS = (
    "cli",
    "config",
    "executor",
    "formats",
    "gateway",
    "rules",
    "scheduler",
    "state",
    "transport",
    "usecases",
    "views",
)
_Stream = int | IO[Any] | None
_MAX_REQUEST_BYTES = 1 << 17
_CLONE_NEWNET = 0x40000000


class ForkedProcess(subprocess.Popen[str]):
    """A forked process, used like ``Popen`` in text mode. It leads a session of its own."""

    def __init__(
        self,
        words: Sequence[str],
        *,
        program: str = EDGECTL,
        netns: str = "",
        cwd: Path | None = None,
        env: Mapping[str, str] | None = None,
        stdin: _Stream = subprocess.DEVNULL,
        stdout: _Stream = None,
        stderr: _Stream = None,
    ) -> None:
        """Run the Python source ``program`` with the arguments ``words``, in the network namespace at ``netns``."""
        self._said = b""
        self._request = {
            "argv": ["edgectl", *words],
            "program": program,
            "env": dict(os.environ if env is None else env),
            "cwd": str(cwd or Path.cwd()),
            "netns": netns,
        }
        super().__init__(
            list(words),
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            encoding="utf-8",
            errors="replace",
        )

    def _execute_child(self, *args: Any) -> None:
        """Let the server fork instead of this process. The streams are three pairs of pipe ends, -1 if inherited."""
        ends = args[10:16]
        status, theirs = os.pipe()
        self._status = open(status, "rb", buffering=0)  # noqa: SIM115, PTH123 - closed with the status
        streams = [end if end >= 0 else number for number, end in enumerate((ends[0], ends[3], ends[5]))]
        try:
            socket.send_fds(start_server(), [json.dumps(self._request).encode()], [*streams, theirs])
        finally:
            os.close(theirs)
            self._close_pipe_fds(*ends)  # type: ignore[attr-defined]
        self.pid = int(self._read_line() or 0)
        self._child_created = True

    def _read_line(self, *, blocking: bool = True) -> bytes:
        """Empty if there is none yet; the status of a process that was killed with its server is that of SIGKILL."""
        while b"\n" not in self._said:
            if not select.select([self._status], [], [], None if blocking else 0.0)[0]:
                return b""
            self._said += self._status.read(64) or b"%d\n" % signal.SIGKILL
        line, _, self._said = self._said.partition(b"\n")
        return line

    def _try_wait(self, wait_flags: int) -> tuple[int, int]:
        line = self._read_line(blocking=not wait_flags)
        if line:
            self._status.close()
        return (self.pid, int(line)) if line else (0, 0)

    def _internal_poll(self, _deadstate: int | None = None) -> int | None:
        if self.returncode is None:
            pid, status = self._try_wait(os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def end(self) -> None:
        """Kill it with its process group, if it still runs."""
        if self.poll() is None:
            os.killpg(self.pid, signal.SIGKILL)
            self.wait()


def run_edgectl(
    *words: str,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    stdout: _Stream = subprocess.PIPE,
    timeout: float = 60.0,
) -> subprocess.CompletedProcess[str]:
    """Run a forked edgectl to its end. Raises TimeoutExpired after killing it."""
    with ForkedProcess(words, cwd=cwd, env=env, stdout=stdout, stderr=subprocess.PIPE) as process:
        try:
            out, err = process.communicate(timeout=timeout)
        finally:
            process.end()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


@cache
def start_server() -> socket.socket:
    """Start the server of this test process; it ends with this process."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    path = {name: value for name, value in os.environ.items() if name == "PYTHONPATH"}
    server = subprocess.Popen(
        [sys.executable, "-m", "tests.forkserver", str(theirs.fileno())],
        cwd=Path(__file__).parent.parent,
        env={"PATH": os.defpath, "LC_ALL": "C.UTF-8", **path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        pass_fds=[theirs.fileno()],
        start_new_session=True,
    )
    theirs.close()

    def end() -> None:
        ours.close()
        server.wait()

    atexit.register(end)
    return ours


def serve(connection: socket.socket) -> None:
    """Fork for each request; returns when the connection is closed. Raises SystemExit in a forked process."""
    for room in _ROOMS:
        package = importlib.import_module(f"edgectl.{room}")
        for module in pkgutil.iter_modules(package.__path__, f"edgectl.{room}."):
            _import_if_installed(module.name)
    gc.freeze()
    while True:
        data, files, _, _ = socket.recv_fds(connection, _MAX_REQUEST_BYTES, 4)
        _reap_children()
        if not data:
            return
        if os.fork() == 0:
            _run_and_report(json.loads(data), files)
        for file in files:
            os.close(file)


def _import_if_installed(module: str) -> None:
    """Import a module, unless it belongs to an extra that is not installed: ``make demo`` installs none."""
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] in ("edgectl", "tests"):
            raise


def _reap_children() -> None:
    """Their CPU time counts as that of the test process when the server has ended."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _run_and_report(request: dict[str, Any], files: list[int]) -> None:
    """Run the program in a child process, and write its wait status."""
    pid = os.fork()
    if pid == 0:
        _run_program(request, files)
    for file in files[:3]:
        os.close(file)
    os.write(files[3], b"%d\n" % os.waitpid(pid, 0)[1])
    os._exit(0)


def _run_program(request: dict[str, Any], files: list[int]) -> None:
    """Write the pid as soon as it can be killed with its group, and run the program."""
    os.setsid()
    os.write(files[3], b"%d\n" % os.getpid())
    for number, file in enumerate(files[:3]):
        os.dup2(file, number)
    os.closerange(3, 1024)
    if request["netns"]:
        with Path(request["netns"]).open() as namespace:
            assert ctypes.CDLL(None).setns(namespace.fileno(), _CLONE_NEWNET) == 0
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["env"])
    time.tzset()
    sys.stdin = open(0, closefd=False)  # noqa: SIM115 - as at a start, buffered like the file at hand
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    sys.argv = request["argv"]
    exec(request["program"], {"__name__": "__main__"})
    sys.exit(0)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
