# SPDX-License-Identifier: Apache-2.0
"""Requests of one connection that go to an agent which stays, instead of a call each (ADR 162).

Only operations that may be carried out twice without harm go this way (`protocol.CONVERSED_OPS`). Whatever is
wrong with the conversation, such a request gets a call of its own, as all others do; so nothing depends on
it, and nobody waits until it is open. Only where many requests are expected (ADR 172) it begins at once, the
first of them wait for it, and it carries `protocol.CONVERSED_CHANGES` too.
"""

import contextlib
import itertools
import json
import math
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Self

from edgectl.agent.link import frames, protocol
from edgectl.errors import ConnectError, DeadlineError, HostError, ReplyError
from edgectl.model.inventory import Connection, Host
from edgectl.transport.agent_client import (
    build_agent_command,
    build_conversed_packet,
    build_packet,
    check_reply,
    parse_reply_json,
    split_frame,
)
from edgectl.transport.base import (
    ConversableSession,
    Exchange,
    OpenExchange,
    Reply,
    RestingExchange,
    Session,
)
from edgectl.transport.pulses import compute_pulse_s, keep_pulsing
from edgectl.transport.readings import ReadingFeed, ReadingFeeds

# Seconds. Requests farther apart are cheaper as calls: to keep an agent costs a pulse each 0.6 s.
KEEP_S = 6.0
# So many requests follow each other closely before an agent stays: those of one slow cycle do not.
MIN_IN_ROW = 4
# From the beginning of a conversation to the first word of the agent.
HELLO_S = 10.0
# For so long from its beginning the requests that are expected wait for it.
PATIENCE_S = 3.0
# From the beginning of one to that of the next: an agent that ends again and again costs more than it saves.
REST_S = 10.0
# Conversations in a row that were of no use. A busy host may say its first word too late, the agent may be
# elsewhere since its file was removed, and a wrapper that reads its input to the end never says one.
_MAX_FRUITLESS = 3
# What a heartbeat may take on the host.
_HEARTBEAT_S = 10.0
# At least so often its thread looks, though nobody wakes it.
_LOOK_EACH_S = 60.0
# Of an end of the conversation that waits for others.
_PATIENCE_S = 0.2
_JOIN_S = 2.0
# Requests of one operation, each after a call of it, that the agent does not take: it has no place for code.
# The first of an operation is refused on each host that has no compiled code of it yet; its call keeps it.
_MAX_REFUSED = 3
_PROGRAM_COUNT = 2
# Of the readings of a host: more than come before somebody looks at them.
_AHEAD_BYTES = 4 * frames.MAX_FRAME_BYTES
# Agents that stay: on one machine, whose slices may be many hosts; and ssh programs here, three files each.
_MAX_ON_MACHINE, _MAX_PROGRAMS = 8, 64


@dataclass(slots=True, eq=False)
class _Question:
    """A request under way. ``whole``: its process has ended well, so ``output`` is all of it; ``refused``: it
    was not begun.
    """

    limit: int
    output: bytearray = field(default_factory=bytearray)
    ended: threading.Event = field(default_factory=threading.Event)
    whole: bool = False
    refused: bool = False

    def add(self, data: bytes) -> None:
        """Add a piece; beyond the limit it ends, and a call of its own says so."""
        if len(self.output) + len(data) > self.limit:
            self.ended.set()
        else:
            self.output += data

    def end(self, *, whole: bool) -> None:
        """Let the asker go on."""
        if not self.ended.is_set():
            self.whole = whole
            self.ended.set()


class Conversation:
    """One agent that stays: a thread begins it and listens to it; that of all sends the pulses.

    Once ``is_over`` it carries nothing any more; ``is_useless``: another one on this connection would not
    either; ``is_fruitless``: the agent has not said anything, or refuses what it is asked.
    While only readings are under way its thread sleeps, and who wants to know them takes them up.
    """

    def __init__(self, session: ConversableSession, greeting: Mapping[str, object]) -> None:
        self.is_over, self.is_useless, self.is_fruitless = False, False, True
        self._session, self._greeting = session, greeting
        self._open, self._decided = False, threading.Event()
        self._exchange: OpenExchange | None = None
        # The same, where it is one that can rest.
        self._resting: RestingExchange | None = None
        self._questions: dict[int, _Question | ReadingFeed] = {}
        # Of these, how many somebody waits for.
        self._awaited = 0
        self._numbers = itertools.count(1)
        # By operation: how many were refused in a row, and when a call of it ended since (s, monotonic).
        self._refused: dict[bytes, tuple[int, float]] = {}
        self._used_at = self._looked_at = time.monotonic()
        self._lock, self._writing = threading.Lock(), threading.Lock()
        self._hearing, self._reader = threading.Lock(), frames.FrameReader(frames.HOST_WORDS)
        self._pulsing: threading.Thread | None = None
        self._thread = threading.Thread(target=self._run, name="edgectl-converse", daemon=True)
        self._thread.start()

    def await_open(self, seconds: float) -> None:
        """Wait, at most so long, until it is open or over."""
        self._decided.wait(seconds)

    def ask(
        self,
        packet: bytes,
        *,
        timeout: float,
        limit: int,
        changes: bool = False,
        feed: ReadingFeed | None = None,
    ) -> bytes | None:
        """The output of one request; None where it needs a call of its own.

        ``packet``: as of `build_packet`, without the programs. ``feed``: for more replies after the first.

        Raises:
            DeadlineError: no reply within ``timeout`` seconds.
            ConnectError: nobody knows whether a request that ``changes`` something was carried out.
        """
        question, asked_at = feed or _Question(limit), time.monotonic()
        deadline = asked_at + timeout
        with self._lock:
            exchange, number = self._exchange, next(self._numbers)
            if not self._open or exchange is None:
                return None
            self._questions[number] = question
            self._awaited += 1
            self._let_rest()
        try:
            with exchange.expect_reply(timeout=timeout, limit=limit):
                with contextlib.suppress(HostError):
                    self._say(exchange, frames.build_frame(frames.ASK, number, packet), timeout)
                if not question.ended.wait(max(0.0, deadline - time.monotonic())):
                    raise DeadlineError(f"no answer within {timeout:.3g} s")
        finally:
            with self._lock:
                if feed is None or not feed.whole:
                    self._questions.pop(number, None)
                self._awaited -= 1
                self._used_at = time.monotonic()
                self._let_rest()
        self._note_refusal(packet, asked_at, refused=question.refused)
        if changes and not question.whole and not question.refused:
            raise ConnectError("the agent ended before it had replied")
        if feed is not None and feed.whole:
            feed.drop, feed.take_up = partial(self._drop, exchange, number), self._take_up
            feed.send_heartbeat = partial(self._send_heartbeat, exchange, _build_heartbeat(packet))
        return bytes(question.output) if question.whole else None

    def _send_heartbeat(self, exchange: OpenExchange, request: Mapping[str, object]) -> ReadingFeed | None:
        """Send a request for which nobody waits, and return what takes its reply.

        None where it cannot be sent without a wait.
        """
        sent = ReadingFeed(marker=secrets.token_hex(16), limit=frames.MAX_FRAME_BYTES)
        packet = build_conversed_packet(request, sent.marker, _HEARTBEAT_S)
        with self._lock:
            if not self._open or self._writing.locked() or not exchange.can_write():
                return None
            number = next(self._numbers)
            self._questions[number] = sent
        sent.drop, sent.take_up = partial(self._drop, exchange, number), self._take_up
        # A part of it ends the conversation, and with it what was to take the reply.
        with contextlib.suppress(HostError):
            self._say(exchange, frames.build_frame(frames.ASK, number, packet), frames.SILENCE_S)
        return sent

    def _note_refusal(self, packet: bytes, asked_at: float, *, refused: bool) -> None:
        """End after many requests of one operation that the agent did not take."""
        operation = packet.partition(b"\n")[0].split()[-1]
        with self._lock:
            if not refused:
                self._refused.pop(operation, None)
                return
            count, called_at = self._refused.get(operation, (0, -math.inf))
            if asked_at >= called_at:
                self._refused[operation] = count + 1, math.inf
            over = self._refused[operation][0] >= _MAX_REFUSED
        if over:
            self.is_fruitless = True
            self.end()

    def note_call(self, packet: bytes) -> None:
        """Note that a request had a call of its own, and has been carried out."""
        operation = packet.partition(b"\n")[0].split()[-1]
        with self._lock:
            if operation in self._refused:
                count, called_at = self._refused[operation]
                self._refused[operation] = count, min(called_at, time.monotonic())

    def _drop(self, exchange: OpenExchange, number: int) -> None:
        """Tell the agent that nobody listens to a feed any more."""
        with self._lock:
            found = self._questions.pop(number, None)
        if found is not None:
            with contextlib.suppress(HostError):
                self._say(exchange, frames.build_frame(frames.DROP, number), _PATIENCE_S)

    def give_way(self) -> None:
        """End for good: the host has no room for a conversation beside other calls."""
        self.is_useless = True
        self.end()

    def end(self) -> None:
        """Carry nothing any more. What is under way gets calls of its own; the agent ends with its input."""
        with self._lock:
            exchange, self._exchange = self._exchange, None
            self._open, self.is_over = False, True
            self._decided.set()
            questions = list(self._questions.values())
        for question in questions:
            question.end(whole=False)
        if exchange is not None and self._writing.acquire(timeout=_PATIENCE_S):
            try:
                with contextlib.suppress(Exception):
                    exchange.finish(b"", timeout=_PATIENCE_S)
            finally:
                self._writing.release()

    def join(self) -> None:
        """Wait for the thread, which closes what it has opened."""
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        marker = secrets.token_hex(16)
        # Whatever goes wrong costs no request: each may have a call of its own.
        with contextlib.suppress(Exception), contextlib.closing(self._begin(marker)) as exchange:
            try:
                self._resting = exchange if isinstance(exchange, RestingExchange) else None
                rest = self._await_first_word(exchange, marker)
                with keep_pulsing(partial(self._pulse, exchange)):
                    self._listen(exchange, rest)
            finally:
                self.end()
        self.end()

    def _begin(self, marker: str) -> OpenExchange:
        try:
            return self._session.converse(
                build_agent_command(self._session.python),
                build_packet(self._greeting, marker, HELLO_S),
                timeout=HELLO_S,
                give_way=self.give_way,
            )
        except HostError as error:
            self.is_useless = not isinstance(error, DeadlineError)
            raise

    def _await_first_word(self, exchange: OpenExchange, marker: str) -> bytes:
        """Wait until the agent says that it stays; what came after that.

        Nothing is asked before: a wrapper that reads all its input first would carry it out much later.

        Raises:
            ReplyError: it says something else, or nothing.
        """
        said, deadline = b"", time.monotonic() + HELLO_S
        while (found := split_frame(said, marker)) is None:
            if self.is_over or time.monotonic() >= deadline:
                raise ReplyError("the agent has not said anything")
            if len(said) > protocol.MAX_REPLY_BYTES:
                self.is_useless = True
                raise ReplyError("the agent does not stay")
            with contextlib.suppress(DeadlineError):
                # In steps, because it may have to give way meanwhile.
                piece = exchange.read(timeout=_PATIENCE_S)
                said += piece
                if not piece:
                    raise ReplyError("the agent has ended")
        payload, rest = found
        self.is_fruitless = False
        try:
            check_reply(parse_reply_json(payload))
        except HostError:
            self.is_useless = True
            raise
        with self._lock:
            if not self.is_over:
                self._exchange, self._open = exchange, True
                self._used_at = time.monotonic()
                self._decided.set()
        return rest

    def _listen(self, exchange: OpenExchange, data: bytes) -> None:
        """Hand out what the agent says, until either side ends or nobody has asked for long.

        Raises:
            HostError: the agent or the line has ended.
            ValueError: what came is no frame.
        """
        with self._hearing:
            self._hear_frames(exchange, data)
        while not self.is_over:
            pause = KEEP_S / 2
            if self._resting is not None:
                # Whoever takes up what has come meanwhile must not wait for this thread. While nobody does,
                # the thread of the pulses wakes it.
                self._resting.await_arrival(_LOOK_EACH_S)
                pause = 0.0
            with self._hearing:
                heard = self._hear_next(exchange, pause)
            self._looked_at = time.monotonic()
            if not heard and self._is_idle():
                return

    def _take_up(self) -> None:
        """Hear what has come, unless that may have to wait: then the thread will do so."""
        exchange = self._resting
        self._looked_at = time.monotonic()
        if exchange is None or self.is_over or not exchange.has_arrived():
            return
        if self._hearing.acquire(blocking=False):
            try:
                self._hear_next(exchange, 0.0)
            except (HostError, ValueError):
                self.end()
            finally:
                self._hearing.release()

    def _hear_next(self, exchange: OpenExchange, seconds: float) -> bool:
        """Hear what comes within ``seconds``; False where nothing does. Raises as `_listen`."""
        try:
            data = exchange.read(timeout=seconds)
        except DeadlineError:
            return False
        if not data:
            raise ReplyError("the agent has ended")
        self._hear_frames(exchange, data)
        return True

    def _hear_frames(self, exchange: OpenExchange, data: bytes) -> None:
        at = time.monotonic() if self._resting is None else self._resting.arrived_at
        for word, number, body in self._reader.feed(data):
            self._hear(exchange, word, number, body, at)

    def _let_rest(self) -> None:
        """Let the thread sleep while nobody waits for what may come; with the lock."""
        if self._resting is not None:
            self._resting.rest(resting=not self._awaited)

    def _pulse(self, exchange: OpenExchange) -> tuple[float, Callable[[], None]]:
        """Send a pulse; where that may have to wait, from another thread, so that no other host waits. The
        seconds until the next one, and what lets this one go.

        What is being written now is a pulse, too.
        """
        resting, says = self._resting, False
        waits = self._pulsing is not None and self._pulsing.is_alive()
        if not (waits or self.is_over or self._writing.locked()):
            says = exchange.can_write()
            waits = not says
            if waits:
                self._pulsing = threading.Thread(target=self._say_pulse, args=(exchange,), daemon=True)
                self._pulsing.start()
        if resting is not None and (waits or time.monotonic() - self._looked_at >= KEEP_S / 2):
            # Nobody takes up what the host said, or it would have to wait.
            resting.wake()
        seconds = compute_pulse_s(None if resting is None else resting.find_repeat_s())
        let_go = _hold_nothing if resting is None or not says else resting.hold_writes()
        if says:
            self._say_pulse(exchange)
        return seconds, let_go

    def _say_pulse(self, exchange: OpenExchange) -> None:
        # Whatever goes wrong has ended the conversation.
        with contextlib.suppress(Exception):
            self._say(exchange, frames.build_frame(frames.PULSE), frames.SILENCE_S)

    def _is_idle(self) -> bool:
        """Whether nobody has asked for long; then nobody can any more."""
        with self._lock:
            idle = not self._questions and time.monotonic() - self._used_at >= KEEP_S
            self._open = self._open and not idle
        return idle

    def _hear(self, exchange: OpenExchange, word: str, number: int, body: bytes, at: float) -> None:
        with self._lock:
            question = self._questions.get(number)
        if question is None:
            # Its asker has given up.
            return
        if word == frames.OUTPUT:
            if isinstance(question, ReadingFeed):
                question.add(body, at)
                exchange.expect_more(_AHEAD_BYTES)
            else:
                question.add(body)
            return
        question.refused = word == frames.REFUSED
        question.end(whole=word == frames.END and body == b"0")
        if isinstance(question, ReadingFeed):
            with self._lock:
                self._questions.pop(number, None)

    def _say(self, exchange: OpenExchange, frame: bytes, timeout: float) -> None:
        """Send one whole frame; a part of one ends the conversation.

        Raises:
            HostError: it could not be sent in time.
        """
        deadline = time.monotonic() + timeout
        if not self._writing.acquire(timeout=timeout):
            raise DeadlineError(f"no answer within {timeout:.3g} s")
        try:
            try:
                exchange.write(frame, timeout=max(0.0, deadline - time.monotonic()))
            finally:
                self._writing.release()
        except BaseException:
            self.end()
            raise


class ConversingSession:
    """A session whose reading requests go to one agent that stays, once they follow each other closely."""

    def __init__(
        self, session: ConversableSession, put_feed: Callable[[ReadingFeed], None] | None = None
    ) -> None:
        """``put_feed`` takes the feed of each request for readings that the agent serves."""
        self._session, self._put_feed = session, put_feed
        self._lock = threading.Lock()
        self._conversation: Conversation | None = None
        self._closed = self._expecting = False
        self._asked_at = self._begun_at = -math.inf
        self._in_row = self._fruitless = 0

    @property
    def python(self) -> str:
        """As the connection."""
        return self._session.python

    def expect_requests(self, host: Host) -> None:
        """Begin a conversation at once: many requests follow, also such that change something."""
        with self._lock:
            self._expecting = True
            if not self._closed and self._may_begin():
                self._begin(host.fleet, host.name)

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        """As ``Session.run``."""
        packet, changes = (
            _find_packet(stdin) if command == build_agent_command(self.python) else (None, False)
        )
        if packet is None or (changes and not self._expecting):
            return self._session.run(command, stdin, timeout=timeout, limit=limit)
        conversation, deadline = self._find_conversation(packet), time.monotonic() + timeout
        try:
            if conversation is not None:
                output = self._ask_agent(conversation, packet, deadline, limit, changes=changes)
                if output is not None:
                    return Reply(stdout=output, stderr=b"", status=0)
            reply = self._session.run(command, stdin, timeout=_compute_left(deadline), limit=limit)
        except DeadlineError as error:
            # Its own message is of what was left.
            raise DeadlineError(f"no answer within {timeout:.3g} s", host=error.host) from error
        else:
            if conversation is not None:
                conversation.note_call(packet)
            return reply
        finally:
            self._asked_at = time.monotonic()

    def _ask_agent(
        self, conversation: Conversation, packet: bytes, deadline: float, limit: int, *, changes: bool
    ) -> bytes | None:
        """As `Conversation.ask`; first waits until the agent has begun, where requests are expected."""
        if self._expecting:
            opens_by = min(deadline, self._begun_at + PATIENCE_S)
            conversation.await_open(opens_by - time.monotonic())
        feed = self._make_feed(packet, limit)
        output = conversation.ask(
            packet, timeout=_compute_left(deadline), limit=limit, changes=changes, feed=feed
        )
        if output is not None and feed is not None and self._put_feed is not None:
            self._put_feed(feed)
        return output

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        """As ``Session.stream``, a call of its own."""
        return self._session.stream(command, stdin, idle_timeout=idle_timeout)

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> Exchange:
        """As ``Session.exchange``, a call of its own."""
        return self._session.exchange(command, stdin, timeout=timeout)

    def close(self) -> None:
        """Close the connection, and end the conversation with it; `join` waits for its thread."""
        with self._lock:
            self._closed = True
        self._session.close()
        if self._conversation is not None:
            self._conversation.end()

    def join(self) -> None:
        """Wait, after `close`, until nothing is left of the conversation here."""
        if self._conversation is not None:
            self._conversation.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _make_feed(self, packet: bytes, limit: int) -> ReadingFeed | None:
        """A feed for a request for readings; None for any other."""
        words = packet.partition(b"\n")[0].decode("ascii").split()
        if self._put_feed is None or words[-1] != protocol.OP_READINGS:
            return None
        return ReadingFeed(marker=words[0], limit=limit)

    def _find_conversation(self, packet: bytes) -> Conversation | None:
        """The conversation, if there is one; begins one where that may pay, which this request does not wait
        for.
        """
        with self._lock:
            now = time.monotonic()
            self._in_row = self._in_row + 1 if now - self._asked_at <= KEEP_S else 1
            if not self._may_begin():
                return self._conversation
            if not self._closed and self._in_row >= MIN_IN_ROW and now - self._begun_at >= REST_S:
                asked = json.loads(packet.partition(b"\n")[2])
                self._begin(asked["fleet"], asked["host"])
        return None

    def _may_begin(self) -> bool:
        """Whether no conversation is under way, and another one may be of use; with the lock."""
        found = self._conversation
        if found is None:
            return True
        fruitless = self._fruitless + found.is_fruitless
        return found.is_over and not found.is_useless and fruitless < _MAX_FRUITLESS

    def _begin(self, fleet: str, host: str) -> None:
        """Begin a conversation; with the lock."""
        found = self._conversation
        self._fruitless = self._fruitless + 1 if found is not None and found.is_fruitless else 0
        self._begun_at = time.monotonic()
        self._conversation = Conversation(self._session, _build_greeting(fleet, host))


def share_agent(
    session: Session,
    host: Host,
    address: Callable[[Host], str],
    staying: dict[str, set[str]],
    feeds: ReadingFeeds | None = None,
) -> Session:
    """``session`` with an agent that stays, if it can keep one and not too many do.

    ``staying``: the names of the hosts whose agents may, by what they share; that of ``host`` is added.
    ``feeds`` receive what the agent says by itself.
    """
    if not isinstance(session, ConversableSession):
        return session
    is_local = host.connection is Connection.LOCAL
    most = {"this machine" if is_local else f"address {address(host)}": _MAX_ON_MACHINE}
    if host.connection is Connection.OPENSSH:
        most["ssh"] = _MAX_PROGRAMS
    for name, count in most.items():
        names = staying.setdefault(name, set())
        if len(names) >= count and host.name not in names:
            return session
        names.add(host.name)
    return ConversingSession(session, None if feeds is None else partial(feeds.put, host.name))


def _find_packet(stdin: bytes) -> tuple[bytes | None, bool]:
    """The input of a call (`build_packet`) without its programs, if a conversation may carry it, and whether
    it changes something.
    """
    try:
        for _ in range(_PROGRAM_COUNT):
            size, _, rest = stdin.partition(b"\n")
            stdin = rest[int(size) :]
        head, _, body = stdin.partition(b"\n")
        _, _, length, agent_length, _, _, operation = head.decode("ascii").split()
        whole = (int(length), int(agent_length)) == (len(body), 0)
    except ValueError:
        return None, False
    changes = operation in protocol.CONVERSED_CHANGES
    if (
        not (whole and (changes or operation in protocol.CONVERSED_OPS))
        or len(stdin) > frames.MAX_FRAME_BYTES
    ):
        return None, False
    return stdin, changes


def _compute_left(deadline: float) -> float:
    """The seconds until then. Raises DeadlineError where none are left."""
    left = deadline - time.monotonic()
    if left <= 0:
        raise DeadlineError("no time is left")
    return left


def _hold_nothing() -> None:
    """Let go nothing."""


def _build_heartbeat(packet: bytes) -> dict[str, object]:
    """The request for no readings, by the manager and to the host of a request for some."""
    asked = json.loads(packet.partition(b"\n")[2])
    return {**{key: asked[key] for key in ("op", "fleet", "host")}, "rounds": 0}


def _build_greeting(fleet: str, host: str) -> dict[str, object]:
    """The request for a conversation, by the manager of this fleet."""
    return {"op": protocol.OP_CONVERSE, "fleet": fleet, "host": host}
