# SPDX-License-Identifier: Apache-2.0
"""Workers of pytest-xdist that are forked from one process which has imported all test modules.

These imports are most of what a worker costs beside its tests. The server collects the tests; then it forks for each
connection to its socket, until its standard input is closed. As a script, this module is what pytest-xdist starts in place of
Python: it hands its standard streams and the code of the worker to the server, and ends with the worker.
"""

import atexit
import os
import select
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress

_MAX_CODE_BYTES = 1 << 16


def start_server(arguments: Sequence[str]) -> str:
    """Start a server that ends with this process; return the command that pytest-xdist starts in place of Python."""
    name = f"edgectl-test-workers-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(f"\0{name}")
        listener.listen()
        code = f"import sys; sys.path[:] = {sys.path}; from tests.workers import serve; serve({listener.fileno()}, sys.argv[1:])"
        server = subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=[listener.fileno()],
        )
    atexit.register(server.communicate)
    return shlex.join([sys.executable, "-I", "-S", __file__, name])


def serve(file: int, arguments: Sequence[str]) -> None:
    """Collect what pytest's ``arguments`` name, and fork for each connection to the socket ``file``.

    Returns when standard input is closed, and in each worker at its end.
    """
    import pytest

    listener = socket.socket(fileno=file)
    pytest.main(["--collect-only", *arguments, "-n", "0", "--dist", "no"])
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    workers = []
    while file in select.select([file, 0], [], [])[0]:
        connection = listener.accept()[0]
        pid = os.fork()
        if pid == 0:
            listener.close()
            _work(connection)
            return
        connection.close()
        workers.append(pid)
    for pid in workers:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def _work(connection: socket.socket) -> None:
    """Run the code of a worker on the streams of the program that connected. That program ends with this process."""
    code, files, _, _ = socket.recv_fds(connection, _MAX_CODE_BYTES, 3)
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)  # noqa: SIM115
    exec(code, {"__name__": "__main__"})


def ask_for_worker(name: str, code: str) -> None:
    """Have the server fork a worker for the streams of this process, and wait for its end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
        connection.connect(f"\0{name}")
        socket.send_fds(connection, [code.encode()], [0, 1, 2])
        nowhere = os.open(os.devnull, os.O_RDWR)
        for number in range(3):
            os.dup2(nowhere, number)
        connection.recv(1)


if __name__ == "__main__":
    ask_for_worker(sys.argv[1], sys.argv[-1])
