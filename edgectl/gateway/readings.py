# SPDX-License-Identifier: Apache-2.0
"""Probes from readings that hosts send by themselves: which of them count, and what was decoded of them."""

import time
import zlib
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from edgectl.agent.link import protocol
from edgectl.gateway.link_observations import JoinedLinks
from edgectl.gateway.probe_reply import ReplyContext
from edgectl.transport.readings import Reading, ReadingFeeds

Value = TypeVar("Value")
Request = dict[str, object]
# By name: those of robots, and those of edges.
Addresses = tuple[dict[str, str], dict[str, str]]
Document = dict[str, object]
Known = tuple[Mapping[str, object], Value] | None
# A host is asked anew after so long, and up to half as much later: not all hosts in one cycle (s). A request
# is a contact, by which a host knows that its manager is there; what a host sends is none.
_ASK_EACH_S = 30.0
# At longer periods no agent stays (`transport.conversation`).
MAX_EVERY_S = 5.0


class FleetReadings(Generic[Value]):
    """The readings of the hosts of one fleet, each ``every`` s; ``feeds`` are those of its connections.

    A reading counts for the very request that it answers. ``joined``: the links of all hosts. For one thread;
    what different hosts say may be decoded by different ones.
    """

    def __init__(self, feeds: ReadingFeeds, *, every: float) -> None:
        self._feeds, self._every = feeds, every
        self._asked: dict[str, Request] = {}
        # By host: what it said, the same made of equal parts of what it said before, and its value.
        self._decoded: dict[str, tuple[Document, Document, Value]] = {}
        self._inputs: tuple[object, ...] = ()
        self._addresses: Addresses | None = None
        self._resolved_at = 0.0
        self._requests: dict[str, Request] = {}
        self._contexts: dict[str, ReplyContext] = {}
        self.joined = JoinedLinks()

    def keep_addresses(self, resolve: Callable[[], Addresses]) -> Addresses:
        """What ``resolve`` finds, for as long as no host is asked anew: it takes a thread for each name."""
        now = time.monotonic()
        if self._addresses is None or now >= self._resolved_at + _ASK_EACH_S:
            self._addresses, self._resolved_at = resolve(), now
        return self._addresses

    def use_inputs(self, inputs: tuple[object, ...]) -> None:
        """Forget what was made from other ``inputs``: requests, contexts, and what was decoded."""
        if inputs != self._inputs:
            self._inputs = inputs
            self._requests.clear()
            self._contexts.clear()
            self._decoded.clear()

    def build_request(self, host: str, build: Callable[[], Request]) -> Request:
        """The request for the readings of a host, made of that for a probe."""
        if host not in self._requests:
            spread = 1.0 + zlib.crc32(host.encode()) % 64 / 128
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
        """What a host says now; None where it must be asked."""
        feed = self._feeds.find(host)
        reading = feed.find_reading() if feed is not None else None
        asked = self._asked.get(host)
        # The very same request, unless the inputs have changed.
        return reading if asked is request or asked == request else None

    def ask_anew(self, host: str, request: Request) -> float:
        """Let what a host said before count no longer, because it is asked.

        The seconds for which one that owes a word has been silent: it need not be waited for as long again.
        0 where its connection was lost, which may be opened anew.
        """
        feed = self._feeds.find(host)
        silent_s = 0.0 if feed is None or feed.is_over else feed.silent_s
        self._feeds.drop(host)
        self._asked[host] = request
        return silent_s

    def drop(self, host: str) -> None:
        """Ask a host anew, and decode all of what it says."""
        self._feeds.drop(host)
        self._decoded.pop(host, None)

    def decode(
        self, host: str, document: Document, decode: Callable[[Document, Known[Value]], Value]
    ) -> Value:
        """The value of what a host says, decoded once; ``decode`` gets the document and value before, too.

        A host that is asked anew repeats most of it; what is equal is taken for the very same.

        Raises:
            HostError: it is no reply to a probe.
        """
        known = self._decoded.get(host)
        if known is None:
            known = self._decoded[host] = document, document, decode(document, None)
        elif known[0] is not document:
            said, kept, value = known
            same = _take_equal_parts(document, said, kept)
            known = self._decoded[host] = document, same, decode(same, (kept, value))
        return known[2]


def _take_equal_parts(document: Document, said: Document, kept: Document) -> Document:
    """``document`` with each value, and each entry of a mapping, that is equal in ``kept`` taken from there;
    ``kept`` is what was made of ``said``.

    Equal is what Python calls so: true where 1 was known is 1, which was checked when it came.
    """
    found: Document = {}
    for key, value in document.items():
        known = kept.get(key)
        if value is said.get(key) or value == known:
            found[key] = known
        elif isinstance(value, dict) and isinstance(known, dict):
            found[key] = {
                name: known[name] if name in known and known[name] == entry else entry
                for name, entry in value.items()
            }
        else:
            found[key] = value
    return found
