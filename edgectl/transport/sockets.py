# SPDX-License-Identifier: Apache-2.0
"""Sockets under every SSH connection: tuned, and closed from outside when a deadline passes."""

import contextlib
import ipaddress
import os
import queue
import select
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

from edgectl.dataclass import dataclass

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

# Bounds of connecting, seconds.
CONNECT_TIMEOUT_S = 5.0
# Remedies of connections that fail at once, in every transport.
UNKNOWN_NAME_HINT = "correct host: in the inventory, or ssh_config"
REFUSED_HINT = "check that sshd runs there, and host: and port: in the inventory"
# Data that stays unacknowledged this long means a dead line, milliseconds.
TCP_USER_TIMEOUT_MS = 20_000
# paramiko asks for 0.1 s on each of its sockets: ten wake-ups per second and connection that see nothing. Its
# keepalives go with them (`ssh.KEEPALIVE_S`).
MIN_POLL_S = 5.0
# More than any login needs, and than comes while nothing is asked, bytes.
MAX_LOGIN_BYTES = 1 << 18
# What a new key exchange counts besides its bytes: it takes as long as so many.
REKEY_BYTES = 1 << 17
# What hosts behind a jump host may have sent and nobody has read yet, bytes.
MAX_TUNNEL_BYTES = 1 << 26
# paramiko asks for as much as a packet announces, and OpenSSH sends none above 256 KiB.
MAX_PACKET_BYTES = 1 << 19
_CHUNK_BYTES = 1 << 16
_QUICKACK = getattr(socket, "TCP_QUICKACK", None)
_USER_TIMEOUT = getattr(socket, "TCP_USER_TIMEOUT", None)
# In the kernel's account of a connection (linux/tcp.h): the time after which it repeats what was lost, us.
_INFO = getattr(socket, "TCP_INFO", None)
_REPEAT_AT = struct.Struct("=8xI")


class Allowance:
    """How many bytes may still come over a connection, which is cut beyond.

    So many for the login, then so many for each call: a server cannot keep us busy with what nobody reads,
    such as packets to be ignored. One thread receives, others grant.
    """

    def __init__(self) -> None:
        self._received, self._limit, self._calls = 0, MAX_LOGIN_BYTES, 0
        self._lock = threading.Lock()

    def is_spent(self) -> bool:
        """Whether more came than was granted."""
        return self._received > self._limit

    def charge(self, size: int) -> None:
        """Count ``size`` bytes that came; only the thread that receives."""
        self._received += size

    def renew(self, size: int) -> None:
        """Grant at least ``size`` bytes from now on."""
        with self._lock:
            if not self.is_spent():
                self._limit = max(self._limit, self._received + size)

    @contextlib.contextmanager
    def grant(self, size: int) -> Iterator[None]:
        """Grant a call ``size`` bytes; what calls at the same time were granted is added up."""
        with self._lock:
            if not self.is_spent():
                self._limit = (self._limit if self._calls else self._received) + size
            self._calls += 1
        try:
            yield
        finally:
            with self._lock:
                self._calls -= 1
                # What is left is kept: the rest of a reply that was too long may still be on its way.
                if not self._calls and not self.is_spent():
                    self._limit = max(self._limit, self._received + MAX_LOGIN_BYTES)


class TunedSocket(socket.socket):
    """A socket without the two 40 ms stalls of an SSH login (Nagle, delayed acknowledgement).

    Beyond its ``allowance`` it reads as closed, as it does where a packet announces more than
    ``MAX_PACKET_BYTES``. One thread receives. paramiko sends one packet at a time.
    """

    # What the kernel had beyond what was asked for: paramiko asks twice per packet.
    _ahead, _taken = b"", 0
    # What waits for `send_held`, and the thread that holds it back.
    _held: bytes = b""
    _holder: int | None = None

    @cached_property
    def _holding(self) -> threading.Lock:
        return threading.Lock()

    @cached_property
    def allowance(self) -> Allowance:
        """What may still come."""
        return Allowance()

    def recv(self, size: int, flags: int = 0, /) -> bytes:
        """Receive, and acknowledge at once."""
        if size > MAX_PACKET_BYTES:
            return b""
        if self._taken == len(self._ahead):
            self._ahead, self._taken = self._fetch(flags), 0
        data = self._ahead[self._taken : self._taken + size]
        self._taken += len(data)
        self.allowance.charge(len(data))
        return b"" if self.allowance.is_spent() else data

    def send(self, data: "ReadableBuffer", flags: int = 0, /) -> int:
        """Send, after what is held back; what the thread sends that holds back is held back, too."""
        if self._holder is None:
            return super().send(data, flags)
        with self._holding:
            if self._holder == threading.get_ident():
                self._held += data
                return memoryview(data).nbytes
            self._send_held()
        return super().send(data, flags)

    def hold(self) -> None:
        """Hold back the few bytes that this thread sends until it calls `send_held`, or another thread sends.

        Others must not wait: this thread may wait for what they send, such as for an exchange of keys.
        """
        with self._holding:
            self._holder = threading.get_ident()

    def send_held(self) -> None:
        """Send what was held back, and hold back nothing more; a line that does not take it has ended."""
        with self._holding:
            self._send_held()

    def _send_held(self) -> None:
        """Send it, with the lock. Until it is sent, whoever sends waits for the lock."""
        try:
            if self._held:
                self.sendall(self._held)
        except OSError:
            hang_up(self)
        finally:
            self._held, self._holder = b"", None

    def _fetch(self, flags: int) -> bytes:
        """What the kernel has; it resets the option to acknowledge at once, so it is set each time."""
        data = super().recv(_CHUNK_BYTES, flags)
        if _QUICKACK is not None and data:
            with contextlib.suppress(OSError):
                self.setsockopt(socket.IPPROTO_TCP, _QUICKACK, 1)
        return data

    def settimeout(self, value: float | None, /) -> None:
        """Poll at most each `MIN_POLL_S`: shutting the socket down stops a read at once."""
        super().settimeout(None if value is None else max(value, MIN_POLL_S))


class TunnelLine:
    """A channel of a jump host under an SSH connection, with the bounds of `TunedSocket`."""

    def __init__(self, channel: Any, outer: Allowance | None = None) -> None:  # noqa: ANN401 - one of paramiko's
        """``outer``: the allowance of the jump host's own connection, which is renewed by what is read."""
        self._channel = channel
        self._outer = outer
        self.allowance = Allowance()

    def recv(self, size: int) -> bytes:
        """Receive; nothing once more came than is allowed, or a packet is too large."""
        if size > MAX_PACKET_BYTES:
            return b""
        data: bytes = self._channel.recv(min(size, _CHUNK_BYTES))
        if self._outer is not None:
            self._outer.renew(MAX_TUNNEL_BYTES)
        self.allowance.charge(len(data))
        return b"" if self.allowance.is_spent() else data

    def hold(self) -> None:
        """Hold back nothing: who writes here may have to wait for the jump host anyway."""

    def send_held(self) -> None:
        """Send nothing, as nothing was held back."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever else a channel has
        return getattr(self._channel, name)


Line = TunedSocket | TunnelLine


def connect_tcp(address: str, port: int, *, timeout: float) -> TunedSocket:
    """Open a TCP connection; every address of the name is tried in turn, all within ``timeout`` seconds.

    Raises:
        OSError: the last failure (TimeoutError, ConnectionRefusedError, socket.gaierror, ..).
    """
    deadline = time.monotonic() + timeout
    failure: OSError = TimeoutError("timed out")
    for family, kind, protocol, _, target in _resolve_addresses(address, port, timeout):
        line = TunedSocket(family, kind, protocol)
        try:
            _connect_socket(line, target, deadline - time.monotonic())
        except OSError as error:
            line.close()
            failure = error
        else:
            return line
    raise failure


def _connect_socket(line: TunedSocket, target: object, seconds: float) -> None:
    if seconds <= 0:
        raise TimeoutError("timed out")
    socket.socket.settimeout(line, seconds)
    line.connect(target)  # type: ignore[arg-type]
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if _QUICKACK is not None:
        line.setsockopt(socket.IPPROTO_TCP, _QUICKACK, 1)
    if _USER_TIMEOUT is not None:
        line.setsockopt(socket.IPPROTO_TCP, _USER_TIMEOUT, TCP_USER_TIMEOUT_MS)


def _resolve_addresses(address: str, port: int, timeout: float) -> list[tuple[int, int, int, str, object]]:
    """Addresses of a name. The C resolver has no deadline, so it runs in a thread that may be left behind."""
    with contextlib.suppress(ValueError):
        family = socket.AF_INET6 if ipaddress.ip_address(address).version == 6 else socket.AF_INET
        return [(family, socket.SOCK_STREAM, 0, "", (address, port))]
    answer: queue.SimpleQueue[object] = queue.SimpleQueue()
    # For text Python imports the tables of international names first.
    name = address.encode() if address.isascii() else address

    def ask() -> None:
        try:
            answer.put(socket.getaddrinfo(name, port, type=socket.SOCK_STREAM))
        except (OSError, UnicodeError) as error:
            answer.put(error)

    threading.Thread(target=ask, name="edgectl-resolve", daemon=True).start()
    try:
        found = answer.get(timeout=timeout)
    except queue.Empty:
        raise socket.gaierror(socket.EAI_AGAIN, "no answer from the name service") from None
    if isinstance(found, UnicodeError):
        raise socket.gaierror(socket.EAI_NONAME, "not a name") from found
    if isinstance(found, OSError):
        raise found
    return found  # type: ignore[return-value]


class ProxySocket(TunedSocket):
    """The local end of a ProxyCommand; close ends and reaps the command."""

    def __init__(self, fileno: int) -> None:
        super().__init__(fileno=fileno)
        self._process: subprocess.Popen[bytes] | None = None
        # paramiko's thread and the caller may both close: one ends the group, both return once it is reaped.
        self._ending = threading.Lock()

    def close(self) -> None:
        """Close, end the command's process group, wait for it."""
        super().close()
        with self._ending:
            process, self._process = self._process, None
            if process is not None:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def start_proxy_command(command: str) -> ProxySocket:
    """Start the user's ProxyCommand as OpenSSH does: ``exec COMMAND`` in the user's shell, over its pipes.

    Raises:
        OSError: the shell cannot be started.
    """
    ours, theirs = socket.socketpair()
    line = ProxySocket(fileno=ours.detach())
    try:
        shell = os.environ.get("SHELL") or "/bin/sh"
        line._process = subprocess.Popen(  # noqa: SLF001 - our own class
            [shell, "-c", f"exec {command}"],
            stdin=theirs.fileno(),
            stdout=theirs.fileno(),
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError:
        line.close()
        raise
    finally:
        theirs.close()
    return line


def can_write_to(fd: int) -> bool:
    """Whether a few bytes can be written to a socket without a wait; also where it is closed (-1)."""
    if fd < 0:
        return True
    poll = select.poll()
    poll.register(fd, select.POLLOUT)
    return bool(poll.poll(0))


def find_repeat_s(line: object) -> float | None:
    """Seconds after which the kernel repeats what a TCP connection loses; None where nobody knows."""
    if _INFO is None or not isinstance(line, socket.socket):
        return None
    # Of a socket that is none of TCP the kernel refuses it.
    try:
        return int(_REPEAT_AT.unpack(line.getsockopt(socket.IPPROTO_TCP, _INFO, _REPEAT_AT.size))[0]) / 1e6
    except (OSError, struct.error):
        return None


def hang_up(line: object) -> None:
    """End a connection at once, which wakes every thread that waits on it. Never raises."""
    with contextlib.suppress(Exception):
        if isinstance(line, socket.socket):
            line.shutdown(socket.SHUT_RDWR)
        else:
            line.close()  # type: ignore[attr-defined]


@dataclass(slots=True, eq=False)
class DeadlineWatch:
    """A block that is watched: ``action`` is called where it has not ended at ``deadline`` (s, monotonic).

    ``expired``: whether it was.
    """

    deadline: float
    action: Callable[[], object]
    expired: bool = False


class _Watchdog:
    """One thread that watches all blocks; it runs while there are any, and ends when it next finds none.

    A thread of its own for each block took 0.15 ms of CPU (ADR 203).
    """

    def __init__(self) -> None:
        self._watches: set[DeadlineWatch] = set()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._looks_at = 0.0

    def add(self, watch: DeadlineWatch) -> None:
        """Watch a block."""
        with self._changed:
            self._watches.add(watch)
            if self._thread is None or not self._thread.is_alive():
                self._looks_at = watch.deadline
                self._thread = threading.Thread(target=self._run, name="edgectl-watchdog", daemon=True)
                self._thread.start()
            elif watch.deadline < self._looks_at:
                self._looks_at = watch.deadline
                self._changed.notify()

    def remove(self, watch: DeadlineWatch) -> None:
        """Watch a block no longer; the thread sleeps on."""
        with self._changed:
            self._watches.discard(watch)

    def _run(self) -> None:
        with self._changed:
            while self._watches:
                self._looks_at = min(watch.deadline for watch in self._watches)
                self._changed.wait(min(max(0.0, self._looks_at - time.monotonic()), threading.TIMEOUT_MAX))
                self._end_expired()
            self._thread = None

    def _end_expired(self) -> None:
        now = time.monotonic()
        for watch in [watch for watch in self._watches if watch.deadline <= now]:
            self._watches.remove(watch)
            watch.expired = True
            # In a thread of its own: the end of a line behind a jump host may wait for that host.
            threading.Thread(target=watch.action, daemon=True).start()


_WATCHDOG = _Watchdog()


@contextlib.contextmanager
def watchdog(seconds: float, action: Callable[[], object]) -> Iterator[DeadlineWatch]:
    """Call ``action`` from another thread if the block has not ended in ``seconds``."""
    watch = DeadlineWatch(deadline=time.monotonic() + max(0.0, seconds), action=action)
    _WATCHDOG.add(watch)
    try:
        yield watch
    finally:
        _WATCHDOG.remove(watch)
