"""edgectl in processes that are forked from one that has imported it: real processes that need no start of Python.

The start and the imports are two thirds of the CPU time of a short command. A forked edgectl has its own pid, session,
environment and files, like a started one; only its modules are loaded already. What a start itself does is tested in
`tests/cli` with started processes.

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
from functools import cache
from pathlib import Path
from typing import Any

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
_MAX_REQUEST_BYTES = 1 << 17
_CLONE_NEWNET = 0x40000000


class ForkedProcess(subprocess.Popen[str]):
    """A forked process with the methods of Popen that the tests use. Its output goes to files, read at its end."""

    def __init__(self, argv: Sequence[str], *, program: str, env: Mapping[str, str], netns: str = "") -> None:
        """Run the Python source ``program`` with ``sys.argv`` = ``argv``, in the network namespace at ``netns``."""
        self._child_created = False  # nothing for Popen to reap
        self.args, self.returncode = list(argv), None
        self._output = [os.memfd_create(name) for name in ("stdout", "stderr")]
        self._status, status = os.pipe()
        request = {
            "argv": list(argv),
            "program": program,
            "env": dict(env),
            "cwd": str(Path.cwd()),
            "netns": netns,
        }
        with Path(os.devnull).open() as nothing:
            files = [nothing.fileno(), *self._output, status]
            socket.send_fds(start_server(), [json.dumps(request).encode()], files)
        os.close(status)
        self._said = b""
        self.pid = int(self._read_line(None))

    def _read_line(self, timeout: float | None) -> bytes:
        """Raises TimeoutExpired; the status of a process that was killed with its server is that of SIGKILL."""
        until = None if timeout is None else time.monotonic() + timeout
        while b"\n" not in self._said:
            left = None if until is None else max(0.0, until - time.monotonic())
            if not select.select([self._status], [], [], left)[0]:
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
            self._said += os.read(self._status, 64) or b"%d\n" % signal.SIGKILL
        line, _, self._said = self._said.partition(b"\n")
        return line

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(int(self._read_line(timeout)))
            os.close(self._status)
            self._texts = [_read_and_close(file) for file in self._output]
        return int(self.returncode)

    def poll(self) -> int | None:
        try:
            return self.wait(0.0)
        except subprocess.TimeoutExpired:
            return None

    def communicate(self, input: str | None = None, timeout: float | None = None) -> tuple[str, str]:  # noqa: A002 - as Popen
        assert input is None
        self.wait(timeout)
        out, err = self._texts
        return out, err

    def end(self) -> None:
        """Kill it with its process group, if it still runs."""
        if self.poll() is None:
            os.killpg(self.pid, signal.SIGKILL)
            self.wait()


def _read_and_close(file: int) -> str:
    os.lseek(file, 0, os.SEEK_SET)
    with os.fdopen(file, encoding="utf-8", errors="replace") as text:
        return text.read()


@cache
def start_server() -> socket.socket:
    """Start the server of this test process; it ends with this process."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    server = subprocess.Popen(
        [sys.executable, "-m", "tests.forkserver", str(theirs.fileno())],
        cwd=Path(__file__).parent.parent,
        env={"PATH": os.defpath, "LC_ALL": "C.UTF-8"},
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
            importlib.import_module(module.name)
    gc.freeze()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        data, files, _, _ = socket.recv_fds(connection, _MAX_REQUEST_BYTES, 4)
        if not data:
            return
        if os.fork() == 0:
            _run_and_report(json.loads(data), files)
        for file in files:
            os.close(file)


def _run_and_report(request: dict[str, Any], files: list[int]) -> None:
    """Run the program in a child process, and write its pid and its wait status."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    pid = os.fork()
    if pid == 0:
        _run_program(request, files)
    for file in files[:3]:
        os.close(file)
    os.write(files[3], b"%d\n" % pid)
    os.write(files[3], b"%d\n" % os.waitpid(pid, 0)[1])
    os._exit(0)


def _run_program(request: dict[str, Any], files: list[int]) -> None:
    os.setsid()
    for number, file in enumerate(files[:3]):
        os.dup2(file, number)
    os.closerange(3, 1024)
    if request["netns"]:
        with Path(request["netns"]).open() as namespace:
            assert ctypes.CDLL(None).setns(namespace.fileno(), _CLONE_NEWNET) == 0
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["env"])
    sys.argv = request["argv"]
    exec(request["program"], {"__name__": "__main__"})
    sys.exit(0)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
