# SPDX-License-Identifier: Apache-2.0
"""Memory of one run for hosts that let a deadline pass, which the rest of it does not wait for again, and for
those that have just answered.
"""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import field
from functools import partial

from edgectl.dataclass import dataclass
from edgectl.errors import ConnectError, DeadlineError, HostError
from edgectl.model.inventory import Host
from edgectl.transport.base import Session, Transport
from edgectl.transport.connections import guard_session

# A connection that fails after this part of its deadline was not refused, but not answered.
_UNANSWERED_SHARE = 0.9
# Seconds for which a host that has answered counts as one that answers.
_FRESH_S = 1.0


@dataclass(slots=True, eq=False)
class SilentHosts:
    """The hosts that let a deadline pass in one run: of any request, and of one that recovers."""

    ever: dict[str, HostError] = field(default_factory=dict)
    in_recovery: dict[str, HostError] = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class AnsweringHosts:
    """When each host has last said that it is there: actions that begin together ask it once."""

    _at: dict[str, float] = field(default_factory=dict)
    _locks: dict[str, threading.Lock] = field(default_factory=dict)

    def reach(self, host: str, ask: Callable[[], object]) -> None:
        """``ask`` the host, unless it has just answered another action; what that raises passes through."""
        with self._locks.setdefault(host, threading.Lock()):
            if time.monotonic() - self._at.get(host, -_FRESH_S) >= _FRESH_S:
                ask()
                self._at[host] = time.monotonic()


class SilenceTransport:
    """A Transport that asks a host nothing more once it has let a deadline pass in the run of ``silent``.

    With ``recovers`` it asks such a host once more: until a request that recovers is not answered either.
    A connection that is refused or cut is no silence: the host may answer the next one.
    """

    def __init__(
        self,
        transport: Transport,
        silent: SilentHosts,
        *,
        recovers: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._transport = transport
        self._clock = clock
        self._silent = silent
        self._refused = silent.in_recovery if recovers else silent.ever

    def connect(self, host: Host, *, timeout: float) -> Session:
        """As the transport within.

        Raises:
            HostError: as the transport's own ``connect``; DeadlineError at once for a silent host.
        """
        self._raise_if_silent(host.name)
        began = self._clock()
        try:
            session = self._transport.connect(host, timeout=timeout)
        except (ConnectError, DeadlineError) as error:
            if isinstance(error, DeadlineError) or self._clock() - began >= _UNANSWERED_SHARE * timeout:
                self._note_silence(host.name, error)
            raise
        return guard_session(session, partial(self._watch_request, host.name))

    def address(self, host: Host) -> str:
        """As the transport's own."""
        return self._transport.address(host)

    def _note_silence(self, name: str, error: HostError) -> None:
        self._refused[name] = error
        self._silent.ever.setdefault(name, error)

    def _raise_if_silent(self, name: str) -> None:
        error = self._refused.get(name)
        if error is not None:
            raise DeadlineError(
                f"{error.message}; not asked again in this run", hint=error.hint, host=error.host
            )

    @contextlib.contextmanager
    def _watch_request(self, name: str) -> Iterator[None]:
        self._raise_if_silent(name)
        try:
            yield
        except DeadlineError as error:
            self._note_silence(name, error)
            raise
