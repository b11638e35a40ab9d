"""Sessions kept open for a whole run, or for weeks: probe, then apply, over the same connections."""

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Self

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.model.inventory import Host
from edgectl.transport.base import Reply, Session, Transport

# sshd allows 10 channels on a connection (MaxSessions); some stay free for others.
_MAX_CHANNELS = 8


class SessionPool:
    """A Transport that opens each host once and keeps it until the pool is closed.

    A session that was lost is closed as soon as nobody uses it any more, and the next ``connect`` opens a new one. A refused login
    or host key is remembered for ``forget_s`` (s on ``clock``) and raised again without knocking a second time. Safe to use from
    several threads.
    """

    def __init__(
        self, transport: Transport, *, forget_s: float = math.inf, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._transport = transport
        self._forget_s = forget_s
        self._clock = clock
        self._kept: dict[str, _PooledSession] = {}
        self._lost: set[_PooledSession] = set()
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

    def _opened(self, host: Host, timeout: float) -> "_PooledSession":
        try:
            return _PooledSession(self._transport.connect(host, timeout=timeout), self._lost)
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


class _PooledSession:
    """A session that outlives its users and notes when it was lost: then it is ended with its last user, and in ``lost`` until then."""

    def __init__(self, session: Session, lost: "set[_PooledSession]") -> None:
        self.session = session
        self.lost = False
        self._all_lost = lost
        self._users = 0
        self._guard = threading.Lock()
        self._channels = threading.BoundedSemaphore(_MAX_CHANNELS)

    def lent(self) -> "_BorrowedSession":
        """The session for one more user."""
        with self._guard:
            self._users += 1
        return _BorrowedSession(self)

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


class _BorrowedSession:
    """A kept session in the hands of one user."""

    def __init__(self, kept: _PooledSession) -> None:
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


# Seconds. The first loss is forgiven: a connection that was reset or idled out is mended by one new login.
FIRST_BACKOFF_S, MAX_BACKOFF_S = 10.0, 60.0
# Who refuses a login or shows a wrong key changes its mind only by a person's hand; knocking often may lock the account.
REFUSED_BACKOFF_S, MAX_REFUSED_BACKOFF_S = 60.0, 600.0
FailureCallback = Callable[[HostError], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Backoff:
    """``failures`` in a row, the last of them ``error``; nothing is tried before ``until``."""

    error: HostError
    failures: int
    until: float


class BackoffTransport:
    """Over ``transport``. While a host rests, ``connect`` raises its last error again, at once.

    A host whose answer comes is forgotten; what is kept is one entry for each host that is silent. ``clock``: s, monotonic.
    """

    def __init__(self, transport: Transport, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._transport = transport
        self._clock = clock
        self._resting: dict[str, _Backoff] = {}

    def connect(self, host: Host, *, timeout: float) -> Session:
        """As the transport within.

        Raises:
            HostError: as the transport's own ``connect``, or the last one of a host that rests.
        """
        rest = self._resting.get(host.name)
        if rest is not None and self._clock() < rest.until:
            raise _copy_error(rest.error)
        try:
            session = self._transport.connect(host, timeout=timeout)
        except HostError as error:
            self._failed(host.name, error)
            raise
        return _BackoffSession(
            session, lambda error: self._failed(host.name, error), lambda: self._resting.pop(host.name, None)
        )

    def address(self, host: Host) -> str:
        """As the transport says."""
        return self._transport.address(host)

    def _failed(self, name: str, error: HostError) -> None:
        before = self._resting.get(name)
        failures = before.failures + 1 if before is not None else 1
        self._resting[name] = _Backoff(
            error=_copy_error(error),
            failures=failures,
            until=self._clock() + compute_backoff_s(error, failures),
        )


def compute_backoff_s(error: HostError, failures: int) -> float:
    """Seconds to wait after so many failures in a row, the last of them ``error``."""
    doubled = 2.0 ** min(failures - 1, 10)
    if isinstance(error, AuthError | HostKeyError):
        return min(REFUSED_BACKOFF_S * doubled, MAX_REFUSED_BACKOFF_S)
    return 0.0 if failures == 1 else min(FIRST_BACKOFF_S * doubled / 2, MAX_BACKOFF_S)


def _copy_error(error: HostError) -> HostError:
    """The same error as a new object: one that is raised again and again would collect every traceback."""
    return type(error)(error.message, hint=error.hint, host=error.host)


class _BackoffSession:
    """A session that says how it goes."""

    def __init__(self, session: Session, failed: FailureCallback, answered: Callable[[], object]) -> None:
        self._session = session
        self._failed = failed
        self._answered = answered

    @property
    def python(self) -> str:
        return self._session.python

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        try:
            reply = self._session.run(command, stdin, timeout=timeout, limit=limit)
        except (ConnectError, DeadlineError) as error:
            self._failed(error)
            raise
        self._answered()
        return reply

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        yield from self._session.stream(command, stdin, idle_timeout=idle_timeout)

    def close(self) -> None:
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


HeartbeatCallback = Callable[[str], None]


class HeartbeatTransport:
    """Calls ``note(host)`` before each request leaves and after it ended, however it ended. Who cannot be connected to was not in touch.

    A request whose answer is lost may still have arrived; therefore it counts.
    """

    def __init__(self, transport: Transport, note: HeartbeatCallback) -> None:
        self._transport = transport
        self._note = note

    def connect(self, host: Host, *, timeout: float) -> Session:
        """As the transport within, and noted.

        Raises:
            HostError: as the transport's own ``connect``.
        """
        return _HeartbeatSession(self._transport.connect(host, timeout=timeout), host.name, self._note)

    def address(self, host: Host) -> str:
        """As the transport says."""
        return self._transport.address(host)


class _HeartbeatSession:
    """A session of ``host`` whose requests are noted."""

    def __init__(self, session: Session, host: str, note: HeartbeatCallback) -> None:
        self._session = session
        self._host = host
        self._note = note

    @property
    def python(self) -> str:
        return self._session.python

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        self._note(self._host)
        try:
            return self._session.run(command, stdin, timeout=timeout, limit=limit)
        finally:
            self._note(self._host)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        self._note(self._host)
        try:
            yield from self._session.stream(command, stdin, idle_timeout=idle_timeout)
        finally:
            self._note(self._host)

    def close(self) -> None:
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
