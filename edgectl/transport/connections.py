# SPDX-License-Identifier: Apache-2.0
"""Connections to a fleet: kept open in a pool, rested after failures, recorded as heartbeats.

Everything that happens around a request is a guard. A session carries its guards in one list, so a request
passes through one object on its way to the connection, however many transports are stacked.
"""

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import field
from functools import partial
from typing import TYPE_CHECKING, Self

from edgectl.dataclass import dataclass
from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.model.inventory import Host
from edgectl.transport.backoff import compute_backoff_s
from edgectl.transport.base import Exchange, Reply, Session, Transport

if TYPE_CHECKING:
    from edgectl.transport.readings import ReadingFeeds

# sshd allows 10 channels on a connection (MaxSessions); some stay free for others.
_MAX_CHANNELS = 8
# Seconds. The first loss costs nothing: one new login mends a connection that was reset or idled out.
FIRST_BACKOFF_S, MAX_BACKOFF_S = 10.0, 60.0
# A refused login or host key needs an operator; frequent retries may lock the account.
REFUSED_BACKOFF_S, MAX_REFUSED_BACKOFF_S = 60.0, 600.0

Guard = Callable[[], AbstractContextManager[None]]
HeartbeatCallback = Callable[[str], None]


class GuardedSession:
    """A session with ``guards`` around each request, the last outermost; ``release`` is called once."""

    def __init__(self, session: Session, guards: tuple[Guard, ...], release: Callable[[], None]) -> None:
        self._session = session
        self._guards = guards
        self._release = release
        self._closed = False

    @property
    def python(self) -> str:
        """As the connection."""
        return self._session.python

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        """As ``Session.run``, within the guards."""
        with self._enter_guards():
            return self._session.run(command, stdin, timeout=timeout, limit=limit)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        """As ``Session.stream``, within the guards."""
        with self._enter_guards():
            yield from self._session.stream(command, stdin, idle_timeout=idle_timeout)

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> "GuardedExchange":
        """As ``Session.exchange``, within the guards until it is closed."""
        stack = self._enter_guards()
        with stack:
            exchange = self._session.exchange(command, stdin, timeout=timeout)
            return GuardedExchange(exchange, stack.pop_all())

    def add_guard(self, guard: Guard) -> "GuardedSession":
        """The same session within one more guard; close only the new one."""
        return GuardedSession(self._session, (*self._guards, guard), self.close)

    def close(self) -> None:
        """Release the session; its transport decides what happens to the connection."""
        if not self._closed:
            self._closed = True
            self._release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _enter_guards(self) -> ExitStack:
        stack = ExitStack()
        try:
            for guard in reversed(self._guards):
                stack.enter_context(guard())
        except BaseException:
            stack.close()
            raise
        return stack


class GuardedExchange:
    """An exchange within the guards of its session, which hear of its errors."""

    def __init__(self, exchange: Exchange, guards: ExitStack) -> None:
        self._exchange = exchange
        self._guards = guards

    def read(self, *, timeout: float) -> bytes:
        """As ``Exchange.read``."""
        with self._leave_on_error():
            return self._exchange.read(timeout=timeout)

    def finish(self, data: bytes, *, timeout: float) -> None:
        """As ``Exchange.finish``."""
        with self._leave_on_error():
            self._exchange.finish(data, timeout=timeout)

    def build_reply(self) -> Reply:
        """As ``Exchange.build_reply``."""
        return self._exchange.build_reply()

    def close(self) -> None:
        """As ``Exchange.close``."""
        self._exchange.close()
        self._guards.close()

    @contextlib.contextmanager
    def _leave_on_error(self) -> Iterator[None]:
        with contextlib.ExitStack() as stack:
            stack.push(self._guards)
            yield
            stack.pop_all()


def guard_session(session: Session, guard: Guard) -> GuardedSession:
    """``session`` within ``guard``."""
    if isinstance(session, GuardedSession):
        return session.add_guard(guard)
    return GuardedSession(session, (guard,), session.close)


@dataclass(slots=True, eq=False)
class _Connection:
    """An open session with its ``users``. Once ``lost`` it is closed with the last of them."""

    session: Session
    users: int = 0
    lost: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)
    channels: threading.BoundedSemaphore = field(
        default_factory=partial(threading.BoundedSemaphore, _MAX_CHANNELS)
    )


class SessionPool:
    """A Transport that opens each host once and keeps it until the pool is closed.

    A session that was lost is closed with its last user, and the next ``connect`` opens a new one. A refused
    login or host key is remembered for ``forget_s`` (s on ``clock``) and raised again without another login.
    Safe to use from several threads.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        forget_s: float = math.inf,
        clock: Callable[[], float] = time.monotonic,
        converse: bool = False,
        feeds: "ReadingFeeds | None" = None,
    ) -> None:
        """``converse``: an agent stays on each host while requests that read follow each other closely;
        ``feeds`` receive what it says by itself.
        """
        self._transport = transport
        self._converse = self._converses = converse
        self._feeds = feeds
        self._forget_s = forget_s
        self._clock = clock
        self._staying: dict[str, set[str]] = {}
        self._open: dict[str, _Connection] = {}
        self._lost: set[_Connection] = set()
        self._refused: dict[str, tuple[HostError, float]] = {}
        self._host_locks: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()

    def connect(self, host: Host, *, timeout: float) -> GuardedSession:
        """The open session of ``host``, opened where there is none; closing the returned one leaves it open.

        Raises:
            HostError: as the transport's own ``connect``.
        """
        with self._lock:
            lock = self._host_locks.setdefault(host.name, threading.Lock())
        with lock:
            self._raise_refusal(host.name)
            kept = self._open.get(host.name)
            if kept is None or kept.lost:
                kept = self._open[host.name] = self._connect(host, timeout)
            with kept.lock:
                kept.users += 1
            return GuardedSession(
                kept.session, (partial(self._open_channel, kept),), partial(self._release, kept)
            )

    def _raise_refusal(self, name: str) -> None:
        error, until = self._refused.get(name, (None, 0.0))
        if error is None:
            return
        if self._clock() < until:
            raise _copy_error(error) from error.__cause__
        del self._refused[name]

    def _connect(self, host: Host, timeout: float) -> _Connection:
        try:
            session = self._transport.connect(host, timeout=timeout)
        except (AuthError, HostKeyError) as error:
            self._refused[host.name] = error, self._clock() + self._forget_s
            raise
        if not self._converse:
            return _Connection(session)
        # Imported here: most commands ask each host once.
        from edgectl.transport.conversation import share_agent

        with self._lock:
            return _Connection(share_agent(session, host, self.address, self._staying, self._feeds))

    def expect_requests(self, hosts: Iterable[Host]) -> None:
        """Begin an agent that stays on each connected one of ``hosts``: many requests follow, also changes.

        After a new login each request is a call again.
        """
        from edgectl.transport.conversation import ConversingSession, share_agent

        self._converses = True
        for host in hosts:
            with self._lock:
                kept = self._open.get(host.name)
                if kept is None or kept.lost:
                    continue
                if not isinstance(kept.session, ConversingSession):
                    kept.session = share_agent(kept.session, host, self.address, self._staying)
            if isinstance(kept.session, ConversingSession):
                kept.session.expect_requests(host)

    @contextlib.contextmanager
    def _open_channel(self, kept: _Connection) -> Iterator[None]:
        """One channel of a connection, which a ConnectError or DeadlineError marks as lost."""
        try:
            with kept.channels:
                yield
        except (ConnectError, DeadlineError):
            kept.lost = True
            self._lost.add(kept)
            raise

    def _release(self, kept: _Connection) -> None:
        with kept.lock:
            kept.users -= 1
            over = kept.lost and not kept.users
        if over:
            kept.session.close()
            self._lost.discard(kept)

    def address(self, host: Host) -> str:
        """As the transport's own."""
        return self._transport.address(host)

    def close(self) -> None:
        """Close every session."""
        everything = [kept.session for kept in (*self._open.values(), *self._lost)]
        for session in everything:
            session.close()
        if self._converses:
            from edgectl.transport.conversation import ConversingSession

            for session in everything:
                if isinstance(session, ConversingSession):
                    session.join()
        self._open.clear()
        self._lost.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _copy_error(error: HostError) -> HostError:
    """The same error as a new object: one that is raised again and again would collect every traceback."""
    return type(error)(error.message, hint=error.hint, host=error.host)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rest:
    """``failures`` in a row, the last of them ``error``; nothing is tried before ``until``."""

    error: HostError
    failures: int
    until: float


class BackoffTransport:
    """A Transport that rests a host after failures: meanwhile ``connect`` raises the last error again.

    A host that replies is forgotten; one entry is kept for each host that does not. ``clock``: s, monotonic.
    """

    def __init__(self, transport: Transport, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._transport = transport
        self._clock = clock
        self._resting: dict[str, _Rest] = {}

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
            self._note_failure(host.name, error)
            raise
        return guard_session(session, partial(self._note_outcome, host.name))

    def address(self, host: Host) -> str:
        """As the transport's own."""
        return self._transport.address(host)

    def extend_rest(self, name: str, seconds: float) -> None:
        """Let a host rest for ``seconds`` from now if its last attempt failed."""
        rest = self._resting.get(name)
        if rest is not None:
            until = max(rest.until, self._clock() + seconds)
            self._resting[name] = _Rest(error=rest.error, failures=rest.failures, until=until)

    @contextlib.contextmanager
    def _note_outcome(self, name: str) -> Iterator[None]:
        try:
            yield
        except (ConnectError, DeadlineError) as error:
            self._note_failure(name, error)
            raise
        self._resting.pop(name, None)

    def _note_failure(self, name: str, error: HostError) -> None:
        before = self._resting.get(name)
        failures = before.failures + 1 if before is not None else 1
        self._resting[name] = _Rest(
            error=_copy_error(error),
            failures=failures,
            until=self._clock() + compute_host_backoff_s(error, failures),
        )


def compute_host_backoff_s(error: HostError, failures: int) -> float:
    """Seconds to leave a host alone after so many failures in a row, the last of them ``error``."""
    if isinstance(error, AuthError | HostKeyError):
        return compute_backoff_s(failures, first_s=REFUSED_BACKOFF_S, max_s=MAX_REFUSED_BACKOFF_S)
    if failures == 1:
        return 0.0
    return compute_backoff_s(failures - 1, first_s=FIRST_BACKOFF_S, max_s=MAX_BACKOFF_S)


class HeartbeatTransport:
    """A Transport that calls ``note(host)`` before each request leaves and after it ended, however it ended.

    A request whose reply is lost may have arrived and therefore counts; a failed connect does not.
    """

    def __init__(self, transport: Transport, note: HeartbeatCallback) -> None:
        self._transport = transport
        self._note = note

    def connect(self, host: Host, *, timeout: float) -> Session:
        """As the transport within, its requests noted.

        Raises:
            HostError: as the transport's own ``connect``.
        """
        return guard_session(
            self._transport.connect(host, timeout=timeout), partial(self._note_request, host.name)
        )

    def address(self, host: Host) -> str:
        """As the transport's own."""
        return self._transport.address(host)

    @contextlib.contextmanager
    def _note_request(self, name: str) -> Iterator[None]:
        self._note(name)
        try:
            yield
        finally:
            self._note(name)
