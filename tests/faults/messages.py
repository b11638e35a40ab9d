# SPDX-License-Identifier: Apache-2.0
"""Messages of an active task with their sender, as a subscriber in the network of the manager hears them.

They reach the verdict by another way than the records of the hosts: what two senders said at the same time was said
by two that were active.
"""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

from tests.faults.relay import enter_netns


@dataclass
class Subscriber:
    """``spans``: of each sender, when it sent the first and the last message that has come (CLOCK_BOOTTIME, ns)."""

    address: str
    port: int = 0
    count: int = 0
    spans: dict[str, tuple[int, int]] = field(default_factory=dict)

    def hear(self, server: socket.socket) -> None:
        """Note what comes, until the socket is shut down."""
        while data := server.recv(256):
            sender, sent = data.decode().split()
            first, last = self.spans.get(sender, (int(sent), int(sent)))
            self.spans[sender] = (min(first, int(sent)), max(last, int(sent)))
            self.count += 1

    def find_overlaps(self) -> list[str]:
        """Pairs of senders that were active at the same time, one sentence each."""
        found = []
        for (one, (first, last)), (other, (begin, end)) in combinations(list(self.spans.items()), 2):
            shared = min(last, end) - max(first, begin)
            if shared >= 0:
                found.append(f"messages of {one} and {other} were sent in the same {shared / 1e9:.3f} s")
        return found


@contextmanager
def subscribe(address: str, netns: Path | None) -> Iterator[Subscriber]:
    """Listen at ``address``, in the network namespace ``netns`` if there is one."""
    made: list[socket.socket] = []
    ready, subscriber = threading.Event(), Subscriber(address)

    def listen() -> None:
        try:
            if netns:
                enter_netns(netns)
            server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            server.bind((address, 0))
            made.append(server)
        finally:
            ready.set()
        subscriber.hear(server)

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    ready.wait()
    assert made, f"nobody can listen at {address}"
    subscriber.port = made[0].getsockname()[1]
    try:
        yield subscriber
    finally:
        # An empty message ends it: a datagram socket that is not connected cannot be shut down.
        sending = threading.Thread(target=_send_end, args=(address, subscriber.port, netns))
        sending.start()
        sending.join()
        thread.join()
        made[0].close()


def _send_end(address: str, port: int, netns: Path | None) -> None:
    if netns:
        enter_netns(netns)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.sendto(b"", (address, port))
