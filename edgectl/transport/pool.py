"""Sessions kept open for a whole run: probe, then apply, over the same connections."""

import contextlib
import threading
from collections.abc import Iterator
from typing import Self

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError, HostKeyError
from edgectl.model.inventory import Host
from edgectl.transport.base import Reply, Session, Transport

# sshd allows 10 channels on a connection (MaxSessions); some stay free for others.
_CHANNELS = 8


class SessionPool:
    """A Transport that opens each host once and keeps it until the pool is closed.

    A session that was lost is forgotten, so the next ``connect`` opens a new one. A refused login or host key is
    remembered and raised again without knocking a second time. Safe to use from several threads.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._kept: dict[str, _Kept] = {}
        self._lost: list[_Kept] = []
        self._refused: dict[str, HostError] = {}
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
            if host.name in self._refused:
                raise self._refused[host.name]
            kept = self._kept.get(host.name)
            if kept is not None and not kept.lost:
                return kept
            if kept is not None:
                self._lost.append(kept)
            fresh = self._kept[host.name] = self._opened(host, timeout)
            return fresh

    def _opened(self, host: Host, timeout: float) -> "_Kept":
        try:
            return _Kept(self._transport.connect(host, timeout=timeout))
        except (AuthError, HostKeyError) as error:
            self._refused[host.name] = error
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
    """A session that outlives its users and notes when it was lost."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._channels = threading.BoundedSemaphore(_CHANNELS)
        self.lost = False

    @property
    def python(self) -> str:
        return self._session.python

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        with self._noting_loss(), self._channels:
            return self._session.run(command, stdin, timeout=timeout, limit=limit)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        with self._noting_loss(), self._channels:
            yield from self._session.stream(command, stdin, idle_timeout=idle_timeout)

    @contextlib.contextmanager
    def _noting_loss(self) -> Iterator[None]:
        try:
            yield
        except (ConnectError, DeadlineError):
            self.lost = True
            raise

    def close(self) -> None:
        """Leave the session open: it belongs to the pool."""

    def end(self) -> None:
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
