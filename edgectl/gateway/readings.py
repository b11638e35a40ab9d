# SPDX-License-Identifier: Apache-2.0
"""Probes from readings that hosts send by themselves: which of them count, and what was decoded of them."""

import contextlib
import time
import zlib
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.gateway.link_observations import JoinedLinks
from edgectl.gateway.probe_reply import ReplyContext
from edgectl.transport.readings import Reading, ReadingFeeds

Value = TypeVar("Value")
Request = dict[str, object]
# By name: those of robots, and those of edges.
Addresses = tuple[dict[str, str], dict[str, str]]
Document = dict[str, object]
Known = tuple[Mapping[str, object], Value] | None
# A host is asked anew after so long, and up to half as much later: not all hosts in one cycle (s).
_ASK_EACH_S = 300.0
# It has a heartbeat after one of these times, with a part of the others: the record is written for all at
# once (s). By requests a host knows that its manager is there; what it sends is no heartbeat.
_HEARTBEATS_EACH_S = (30.0, 35.0, 40.0, 45.0)
# A host that has not taken it, or not replied to it, so much later is asked (s).
_LATE_S = 10.0
# Names may come to stand for other addresses (s).
_RESOLVE_EACH_S = 30.0
# At longer periods no agent stays (`transport.conversation`).
MAX_EVERY_S = 5.0


class FleetReadings(Generic[Value]):
    """The readings of the hosts of one fleet, each ``every`` s; ``feeds`` are those of its connections.

    A reading counts for the very request that it answers. ``joined``: the links of all hosts. For one thread.
    """

    def __init__(self, feeds: ReadingFeeds, *, every: float) -> None:
        self._feeds, self._every = feeds, every
        self._asked: dict[str, Request] = {}
        # When its next heartbeat is due, or the one under way was sent (s, monotonic).
        self._due: dict[str, float] = {}
        self._note: Callable[[str], None] = _note_nothing
        self._decoded: dict[str, tuple[Document, Value]] = {}
        self._inputs: tuple[object, ...] = ()
        self._addresses: Addresses | None = None
        self._resolved_at = 0.0
        self._requests: dict[str, Request] = {}
        self._contexts: dict[str, ReplyContext] = {}
        self.joined = JoinedLinks()

    def keep_addresses(self, resolve: Callable[[], Addresses]) -> Addresses:
        """What ``resolve`` found last, for half a minute: it takes a thread for each name."""
        now = time.monotonic()
        if self._addresses is None or now >= self._resolved_at + _RESOLVE_EACH_S:
            self._addresses, self._resolved_at = resolve(), now
        return self._addresses

    def begin_cycle(self, inputs: tuple[object, ...], note: Callable[[str], None]) -> None:
        """Forget what was made from other ``inputs``: requests, contexts, and what was decoded.

        ``note`` records a heartbeat of a host, before it is sent and when it has been replied to.
        """
        self._note = note
        if inputs != self._inputs:
            self._inputs = inputs
            self._requests.clear()
            self._contexts.clear()
            self._decoded.clear()

    def build_request(self, host: str, build: Callable[[], Request]) -> Request:
        """The request for the readings of a host, made of that for a probe."""
        if host not in self._requests:
            spread = 1.0 + _compute_number(host) % 64 / 128
            rounds = max(1, int(_ASK_EACH_S * spread / self._every))
            wanted = {"op": protocol.OP_READINGS, "every_s": self._every, "rounds": rounds}
            self._requests[host] = {**build(), **wanted}
        return self._requests[host]

    def keep_context(self, host: str, build: Callable[[], ReplyContext]) -> ReplyContext:
        """What ``build`` made of the present inputs for the replies of a host."""
        if host not in self._contexts:
            self._contexts[host] = build()
        return self._contexts[host]

    def find(self, host: str, request: Request) -> Reading | None:
        """What a host says now; None where it must be asked.

        It has a heartbeat now and then, which takes no wait (ADR 211).

        Raises:
            HostError: what ``note`` raises (`begin_cycle`).
        """
        feed = self._feeds.find(host)
        reading = feed.find_reading() if feed is not None else None
        asked = self._asked.get(host)
        # The very same request, unless the inputs have changed.
        if reading is None or not (asked is request or asked == request):
            return None
        return reading if self._keep_heartbeat(host) else None

    def _keep_heartbeat(self, host: str) -> bool:
        """Send a heartbeat where one is due; False where a host does not take them."""
        sent, now, due = self._feeds.take_up_heartbeat(host), time.monotonic(), self._due[host]
        # In the nearest cycle: those of a part are due within milliseconds of each other.
        if sent is None and now >= due - self._every / 2:
            self._note(host)
            if self._feeds.send_heartbeat(host):
                due = self._due[host] = now
        elif sent is not None and sent.whole:
            self._note(host)
            due = self._due[host] = now + _choose_heartbeat_s(host)
        elif sent is not None and sent.is_over:
            return False
        return now < due + _LATE_S

    def ask_anew(self, host: str, request: Request) -> float:
        """Let what a host said before count no longer, because it is asked.

        The seconds for which one that owes a word has been silent: it need not be waited for as long again.
        0 where its connection was lost, which may be opened anew.
        """
        feed = self._feeds.find(host)
        silent_s = 0.0 if feed is None or feed.is_over else feed.silent_s
        self.drop(host)
        self._asked[host] = request
        self._due[host] = time.monotonic() + _choose_heartbeat_s(host)
        return silent_s

    def drop(self, host: str) -> None:
        """Ask a host anew."""
        if self._feeds.take_up_heartbeat(host) is not None:
            # It may have arrived until now. Where the note fails, so does that of the request to come.
            with contextlib.suppress(HostError):
                self._note(host)
        self._feeds.drop(host)
        self._decoded.pop(host, None)

    def decode(
        self, host: str, document: Document, decode: Callable[[Document, Known[Value]], Value]
    ) -> Value:
        """The value of what a host says, decoded once; ``decode`` gets the document and value before, too.

        Raises:
            HostError: it is no reply to a probe.
        """
        known = self._decoded.get(host)
        if known is None or known[0] is not document:
            known = self._decoded[host] = document, decode(document, known)
        return known[1]


def _note_nothing(_host: str) -> None:
    """Note no heartbeat."""


def _compute_number(host: str) -> int:
    """A number by which hosts are spread."""
    return zlib.crc32(host.encode())


def _choose_heartbeat_s(host: str) -> float:
    """Seconds from one heartbeat of a host to the next."""
    return _HEARTBEATS_EACH_S[_compute_number(host) % len(_HEARTBEATS_EACH_S)]
