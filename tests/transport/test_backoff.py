# SPDX-License-Identifier: Apache-2.0
"""A host that does not answer is tried less and less often; one that answers, every time."""

import pytest

from edgectl.errors import AuthError, ConnectError, DeadlineError, HostError
from edgectl.transport.connections import BackoffTransport, compute_host_backoff_s
from tests.builders import an_edge
from tests.transport.test_pool import CountingTransport

EDGE = an_edge("edge1")


class ManualClock:
    """A clock that stands still until it is set."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def send_request(patient: BackoffTransport, name: str = "edge1") -> bytes:
    with patient.connect(an_edge(name), timeout=1.0) as session:
        return session.run("c", b"in", timeout=1.0).stdout


def count_attempts(
    transport: CountingTransport,
    patient: BackoffTransport,
    hands: ManualClock,
    seconds: int,
    every: float = 10.0,
) -> int:
    """Count the connection attempts in ``seconds`` with a request every ``every`` seconds."""
    before = len(transport.opened)
    for _ in range(int(seconds / every)):
        with pytest.raises(HostError):
            send_request(patient)
        hands.now += every
    return len(transport.opened) - before


def test_a_dead_host_is_asked_once_a_minute_in_the_end_and_at_once_when_it_is_back() -> None:
    transport, hands = CountingTransport(), ManualClock()
    patient = BackoffTransport(transport, clock=hands)
    transport.refusal = ConnectError("no route to host", hint="switch it on")
    assert count_attempts(transport, patient, hands, 600) == 13, "at 0, 10, 20, 40, 80, 140, 200 .. s"
    with pytest.raises(ConnectError, match="no route to host") as raised:
        send_request(patient)
    assert raised.value.hint == "switch it on"
    transport.refusal = None
    hands.now += 60.0
    assert send_request(patient) == b"in"
    transport.refusal = ConnectError("gone again")
    assert count_attempts(transport, patient, hands, 20) == 2, (
        "what was before is forgotten, so the first loss is forgiven again"
    )


def test_other_hosts_are_asked_all_the_while() -> None:
    transport, hands = CountingTransport(), ManualClock()
    patient = BackoffTransport(transport, clock=hands)
    transport.refusal = ConnectError("off")
    count_attempts(transport, patient, hands, 60)
    transport.refusal = None
    assert send_request(patient, "edge2") == b"in"


def test_a_host_that_connects_and_never_answers_rests_too() -> None:
    transport, hands = CountingTransport(), ManualClock()
    patient = BackoffTransport(transport, clock=hands)
    transport.fault = DeadlineError("frozen")
    assert count_attempts(transport, patient, hands, 600) == 13


def test_who_refuses_is_left_alone_for_longer() -> None:
    assert [compute_host_backoff_s(AuthError("no"), n) for n in (1, 2, 3, 4, 5, 50)] == [
        60.0,
        120.0,
        240.0,
        480.0,
        600.0,
        600.0,
    ]
    assert [compute_host_backoff_s(ConnectError("no"), n) for n in (1, 2, 3, 4, 5, 50)] == [
        0.0,
        10.0,
        20.0,
        40.0,
        60.0,
        60.0,
    ]
