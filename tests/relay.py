# SPDX-License-Identifier: Apache-2.0
"""TCP relay that stalls or breaks a connection at a chosen byte, like a bad radio link."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from enum import StrEnum


class RelayFault(StrEnum):
    """Fault after ``after`` bytes from the server."""

    SILENCE = "silence"
    CUT = "cut"


class Relay:
    """Listens on ``port`` of 127.0.0.1 and forwards bytes to ``target`` until the fault."""

    def __init__(self, target: tuple[str, int], fault: RelayFault, after: int) -> None:
        self._target = target
        self._fault = fault
        self._left = after
        self._open: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._spawn(self._serve)

    def close(self) -> None:
        for line in [self._listener, *self._open]:
            with contextlib.suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)
            line.close()
        for thread in self._threads:
            thread.join(5)

    def _spawn(self, work: object, *args: object) -> None:
        thread = threading.Thread(target=work, args=args, daemon=True)  # type: ignore[arg-type]
        self._threads.append(thread)
        thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                server = socket.create_connection(self._target)
                self._open += [client, server]
                self._spawn(self._forward, client, server)
                self._spawn(self._backward, server, client)

    def _forward(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if self._left > 0 or self._fault is RelayFault.CUT:
                    sink.sendall(data)
            sink.shutdown(socket.SHUT_WR)

    def _backward(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if self._left > 0:
                    sink.sendall(data[: self._left])
                self._left -= len(data)
                if self._left <= 0 and self._fault is RelayFault.CUT:
                    sink.shutdown(socket.SHUT_RDWR)
                    source.shutdown(socket.SHUT_RDWR)
                    return


@contextlib.contextmanager
def run_relay(target: tuple[str, int], fault: RelayFault, after: int) -> Iterator[int]:
    """Run a relay; yields its port."""
    running = Relay(target, fault, after)
    try:
        yield running.port
    finally:
        running.close()


@contextlib.contextmanager
def run_mute_server() -> Iterator[int]:
    """Run a server that accepts connections and never answers, like a frozen host; yields its port."""
    with socket.create_server(("127.0.0.1", 0), backlog=50) as listener:
        yield int(listener.getsockname()[1])


def count_callers(listener: socket.socket) -> int:
    """Count the connections that nobody has accepted yet."""
    listener.setblocking(False)
    number = 0
    with contextlib.suppress(BlockingIOError):
        while True:
            listener.accept()[0].close()
            number += 1
    return number
