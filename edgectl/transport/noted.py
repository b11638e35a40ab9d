"""A transport that says which host was in touch, and never later than it was."""

from collections.abc import Callable, Iterator
from typing import Self

from edgectl.model.inventory import Host
from edgectl.transport.base import Reply, Session, Transport

Note = Callable[[str], None]


class Noted:
    """Calls ``note(host)`` before each request leaves and after it ended, however it ended. Who cannot be connected to was not in touch.

    A request whose answer is lost may still have arrived; therefore it counts.
    """

    def __init__(self, transport: Transport, note: Note) -> None:
        self._transport = transport
        self._note = note

    def connect(self, host: Host, *, timeout: float) -> Session:
        """As the transport within, and noted.

        Raises:
            HostError: as the transport's own ``connect``.
        """
        return _NotedSession(self._transport.connect(host, timeout=timeout), host.name, self._note)

    def address(self, host: Host) -> str:
        """As the transport says."""
        return self._transport.address(host)


class _NotedSession:
    """A session of ``host`` whose requests are noted."""

    def __init__(self, session: Session, host: str, note: Note) -> None:
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
