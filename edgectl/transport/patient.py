"""A transport that does not knock in every cycle at a host that did not answer: each time it waits longer."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Self

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.model.inventory import Host
from edgectl.transport.base import Reply, Session, Transport

# Seconds. The first loss is forgiven: a connection that was reset or idled out is mended by one new login.
FIRST_S, LONGEST_S = 10.0, 60.0
# Who refuses a login or shows a wrong key changes its mind only by a person's hand; knocking often may lock the account.
REFUSED_S, REFUSED_LONGEST_S = 60.0, 600.0
Failed = Callable[[HostError], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rest:
    """``failures`` in a row, the last of them ``error``; nothing is tried before ``until``."""

    error: HostError
    failures: int
    until: float


class Patient:
    """Over ``transport``. While a host rests, ``connect`` raises its last error again, at once.

    A host whose answer comes is forgotten; what is kept is one entry for each host that is silent. ``clock``: s, monotonic.
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
            raise _again(rest.error)
        try:
            session = self._transport.connect(host, timeout=timeout)
        except HostError as error:
            self._failed(host.name, error)
            raise
        return _Tried(session, lambda error: self._failed(host.name, error), lambda: self._resting.pop(host.name, None))

    def address(self, host: Host) -> str:
        """As the transport says."""
        return self._transport.address(host)

    def _failed(self, name: str, error: HostError) -> None:
        before = self._resting.get(name)
        failures = before.failures + 1 if before is not None else 1
        self._resting[name] = _Rest(error=_again(error), failures=failures, until=self._clock() + rest_s(error, failures))


def rest_s(error: HostError, failures: int) -> float:
    """Seconds to wait after so many failures in a row, the last of them ``error``."""
    doubled = 2.0 ** min(failures - 1, 10)
    if isinstance(error, AuthError | HostKeyError):
        return min(REFUSED_S * doubled, REFUSED_LONGEST_S)
    return 0.0 if failures == 1 else min(FIRST_S * doubled / 2, LONGEST_S)


def _again(error: HostError) -> HostError:
    """The same error as a new object: one that is raised again and again would collect every traceback."""
    return type(error)(error.message, hint=error.hint, host=error.host)


class _Tried:
    """A session that says how it goes."""

    def __init__(self, session: Session, failed: Failed, answered: Callable[[], object]) -> None:
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
