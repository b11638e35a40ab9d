# SPDX-License-Identifier: Apache-2.0
"""What a subscriber of a task hears: every message with its sender, and the gaps between two senders."""

import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise

from tests.pace import patience


@dataclass(frozen=True, slots=True)
class Message:
    """``sent_ns``, ``heard_ns``: on the monotonic clock of this machine, which all its namespaces share."""

    sender: str
    number: int
    sent_ns: int
    heard_ns: int


@dataclass
class Subscriber:
    """``address``, ``port``: where it listens, if at one place. ``messages``: in the order in which they came.

    ``publishers``: how many it has discovered, if it has to; a plain sender connects by itself.
    """

    address: str = ""
    port: int = 0
    publishers: int = 0
    messages: list[Message] = field(default_factory=list)
    guard: threading.Lock = field(default_factory=threading.Lock)

    def count(self) -> int:
        with self.guard:
            return len(self.messages)

    def take(self) -> list[Message]:
        """What has come so far."""
        with self.guard:
            return list(self.messages)

    def wait_for_sender(self, sender: str, more: int = 5) -> None:
        """Wait until ``more`` further messages of ``sender`` have come."""
        begin, deadline = self.count(), time.monotonic() + patience(30.0)
        while sum(message.sender == sender for message in self.take()[begin:]) < more:
            assert time.monotonic() < deadline, f"no message of {sender}"
            time.sleep(0.01)

    def wait_for_publishers(self, count: int) -> None:
        """Wait until the subscriber has discovered ``count`` publishers, those that are silent included."""
        deadline = time.monotonic() + patience(30.0)
        while self.publishers < count:
            assert time.monotonic() < deadline, f"{self.publishers} publishers of {count}"
            time.sleep(0.01)

    def add(self, lines: Sequence[str], heard_ns: int) -> None:
        """Note messages: the sender, its number of the message, and when it was sent."""
        with self.guard:
            for line in lines:
                sender, number, sent = line.split()
                self.messages.append(Message(sender, int(number), int(sent), heard_ns))

    def hear(self, peer: socket.socket) -> None:
        with peer:
            self._hear_until_end(peer)

    def _hear_until_end(self, peer: socket.socket) -> None:
        rest = b""
        while data := _receive(peer):
            now = time.monotonic_ns()
            *lines, rest = (rest + data).split(b"\n")
            self.add([line.decode() for line in lines], now)


def _receive(peer: socket.socket) -> bytes:
    try:
        return peer.recv(65536)
    except OSError:
        return b""


@contextmanager
def listen(address: str, server: socket.socket | None = None) -> Iterator[Subscriber]:
    """Listen on ``address``; ``server``: a socket that does so already, of another network."""
    server = server or socket.create_server((address, 0))
    subscriber = Subscriber(address, server.getsockname()[1])
    hearing: list[tuple[socket.socket, threading.Thread]] = []

    def accept() -> None:
        while True:
            try:
                peer, _ = server.accept()
            except OSError:
                return
            thread = threading.Thread(target=subscriber.hear, args=(peer,), daemon=True)
            hearing.append((peer, thread))
            thread.start()

    accepting = threading.Thread(target=accept, daemon=True)
    accepting.start()
    try:
        yield subscriber
    finally:
        with suppress(OSError):
            server.shutdown(socket.SHUT_RDWR)
        server.close()
        accepting.join()
        for peer, thread in hearing:
            with suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)
            thread.join()


def list_gaps_ms(messages: Sequence[Message]) -> list[float]:
    """The silence at each change of the sender: from the last of the old to the first of the new one; 0 where
    the last of the old one came later, on its own connection.
    """
    return [
        max(0, second.heard_ns - first.heard_ns) / 1e6
        for first, second in pairwise(_order_by_sending(messages))
        if first.sender != second.sender
    ]


def count_overlaps(messages: Sequence[Message], moves: int) -> int:
    """How often two senders were active at once: changes of the sender, by the time of sending, beyond one
    for each move.
    """
    changes = sum(first.sender != second.sender for first, second in pairwise(_order_by_sending(messages)))
    return changes - moves


def _order_by_sending(messages: Sequence[Message]) -> list[Message]:
    return sorted(messages, key=lambda message: message.sent_ns)
