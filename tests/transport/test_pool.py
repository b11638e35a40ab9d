# SPDX-License-Identifier: Apache-2.0
"""Connection reuse: one login per host, a new one after a loss, no second attempt after a refusal."""

import threading
from collections.abc import Iterator
from typing import Self

import pytest

from edgectl.errors import AuthError, ConnectError, HostError
from edgectl.model.inventory import Host
from edgectl.transport.base import Exchange, Reply
from edgectl.transport.connections import SessionPool
from tests.builders import an_edge


class CountingTransport:
    """A transport that counts connects and closes; ``faults`` are raised by the next connects or runs."""

    def __init__(self) -> None:
        self.opened: list[str] = []
        self.closed = 0
        self.refusal: HostError | None = None
        self.fault: HostError | None = None
        self.busy, self.most, self.guard = 0, 0, threading.Lock()
        self.together = threading.Barrier(1)

    def connect(self, host: Host, *, timeout: float) -> "CountedSession":
        self.opened.append(host.name)
        if self.refusal is not None:
            raise self.refusal
        return CountedSession(self)

    def address(self, host: Host) -> str:
        return f"address of {host.name}"


class CountedSession:
    python = "python3"

    def __init__(self, transport: CountingTransport) -> None:
        self.transport = transport

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        with self.transport.guard:
            self.transport.busy += 1
            self.transport.most = max(self.transport.most, self.transport.busy)
        self.transport.together.wait(30)
        with self.transport.guard:
            self.transport.busy -= 1
        if self.transport.fault is not None:
            raise self.transport.fault
        return Reply(stdout=stdin, stderr=b"", status=0)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        yield stdin

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> Exchange:
        raise NotImplementedError

    def close(self) -> None:
        self.transport.closed += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def send_request(pool: SessionPool, name: str = "edge1") -> bytes:
    with pool.connect(an_edge(name), timeout=1.0) as session:
        return session.run("c", b"in", timeout=1.0).stdout


def test_a_host_is_opened_once_and_closed_at_the_end() -> None:
    transport = CountingTransport()
    with SessionPool(transport) as pool:
        assert [send_request(pool), send_request(pool), send_request(pool, "edge2")] == [b"in"] * 3
        with pool.connect(an_edge("edge1"), timeout=1.0) as session:
            assert (session.python, b"".join(session.stream("c", b"out", idle_timeout=1.0))) == (
                "python3",
                b"out",
            )
        assert pool.address(an_edge("edge1")) == "address of edge1"
        assert (transport.opened, transport.closed) == (["edge1", "edge2"], 0)
    assert transport.closed == 2


def test_a_lost_session_is_opened_anew_and_both_are_closed() -> None:
    transport = CountingTransport()
    with SessionPool(transport) as pool:
        send_request(pool)
        transport.fault = ConnectError("lost")
        with pytest.raises(ConnectError):
            send_request(pool)
        transport.fault = None
        send_request(pool)
        assert transport.opened == ["edge1", "edge1"]
    assert transport.closed == 2


def test_a_refused_login_is_not_tried_again() -> None:
    transport = CountingTransport()
    transport.refusal = AuthError("no key was accepted")
    with SessionPool(transport) as pool:
        for _ in range(3):
            with pytest.raises(AuthError):
                send_request(pool)
    assert transport.opened == ["edge1"]


def test_a_refusal_is_forgotten_after_a_while() -> None:
    transport, now = CountingTransport(), [0.0]
    transport.refusal = AuthError("no key was accepted", hint="ssh-copy-id")
    with SessionPool(transport, forget_s=60.0, clock=lambda: now[0]) as pool:
        for _ in range(3):
            with pytest.raises(AuthError) as raised:
                send_request(pool)
            assert raised.value.hint == "ssh-copy-id"
        now[0], transport.refusal = 60.0, None
        assert send_request(pool) == b"in"
    assert transport.opened == ["edge1", "edge1"]


def test_lost_sessions_are_closed_with_their_last_user_and_not_collected() -> None:
    transport = CountingTransport()
    with SessionPool(transport) as pool:
        held = pool.connect(an_edge("edge1"), timeout=1.0)
        for number in range(1, 50):
            transport.fault = ConnectError("lost")
            with pytest.raises(ConnectError):
                send_request(pool)
            transport.fault = None
            send_request(pool)
            assert len(transport.opened) == number + 1
        assert transport.closed == 48, "the first one is still in use"
        held.close()
        held.close()
        assert transport.closed == 49
    assert transport.closed == 50


def test_a_host_that_was_off_is_tried_again() -> None:
    transport = CountingTransport()
    transport.refusal = ConnectError("off")
    with SessionPool(transport) as pool:
        with pytest.raises(ConnectError):
            send_request(pool)
        transport.refusal = None
        assert send_request(pool) == b"in"


def test_threads_share_a_session_and_leave_sshd_two_channels() -> None:
    transport = CountingTransport()
    transport.together = threading.Barrier(8)
    with SessionPool(transport) as pool:
        threads = [threading.Thread(target=send_request, args=(pool,)) for _ in range(24)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert transport.opened == ["edge1"]
    assert transport.most == 8
