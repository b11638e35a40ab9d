# SPDX-License-Identifier: Apache-2.0
"""Pulses are written one after the other and leave together; whatever else is written keeps its order."""

import hashlib
import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import paramiko
import pytest
from paramiko.common import cMSG_IGNORE
from paramiko.packet import Packetizer

from edgectl.agent.link import frames
from edgectl.errors import DeadlineError
from edgectl.transport import pulses
from edgectl.transport.base import ConversableSession, RestingExchange
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.transport.sockets import TunedSocket
from tests.pace import patience
from tests.sshd import Lab
from tests.transport.test_conversation import until
from tests.transport.test_packets import use_key

BUSY_S = patience(15.0)


@pytest.fixture
def ends() -> Iterator[tuple[TunedSocket, socket.socket]]:
    """Our end of a line, and the other one."""
    ours, theirs = socket.socketpair()
    with TunedSocket(fileno=ours.detach()) as line, theirs:
        theirs.settimeout(BUSY_S)
        yield line, theirs


def is_silent(end: socket.socket) -> bool:
    """Whether nothing has come."""
    return not select.select([end], [], [], 0.0)[0]


def fill(line: socket.socket) -> None:
    """Write until the line takes no more."""
    while True:
        socket.socket.send(line, b"y" * 65536)


def test_what_is_held_back_leaves_at_once_when_it_is_let_go(ends: tuple[TunedSocket, socket.socket]) -> None:
    line, theirs = ends
    line.hold()
    assert (line.send(b"one "), line.send(b"two ")) == (4, 4)
    assert is_silent(theirs)
    line.hold()
    assert line.send(b"three") == 5
    assert is_silent(theirs)
    line.send_held()
    assert theirs.recv(100) == b"one two three"
    assert line.send(b"four") == 4
    assert theirs.recv(100) == b"four"
    line.send_held()
    assert is_silent(theirs)


def test_another_thread_waits_for_nobody_and_sends_after_what_was_held_back(
    ends: tuple[TunedSocket, socket.socket],
) -> None:
    """The one that holds back may wait for what the other sends, such as for an exchange of keys."""
    line, theirs = ends
    line.hold()
    line.send(b"one ")
    other = threading.Thread(target=line.send, args=(b"two ",))
    other.start()
    other.join(BUSY_S)
    assert theirs.recv(100) == b"one two "
    assert line.send(b"three") == 5
    assert theirs.recv(100) == b"three"
    line.send_held()
    assert is_silent(theirs)


def test_a_line_that_does_not_take_what_was_held_back_has_ended(
    ends: tuple[TunedSocket, socket.socket],
) -> None:
    """A part of a packet would be taken for another one."""
    line, _ = ends
    socket.socket.settimeout(line, 0.05)
    line.hold()
    line.send(b"x" * 100)
    with pytest.raises(TimeoutError):
        fill(line)
    line.send_held()
    assert line.recv(1) == b""


def build_message(text: bytes) -> paramiko.Message:
    message = paramiko.Message()
    message.add_byte(cMSG_IGNORE)
    message.add_string(text)
    return message


def test_packets_keep_their_order_while_some_are_held_back(
    ends: tuple[TunedSocket, socket.socket],
) -> None:
    """The other end checks the signature of each, which counts them; two threads write."""
    line, theirs = ends
    ours, other = Packetizer(line), Packetizer(theirs)
    for end in (ours, other):
        use_key(end, hashlib.sha256)
    count = 2000

    def send_pulses() -> None:
        for _ in range(count):
            line.hold()
            ours.send_message(build_message(b"p" * 10))
            line.send_held()

    def send_requests() -> None:
        for number in range(count):
            ours.send_message(build_message(b"r" * (number % 1500)))

    writers = [threading.Thread(target=each) for each in (send_pulses, send_requests)]
    for each in writers:
        each.start()
    got = [other.read_message()[1].get_binary() for _ in range(2 * count)]
    for each in writers:
        each.join(BUSY_S)
    assert [len(each) for each in got if each[:1] != b"p"] == [number % 1500 for number in range(count)]
    assert got.count(b"p" * 10) == count


def test_all_pulses_are_written_before_the_first_leaves() -> None:
    done: list[str] = []
    with ExitStack() as stack:
        for name in ("one", "two", "three"):

            def send(name: str = name) -> tuple[float, Callable[[], None]]:
                done.append(f"write {name}")
                if name == "two":
                    raise OSError
                return frames.PULSE_S, lambda: done.append(f"let go {name}")

            stack.enter_context(pulses.keep_pulsing(send))
        # The first round may begin while not all of them are there.
        until(lambda: done.count("let go three") >= 2)
    second = [place for place, each in enumerate(done) if each == "write one"][1]
    assert done[second : second + 5] == [
        "write one",
        "write two",
        "write three",
        "let go one",
        "let go three",
    ]


def test_an_exchange_over_ssh_holds_its_writes_back(lab: Lab) -> None:
    session = FleetTransport().connect(lab.host("edge1"), timeout=BUSY_S)
    assert isinstance(session, ConversableSession)
    with session, closing(session.converse("cat", b"", timeout=BUSY_S, give_way=lambda: None)) as exchange:
        assert isinstance(exchange, RestingExchange)
        until(exchange.can_write)
        let_go = exchange.hold_writes()
        exchange.write(b"one\n", timeout=BUSY_S)
        with pytest.raises(DeadlineError):
            exchange.read(timeout=0.3)
        let_go()
        assert exchange.read(timeout=BUSY_S) == b"one\n"
        exchange.write(b"two\n", timeout=BUSY_S)
        assert exchange.read(timeout=BUSY_S) == b"two\n"
