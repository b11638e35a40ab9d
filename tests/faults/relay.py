# SPDX-License-Identifier: Apache-2.0
"""TCP relay between manager and sshd that injects link faults. Standard library only; one thread per relay.

``LinkFault`` says which fault occurs after how many bytes. Bytes are counted since the fault was set, over
all connections and both directions, so that one number addresses any byte of an exchange of several
connections.
"""

import ctypes
import os
import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.link_fault import LinkFault, LinkFaultKind

CHUNK = 16384
BACKLOG_LIMIT = 1 << 20
ONE_WAY = {LinkFaultKind.ANSWERS_LOST: True, LinkFaultKind.REQUESTS_LOST: False}
"""Whether of the one direction that is left the far end, the host, is the receiver."""
CLONE_NEWNET = 0x40000000


@dataclass(eq=False)
class _Endpoint:
    """One end of a relayed connection: its socket, its peer and its send queue."""

    sock: socket.socket
    other: "_Endpoint | None" = None
    out: deque[tuple[float, bytes]] = field(default_factory=deque)
    held: int = 0
    finished: bool = False
    closing: bool = False
    far: bool = False


class Relay:
    """Listens on ``address`` (port chosen once) and forwards to ``target``; ``netns`` is the path of a
    network namespace.
    """

    def __init__(
        self, target: tuple[str, int], *, address: str = "127.0.0.1", netns: Path | None = None
    ) -> None:
        self.target = target
        self.address = address
        self.port = 0
        self.passed = 0
        self.connections = 0
        self.fired = False
        self._netns = netns
        self._fault = LinkFault()
        self._next_fault = LinkFault()
        self._down = False
        self._ending = False
        self._endpoints: dict[socket.socket, _Endpoint] = {}
        self._selector = selectors.DefaultSelector()
        self._wake, self._waker = socket.socketpair()
        self._done = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=f"relay {target}", daemon=True)

    def start(self) -> None:
        """Start to listen."""
        self._send_command(self._thread.start)

    def set(self, fault: LinkFault) -> None:
        """Set the fault for open and new connections; returns once it is in force."""
        self._next_fault = fault
        self._send_command(lambda: self._waker.send(b"t"))

    def heal(self) -> None:
        """Forward everything again. Connections that lost bytes stay broken."""
        self.set(LinkFault())

    def drop(self) -> None:
        """Reset every open connection."""
        self._send_command(lambda: self._waker.send(b"d"))

    def stop(self) -> None:
        """Close all connections and end the thread."""
        self._ending = True
        with suppress(OSError):
            self._waker.send(b"e")
        self._thread.join(10)
        assert not self._thread.is_alive(), "the relay's thread does not end"
        self._wake.close()
        self._waker.close()

    def _send_command(self, give: object) -> None:
        self._done.clear()
        give()  # type: ignore[operator]
        assert self._done.wait(60), "the relay does not answer"
        if self._error:
            raise self._error

    # The methods below run in the relay's thread.

    def _run(self) -> None:
        try:
            if self._netns:
                enter_netns(self._netns)
            self._selector.register(self._wake, selectors.EVENT_READ)
            self._listen()
            self._done.set()
            while not self._ending:
                self._handle_events()
        except BaseException as error:  # wake the waiting caller
            self._error = error
            self._done.set()
        finally:
            for sock in [*self._endpoints, *self._listener]:
                sock.close()
            self._selector.close()

    _listener: tuple[socket.socket, ...] = ()

    def _listen(self) -> None:
        listener = socket.socket()
        self._listener = (listener,)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((self.address, self.port))
        listener.listen(64)
        listener.setblocking(False)
        self.port = listener.getsockname()[1]
        self._selector.register(listener, selectors.EVENT_READ)

    def _stop_listening(self) -> None:
        for listener in self._listener:
            self._selector.unregister(listener)
            listener.close()
        self._listener = ()

    def _handle_events(self) -> None:
        for key, events in self._selector.select(self._compute_timeout()):
            sock = key.fileobj
            assert isinstance(sock, socket.socket)
            if sock is self._wake:
                self._execute_command()
            elif sock in self._listener:
                self._accept(sock)
            elif sock in self._endpoints:
                if events & selectors.EVENT_READ:
                    self._read(self._endpoints[sock])
                if sock in self._endpoints and events & selectors.EVENT_WRITE:
                    self._write(self._endpoints[sock])
        for side in list(self._endpoints.values()):
            if side.sock in self._endpoints:
                self._select_events(side)

    def _compute_timeout(self) -> float | None:
        due = [side.out[0][0] for side in self._endpoints.values() if side.out]
        return max(0.0, min(due) - time.monotonic()) if due else None

    def _execute_command(self) -> None:
        for order in self._wake.recv(64):
            if order == ord("d"):
                self._close_all(reset=True)
            elif order == ord("t"):
                if self.fired and self._fault.kind is LinkFaultKind.BLACK_HOLE:
                    # Bytes were lost: the next packet after the black hole must break the connection.
                    self._close_all(reset=True, far=not self._fault.half_open)
                self._fault, self.passed, self.fired = self._next_fault, 0, False
                self._set_listening(closed=self._fault.kind is LinkFaultKind.REFUSE)
                if self._fault.kind is LinkFaultKind.REFUSE:
                    self._close_all(reset=True)
        self._done.set()

    def _set_listening(self, *, closed: bool) -> None:
        if closed and self._listener:
            self._stop_listening()
        elif not closed and not self._listener:
            self._listen()

    def _accept(self, listener: socket.socket) -> None:
        try:
            sock, _ = listener.accept()
        except OSError:
            return
        self.connections += 1
        near = self._add_endpoint(sock)
        if self._fault.kind is LinkFaultKind.MUTE:
            return
        far_sock = socket.socket()
        far_sock.setblocking(False)
        if far_sock.connect_ex(self.target) not in (0, 115):
            far_sock.close()
            self._close(near, reset=True)
            return
        far = self._add_endpoint(far_sock)
        near.other, far.other, far.far = far, near, True

    def _add_endpoint(self, sock: socket.socket) -> _Endpoint:
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._endpoints[sock] = side = _Endpoint(sock)
        self._selector.register(sock, selectors.EVENT_READ)
        return side

    def _select_events(self, side: _Endpoint) -> None:
        """Register the events of interest: writable if data is queued, readable while the peer keeps up."""
        full = side.other is not None and side.other.held > BACKLOG_LIMIT
        wanted = 0 if side.finished or full else selectors.EVENT_READ
        if side.out and side.out[0][0] <= time.monotonic():
            wanted |= selectors.EVENT_WRITE
        known = self._selector.get_map().get(side.sock)
        if known and not wanted:
            self._selector.unregister(side.sock)
        elif known and known.events != wanted:
            self._selector.modify(side.sock, wanted)
        elif not known and wanted:
            self._selector.register(side.sock, wanted)

    def _read(self, side: _Endpoint) -> None:
        try:
            data = side.sock.recv(CHUNK)
        except BlockingIOError:
            return
        except OSError:
            self._close(side, reset=True)
            return
        if side.other is None:  # mute: discard
            if not data:
                self._close(side)
            return
        if data:
            self._forward(side.other, data)
        else:
            side.finished = True
            self._finish(side.other)

    def _forward(self, to: _Endpoint, data: bytes) -> None:
        """Forward ``data``, or apply the fault once its byte is reached."""
        before, self.passed = self.passed, self.passed + len(data)
        fault = self._fault
        if fault.kind is LinkFaultKind.PASS or fault.kind is LinkFaultKind.MUTE:
            self._queue(to, data)
        elif fault.kind is LinkFaultKind.DELAY:
            self._queue(to, data, time.monotonic() + fault.seconds)
        elif self.passed <= fault.after:
            self._queue(to, data)
        else:
            self._inject(to, data, max(0, fault.after - before))

    def _inject(self, to: _Endpoint, data: bytes, whole: int) -> None:
        kind, first, self.fired = self._fault.kind, not self.fired, True
        if kind in ONE_WAY:
            self._queue(to, data if self._passes(to) else data[:whole])
            return
        if kind is LinkFaultKind.GARBLE:
            self._queue(to, data[:whole] + bytes([data[whole] ^ 0x55]) + data[whole + 1 :] if first else data)
            return
        self._queue(to, data[:whole])
        if kind is LinkFaultKind.BLACK_HOLE:
            return
        self._write(to)
        if self._fault.lasting:
            self._set_listening(closed=True)
        else:
            self._fault = LinkFault()
        self._close_all(reset=kind is LinkFaultKind.CUT_RST)

    def _passes(self, to: _Endpoint) -> bool:
        """Whether bytes still go this way once the fault has begun."""
        kind = self._fault.kind
        return kind is not LinkFaultKind.BLACK_HOLE and (kind not in ONE_WAY or to.far is ONE_WAY[kind])

    def _queue(self, to: _Endpoint, data: bytes, due: float = 0.0) -> None:
        if data:
            to.out.append((due, data))
            to.held += len(data)
            if not due:
                self._write(to)

    def _write(self, side: _Endpoint) -> None:
        while side.out and side.out[0][0] <= time.monotonic():
            due, data = side.out.popleft()
            try:
                sent = side.sock.send(data)
            except (BlockingIOError, InterruptedError):
                sent = 0
            except OSError as error:
                if error.errno == 107:  # not connected yet
                    side.out.appendleft((time.monotonic() + 0.002, data))
                else:
                    self._close(side, reset=True)
                return
            side.held -= sent
            if sent < len(data):
                side.out.appendleft((due, data[sent:]))
                return
        if side.closing and not side.out:
            self._shut_down_write(side)

    def _finish(self, side: _Endpoint) -> None:
        """Handle the end of input; a black hole swallows it, too."""
        if self.fired and not self._passes(side):
            return
        side.closing = True
        if not side.out:
            self._shut_down_write(side)

    def _shut_down_write(self, side: _Endpoint) -> None:
        with suppress(OSError):
            side.sock.shutdown(socket.SHUT_WR)
        if side.finished and side.other is not None:
            self._close(side)

    def _close(self, side: _Endpoint, *, reset: bool = False) -> None:
        for each in (side, side.other):
            if each is None or each.sock not in self._endpoints:
                continue
            del self._endpoints[each.sock]
            with suppress(KeyError, ValueError):
                self._selector.unregister(each.sock)
            if reset:
                each.sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            each.sock.close()

    def _close_all(self, *, reset: bool, far: bool = True) -> None:
        for side in list(self._endpoints.values()):
            if not far:
                side.other = None
            if far or not side.far:
                self._close(side, reset=reset)


def enter_netns(netns: Path) -> None:
    """Move this thread into a network namespace; sockets created later stay there."""
    libc = ctypes.CDLL(None, use_errno=True)
    handle = os.open(netns, os.O_RDONLY)
    try:
        if libc.setns(handle, CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"cannot enter {netns}")
    finally:
        os.close(handle)


@contextmanager
def run_relay(
    target: tuple[str, int], *, address: str = "127.0.0.1", netns: Path | None = None
) -> Iterator[Relay]:
    """Run a relay for the duration of the context."""
    relay = Relay(target, address=address, netns=netns)
    relay.start()
    try:
        yield relay
    finally:
        relay.stop()
