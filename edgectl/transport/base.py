# SPDX-License-Identifier: Apache-2.0
"""The interface between edgectl and a host: a Session runs one constant command line, bytes in and out.

No user data is ever part of a command line, so no shell interprets it: requests travel on standard input.
A trace (``edgectl -v``) tells what was asked of which host and how long that took; of a request it has only
the operation and the task, because commands and environments may hold secrets.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, Self, runtime_checkable

from edgectl.dataclass import dataclass
from edgectl.errors import HostError
from edgectl.model.inventory import Host


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """Output of one remote command. ``status``: its exit status, or -1 where the host did not report one."""

    stdout: bytes
    stderr: bytes
    status: int


class Exchange(Protocol):
    """A running command whose standard input is still open. Used by one thread."""

    def read(self, *, timeout: float) -> bytes:
        """The next piece of its standard output; empty once it has ended.

        Raises:
            DeadlineError: nothing came within ``timeout`` seconds.
            ConnectError: the connection was lost.
        """
        ...

    def finish(self, data: bytes, *, timeout: float) -> None:
        """Write ``data`` and close its standard input; a command that has ended is no error.

        Raises:
            DeadlineError, ConnectError: as `read`.
        """
        ...

    def build_reply(self) -> Reply:
        """Error output and exit status of the ended command; what was read before is not repeated."""
        ...

    def close(self) -> None:
        """End it; never raises."""
        ...


class Session(Protocol):
    """An open connection to one host. Safe to use from several threads; every call has its own hard deadline.

    ``python`` is the interpreter to name in the command line (``python3``, or a path on this machine).
    """

    @property
    def python(self) -> str:
        """The interpreter to name in a command line."""
        ...

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        """Run ``command``, feed it ``stdin``, return what it printed.

        Raises:
            DeadlineError: no end within ``timeout`` seconds; the channel is closed.
            ReplyError: more than ``limit`` bytes of output.
            ConnectError: the connection was lost.
        """
        ...

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        """Run ``command`` and yield its standard output as it comes, until it ends or the iterator is closed.

        Raises:
            DeadlineError: no output for ``idle_timeout`` seconds.
            ConnectError: the connection was lost.
        """
        ...

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> Exchange:
        """Run ``command``, feed it ``stdin`` within ``timeout`` seconds, and leave its input open.

        Raises:
            DeadlineError: it did not start or read in time.
            ConnectError: the connection was lost.
        """
        ...

    def close(self) -> None:
        """Close the connection; never raises."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


class OpenExchange(Exchange, Protocol):
    """An exchange that many requests share: one thread reads, others write, one at a time."""

    def write(self, data: bytes, *, timeout: float) -> None:
        """Write ``data``; a command that has ended is no error.

        Raises:
            DeadlineError, ConnectError: as `read`.
        """
        ...

    def can_write(self) -> bool:
        """Whether a few bytes can be written without a wait."""
        ...

    def expect_reply(self, *, timeout: float, limit: int) -> AbstractContextManager[None]:
        """Let the command send a reply of ``limit`` bytes; cut a connection that stalls for ``timeout``
        seconds and more.
        """
        ...

    def expect_more(self, size: int) -> None:
        """Let the command send at least ``size`` more bytes."""
        ...


@runtime_checkable
class RestingExchange(OpenExchange, Protocol):
    """An open exchange whose reader need not wake up for all that arrives (ADR 188)."""

    @property
    def arrived_at(self) -> float:
        """When something arrived last (s, monotonic)."""
        ...

    def rest(self, *, resting: bool) -> None:
        """Whether `await_arrival` sleeps on when something arrives; the end of the output wakes it up."""
        ...

    def await_arrival(self, seconds: float) -> None:
        """Wait, at most so long, for something to read, or for the end."""
        ...

    def wake(self) -> None:
        """End an `await_arrival`, or the next one, though nothing may have arrived."""
        ...

    def has_arrived(self) -> bool:
        """Whether something has arrived since the last `read`, and reading it waits for nothing."""
        ...

    def hold_writes(self) -> Callable[[], None]:
        """Hold back the few bytes that this thread writes next until it calls what is returned, soon: to send
        wakes programs up, which take the processor and its caches.
        """
        ...

    def find_repeat_s(self) -> float | None:
        """Seconds after which the line repeats what was lost; None where nobody knows."""
        ...


@runtime_checkable
class ConversableSession(Session, Protocol):
    """A session that can keep one command running beside all others."""

    def converse(
        self, command: str, stdin: bytes, *, timeout: float, give_way: Callable[[], None]
    ) -> OpenExchange:
        """As `Session.exchange`. ``give_way`` is called when another call finds no room beside it.

        Raises:
            DeadlineError: it did not start or read in time.
            ConnectError: the connection was lost, or has no room for it.
        """
        ...


class Transport(Protocol):
    """Opens sessions. One transport serves a whole run and keeps what is read once (known_hosts, keys)."""

    def connect(self, host: Host, *, timeout: float) -> Session:
        """Open a session within ``timeout`` seconds, everything from name resolution to authentication.

        Raises:
            HostError: the subclass names the cause.
        """
        ...

    def address(self, host: Host) -> str:
        """The address or name by which other machines reach ``host`` (HostName of ssh_config applied)."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceEvent:
    """One login or request to ``host``; ``error``: why it failed."""

    host: str
    operation: str
    task: str = ""
    duration_s: float
    error: str = ""


_listeners: list[Callable[[TraceEvent], None]] = []


@contextmanager
def listen_to_calls(listener: Callable[[TraceEvent], None]) -> Iterator[None]:
    """Call ``listener`` after each login and request within, from any thread."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


@contextmanager
def trace_call(host: str, operation: str, task: str = "") -> Iterator[None]:
    """Report the calls within."""
    if not _listeners:
        yield
        return
    began, error = time.monotonic(), ""
    try:
        yield
    except HostError as failure:
        error = failure.message
        raise
    finally:
        event = TraceEvent(
            host=host, operation=operation, task=task, duration_s=time.monotonic() - began, error=error
        )
        for listener in _listeners:
            listener(event)
