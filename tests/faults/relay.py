"""A TCP relay to stand between manager and sshd, and to misbehave on order. Standard library only; one thread for each relay.

``Trouble`` says what goes wrong and after how many bytes. Bytes are counted since the trouble was set, over all connections and both
ways, so that one number walks through a whole exchange of several connections.
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

from tests.faults.trouble import Kind, Trouble

CHUNK = 16384
BACKLOG_LIMIT = 1 << 20
CLONE_NEWNET = 0x40000000


@dataclass(eq=False)
class _Side:
    """One end of a relayed connection: its socket, the other end, and what waits to be sent to it."""

    sock: socket.socket
    other: "_Side | None" = None
    out: deque[tuple[float, bytes]] = field(default_factory=deque)
    held: int = 0
    finished: bool = False
    closing: bool = False
    far: bool = False


class Relay:
    """Listens on ``address`` (port chosen once, kept for good) and passes on to ``target``; ``netns`` is a path of a network namespace."""

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
        self._trouble = Trouble()
        self._wanted = Trouble()
        self._down = False
        self._ending = False
        self._sides: dict[socket.socket, _Side] = {}
        self._selector = selectors.DefaultSelector()
        self._wake, self._waker = socket.socketpair()
        self._done = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._main, name=f"relay {target}", daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._order(self._thread.start)

    def set(self, trouble: Trouble) -> None:
        """From now on this trouble, for open connections and new ones; returns once it is in force."""
        self._wanted = trouble
        self._order(lambda: self._waker.send(b"t"))

    def heal(self) -> None:
        """Pass everything again. Connections that lost bytes stay broken, as they would be."""
        self.set(Trouble())

    def drop(self) -> None:
        """Reset every open connection now."""
        self._order(lambda: self._waker.send(b"d"))

    def stop(self) -> None:
        """Close everything and end the thread."""
        self._ending = True
        with suppress(OSError):
            self._waker.send(b"e")
        self._thread.join(10)
        assert not self._thread.is_alive(), "the relay's thread does not end"
        self._wake.close()
        self._waker.close()

    def _order(self, give: object) -> None:
        self._done.clear()
        give()  # type: ignore[operator]
        assert self._done.wait(60), "the relay does not answer"
        if self._error:
            raise self._error

    # All that follows runs in the relay's thread.

    def _main(self) -> None:
        try:
            if self._netns:
                _enter(self._netns)
            self._selector.register(self._wake, selectors.EVENT_READ)
            self._listen()
            self._done.set()
            while not self._ending:
                self._turn()
        except BaseException as error:  # told to whoever waits
            self._error = error
            self._done.set()
        finally:
            for sock in [*self._sides, *self._listener]:
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

    def _deaf(self) -> None:
        for listener in self._listener:
            self._selector.unregister(listener)
            listener.close()
        self._listener = ()

    def _turn(self) -> None:
        for key, events in self._selector.select(self._nap()):
            sock = key.fileobj
            assert isinstance(sock, socket.socket)
            if sock is self._wake:
                self._obey()
            elif sock in self._listener:
                self._accept(sock)
            elif sock in self._sides:
                if events & selectors.EVENT_READ:
                    self._read(self._sides[sock])
                if sock in self._sides and events & selectors.EVENT_WRITE:
                    self._write(self._sides[sock])
        for side in list(self._sides.values()):
            if side.sock in self._sides:
                self._watch(side)

    def _nap(self) -> float | None:
        due = [side.out[0][0] for side in self._sides.values() if side.out]
        return max(0.0, min(due) - time.monotonic()) if due else None

    def _obey(self) -> None:
        for order in self._wake.recv(64):
            if order == ord("d"):
                self._close_all(reset=True)
            elif order == ord("t"):
                if self.fired and self._trouble.kind is Kind.BLACK_HOLE:
                    # The next packet after the hole would find a connection that misses bytes.
                    self._close_all(reset=True, far=not self._trouble.half_open)
                self._trouble, self.passed, self.fired = self._wanted, 0, False
                self._set_door(closed=self._trouble.kind is Kind.REFUSE)
                if self._trouble.kind is Kind.REFUSE:
                    self._close_all(reset=True)
        self._done.set()

    def _set_door(self, *, closed: bool) -> None:
        if closed and self._listener:
            self._deaf()
        elif not closed and not self._listener:
            self._listen()

    def _accept(self, listener: socket.socket) -> None:
        try:
            sock, _ = listener.accept()
        except OSError:
            return
        self.connections += 1
        near = self._add(sock)
        if self._trouble.kind is Kind.MUTE:
            return
        far_sock = socket.socket()
        far_sock.setblocking(False)
        if far_sock.connect_ex(self.target) not in (0, 115):
            far_sock.close()
            self._close(near, reset=True)
            return
        far = self._add(far_sock)
        near.other, far.other, far.far = far, near, True

    def _add(self, sock: socket.socket) -> _Side:
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._sides[sock] = side = _Side(sock)
        self._selector.register(sock, selectors.EVENT_READ)
        return side

    def _watch(self, side: _Side) -> None:
        """Ask for what this side can use now: room to send what is due, bytes while the other side keeps up."""
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

    def _read(self, side: _Side) -> None:
        try:
            data = side.sock.recv(CHUNK)
        except BlockingIOError:
            return
        except OSError:
            self._close(side, reset=True)
            return
        if side.other is None:  # mute: swallowed
            if not data:
                self._close(side)
            return
        if data:
            self._pass(side.other, data)
        else:
            side.finished = True
            self._finish(side.other)

    def _pass(self, to: _Side, data: bytes) -> None:
        """Send ``data`` on, or do to it what the trouble says once its byte has come."""
        before, self.passed = self.passed, self.passed + len(data)
        trouble = self._trouble
        if trouble.kind is Kind.PASS or trouble.kind is Kind.MUTE:
            self._queue(to, data)
        elif trouble.kind is Kind.DELAY:
            self._queue(to, data, time.monotonic() + trouble.seconds)
        elif self.passed <= trouble.after:
            self._queue(to, data)
        else:
            self._harm(to, data, max(0, trouble.after - before))

    def _harm(self, to: _Side, data: bytes, whole: int) -> None:
        kind, first, self.fired = self._trouble.kind, not self.fired, True
        if kind is Kind.GARBLE:
            self._queue(to, data[:whole] + bytes([data[whole] ^ 0x55]) + data[whole + 1 :] if first else data)
            return
        self._queue(to, data[:whole])
        if kind is Kind.BLACK_HOLE:
            return
        self._write(to)
        if self._trouble.lasting:
            self._set_door(closed=True)
        else:
            self._trouble = Trouble()
        self._close_all(reset=kind is Kind.CUT_RST)

    def _queue(self, to: _Side, data: bytes, due: float = 0.0) -> None:
        if data:
            to.out.append((due, data))
            to.held += len(data)
            if not due:
                self._write(to)

    def _write(self, side: _Side) -> None:
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
            self._shut(side)

    def _finish(self, side: _Side) -> None:
        """The other side has said all; a black hole swallows that too."""
        if self._trouble.kind is Kind.BLACK_HOLE and self.fired:
            return
        side.closing = True
        if not side.out:
            self._shut(side)

    def _shut(self, side: _Side) -> None:
        with suppress(OSError):
            side.sock.shutdown(socket.SHUT_WR)
        if side.finished and side.other is not None:
            self._close(side)

    def _close(self, side: _Side, *, reset: bool = False) -> None:
        for each in (side, side.other):
            if each is None or each.sock not in self._sides:
                continue
            del self._sides[each.sock]
            with suppress(KeyError, ValueError):
                self._selector.unregister(each.sock)
            if reset:
                each.sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            each.sock.close()

    def _close_all(self, *, reset: bool, far: bool = True) -> None:
        for side in list(self._sides.values()):
            if not far:
                side.other = None
            if far or not side.far:
                self._close(side, reset=reset)


def _enter(netns: Path) -> None:
    """Take this thread into a network namespace; the sockets that it makes stay there."""
    libc = ctypes.CDLL(None, use_errno=True)
    handle = os.open(netns, os.O_RDONLY)
    try:
        if libc.setns(handle, CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"cannot enter {netns}")
    finally:
        os.close(handle)


@contextmanager
def relaying(
    target: tuple[str, int], *, address: str = "127.0.0.1", netns: Path | None = None
) -> Iterator[Relay]:
    """A running relay."""
    relay = Relay(target, address=address, netns=netns)
    relay.start()
    try:
        yield relay
    finally:
        relay.stop()
