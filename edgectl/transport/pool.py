"""Sessions kept open for a whole run, or for weeks: probe, then apply, over the same connections."""

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Self

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.model.inventory import Host
from edgectl.transport.base import Reply, Session, Transport

# sshd allows 10 channels on a connection (MaxSessions); some stay free for others.
_CHANNELS = 8


class SessionPool:
    """A Transport that opens each host once and keeps it until the pool is closed.

    A session that was lost is closed as soon as nobody uses it any more, and the next ``connect`` opens a new one. A refused login
    or host key is remembered for ``forget_s`` (s on ``clock``) and raised again without knocking a second time. Safe to use from
    several threads.
    """

    def __init__(self, transport: Transport, *, forget_s: float = math.inf, clock: Callable[[], float] = time.monotonic) -> None:
        self._transport = transport
        self._forget_s = forget_s
        self._clock = clock
        self._kept: dict[str, _Kept] = {}
        self._lost: set[_Kept] = set()
        self._refused: dict[str, tuple[HostError, float]] = {}
        self._guards: dict[str, threading.Lock] = {}
        self._guard = threading.Lock()

    def connect(self, host: Host, *, timeout: float) -> Session:
        """The open session of ``host``, opened where there is none; closing what is returned leaves it open.

        Raises:
            HostError: as the transport's own ``connect``.
        """
        with self._guard:
            guard = self._guards.setdefault(host.name, threading.Lock())
        with guard:
            self._raise_refusal(host.name)
            kept = self._kept.get(host.name)
            if kept is None or kept.lost:
                kept = self._kept[host.name] = self._opened(host, timeout)
            return kept.lent()

    def _raise_refusal(self, name: str) -> None:
        """Say no again, as a new error: one object raised again and again would collect every traceback."""
        error, until = self._refused.get(name, (None, 0.0))
        if error is None:
            return
        if self._clock() < until:
            raise type(error)(error.message, hint=error.hint, host=error.host) from error.__cause__
        del self._refused[name]

    def _opened(self, host: Host, timeout: float) -> "_Kept":
        try:
            return _Kept(self._transport.connect(host, timeout=timeout), self._lost)
        except (AuthError, HostKeyError) as error:
            self._refused[host.name] = error, self._clock() + self._forget_s
            raise

    def address(self, host: Host) -> str:
        """As the transport says."""
        return self._transport.address(host)

    def close(self) -> None:
        """Close every session."""
        for kept in (*self._kept.values(), *self._lost):
            kept.end()
        self._kept.clear()
        self._lost.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class _Kept:
    """A session that outlives its users and notes when it was lost: then it is ended with its last user, and in ``lost`` until then."""

    def __init__(self, session: Session, lost: "set[_Kept]") -> None:
        self.session = session
        self.lost = False
        self._all_lost = lost
        self._users = 0
        self._guard = threading.Lock()
        self._channels = threading.BoundedSemaphore(_CHANNELS)

    def lent(self) -> "_Lent":
        """The session for one more user."""
        with self._guard:
            self._users += 1
        return _Lent(self)

    def given_back(self) -> None:
        """One user fewer."""
        with self._guard:
            self._users -= 1
            over = self.lost and not self._users
        if over:
            self.end()
            self._all_lost.discard(self)

    @contextlib.contextmanager
    def channel(self) -> Iterator[Session]:
        """One channel of the session, which is lost where this raises that it is."""
        try:
            with self._channels:
                yield self.session
        except (ConnectError, DeadlineError):
            self.lost = True
            self._all_lost.add(self)
            raise

    def end(self) -> None:
        """Close the session itself."""
        self.session.close()


class _Lent:
    """A kept session in the hands of one user."""

    def __init__(self, kept: _Kept) -> None:
        self._kept = kept
        self._closed = False

    @property
    def python(self) -> str:
        return self._kept.session.python

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        with self._kept.channel() as session:
            return session.run(command, stdin, timeout=timeout, limit=limit)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        with self._kept.channel() as session:
            yield from session.stream(command, stdin, idle_timeout=idle_timeout)

    def close(self) -> None:
        """Give it back: the session belongs to the pool."""
        if not self._closed:
            self._closed = True
            self._kept.given_back()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
