# SPDX-License-Identifier: Apache-2.0
"""Readings that hosts send by themselves, over the agents that stay (ADR 169).

One request brings many replies: the first for its asker, and later ones, which say what changed, for whoever
looks at the reading next. Nothing waits here; a feed that is over costs its host a request as before.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from edgectl.agent.link import protocol
from edgectl.errors import ReplyError
from edgectl.transport.agent_client import parse_reply_json, split_frame
from edgectl.transport.base import trace_call

# A host says something each `protocol.READING_SAID_S`; half as much later it is asked.
SILENT_S = 1.5 * protocol.READING_SAID_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """The reply of a host to a probe, as it would be had it been asked at ``came_at`` (s, monotonic).

    ``said_at``: when the host said last that it is so still.
    """

    document: dict[str, object]
    came_at: float
    said_at: float


@dataclass(slots=True, eq=False)
class ReadingFeed:
    """The replies to one request for readings, under way in a conversation (`conversation.Conversation`).

    ``limit``: bytes of all of them; beyond it ends. ``drop``: tells the host that nobody listens any more.
    ``take_up``: adds what has come meanwhile, without a wait. ``send_heartbeat``: sends its host a request
    that is a heartbeat alone, and returns what takes the reply; None where that may have to wait.
    ``ended``: the first reply has come, or none will; ``whole``: ``output`` is that reply.
    """

    marker: str
    limit: int
    output: bytes = b""
    ended: threading.Event = field(default_factory=threading.Event)
    whole: bool = False
    refused: bool = False
    is_over: bool = False
    reading: Reading | None = None
    drop: Callable[[], None] | None = None
    take_up: Callable[[], None] | None = None
    send_heartbeat: "Callable[[], ReadingFeed | None] | None" = None
    _buffer: bytes = b""
    _received: int = 0

    def add(self, data: bytes, at: float | None = None) -> None:
        """Add a piece of the output of the request, which came ``at`` (s, monotonic; None: now); one thread
        at a time.
        """
        if self.is_over:
            return
        self._buffer += data
        self._received += len(data)
        try:
            while (found := split_frame(self._buffer, self.marker)) is not None:
                size = len(self._buffer) - len(found[1])
                frame, self._buffer = self._buffer[:size], found[1]
                self._take(frame, found[0], time.monotonic() if at is None else at)
        except ReplyError:
            self.end(whole=False)
        if self._received > self.limit:
            self.end(whole=False)

    def end(self, *, whole: bool) -> None:
        """End it: no more replies come, or one was wrong. The first one is not taken back."""
        del whole
        self.is_over = True
        self.ended.set()

    def find_reading(self) -> Reading | None:
        """What the host says now; None where it must be asked."""
        silent_s = self.silent_s
        return None if self.is_over or silent_s else self.reading

    @property
    def silent_s(self) -> float:
        """Seconds since the host said something, once it owes a word; else 0."""
        if self.take_up is not None:
            self.take_up()
        seconds = 0.0 if self.reading is None else time.monotonic() - self.reading.said_at
        return seconds if seconds > SILENT_S else 0.0

    def _take(self, frame: bytes, payload: bytes, now: float) -> None:
        document = parse_reply_json(payload)
        if "error" in document:
            raise ReplyError("the host stopped to measure")
        before = self.reading
        if before is None:
            self.reading = Reading(document=document, came_at=now, said_at=now)
            self.output, self.whole = frame, True
            self.ended.set()
        elif document:
            merged = _merge_update(before.document, document)
            self.reading = Reading(document=merged, came_at=now, said_at=now)
        else:
            self.reading = Reading(document=before.document, came_at=before.came_at, said_at=now)


def _merge_update(before: dict[str, object], update: dict[str, object]) -> dict[str, object]:
    """The reply of which ``update`` states what changed.

    Raises:
        ReplyError: it is no update.
    """
    changed, entries, gone = update.get("changed"), update.get("entries", {}), update.get("gone")
    if not (isinstance(changed, dict) and isinstance(entries, dict) and isinstance(gone, list)):
        raise ReplyError("not an update of a reading")
    merged = {key: value for key, value in before.items() if key not in gone} | changed
    for key, some in entries.items():
        known = merged.get(key)
        if not (isinstance(known, dict) and isinstance(some, dict)):
            raise ReplyError("not an update of a reading")
        merged[key] = known | some
    return merged


class ReadingFeeds:
    """The feeds of the hosts of one pool, by name; safe from any thread."""

    def __init__(self) -> None:
        self._feeds: dict[str, ReadingFeed] = {}
        # By host: the heartbeat that was sent last, until its reply was looked at.
        self._heartbeats: dict[str, ReadingFeed] = {}

    def put(self, host: str, feed: ReadingFeed) -> None:
        """Use ``feed`` for ``host`` instead of the one before."""
        self.drop(host)
        self._feeds[host] = feed

    def find(self, host: str) -> ReadingFeed | None:
        """The feed of a host, if it has one."""
        return self._feeds.get(host)

    def send_heartbeat(self, host: str) -> bool:
        """Send a host that has a feed a heartbeat over its connection; False where that may have to wait."""
        feed = self._feeds.get(host)
        if feed is None or feed.send_heartbeat is None:
            return False
        with trace_call(host, "heartbeat"):
            sent = feed.send_heartbeat()
        if sent is not None:
            self._heartbeats[host] = sent
        return sent is not None

    def take_up_heartbeat(self, host: str) -> ReadingFeed | None:
        """The heartbeat under way to a host, with what has come of its reply; with that it is no longer under
        way.
        """
        sent = self._heartbeats.get(host)
        if sent is not None and sent.take_up is not None:
            sent.take_up()
        if sent is not None and sent.whole:
            del self._heartbeats[host]
        return sent

    def drop(self, host: str) -> None:
        """Listen no longer to a host."""
        _end_feed(self._heartbeats.pop(host, None))
        _end_feed(self._feeds.pop(host, None))


def _end_feed(feed: ReadingFeed | None) -> None:
    """End a feed, if there is one, and tell its host."""
    if feed is not None and not feed.is_over:
        feed.end(whole=False)
        if feed.drop is not None:
            feed.drop()
