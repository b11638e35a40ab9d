# SPDX-License-Identifier: Apache-2.0
"""What the kernel's account of a connection says of its link: by accounts made by hand, in windows of half a second."""

import struct
from types import SimpleNamespace
from typing import Any

import pytest

from edgectl.agent.measure.link_rate import Sender, compare_senders, estimate_rate

WINDOW_S = 0.5
PICTURE = 77_000


def an_account(
    *,
    under_way: int = 20,
    rate: float = 191e3,
    app_limited: bool = False,
    busy_s: float = 0.0,
    waited_s: float = 0.0,
    rtt_ms: float = 150.0,
) -> bytes:
    """A struct tcp_info: ``under_way`` segments, delivered at ``rate`` bytes/s; round trips of 1 ms without a queue."""
    info = bytearray(232)
    info[7] = app_limited
    for at, value in ((24, under_way), (68, rtt_ms * 1000), (76, 0x7FFFFFFF), (148, 1000)):
        struct.pack_into("=I", info, at, int(value))
    times = (int(1e6 * busy_s), int(1e6 * waited_s), 0)
    struct.pack_into("=QQQQ", info, 160, int(rate), *times)
    return bytes(info)


def estimate(*senders: Sender, sent: int = PICTURE) -> float | None:
    flows: Any = [SimpleNamespace(rx=300, tx=sent, sender=sender) for sender in senders]
    return estimate_rate(flows, WINDOW_S)


def test_the_middle_of_a_burst_tells_the_rate() -> None:
    """Of either end of the window; the other one is in a pause."""
    pause = an_account(under_way=0, rate=130e3)
    later = an_account(busy_s=0.37)
    assert estimate(compare_senders(pause, later, PICTURE)) == 191e3
    over = an_account(under_way=0, rate=130e3, busy_s=0.37)
    assert estimate(compare_senders(an_account(), over, PICTURE)) == 191e3
    assert estimate(compare_senders(b"", later, PICTURE)) == 191e3, "opened within the window"


@pytest.mark.parametrize("under_way", [0, 1, 2])
def test_the_end_of_a_burst_tells_nothing(under_way: int) -> None:
    """A link of 2 MB/s: the last segment of a burst is acknowledged 40 ms late, so the rate reads 0.8 MB/s or less."""
    end = an_account(under_way=under_way, rate=446e3, busy_s=0.2)
    assert estimate(compare_senders(an_account(under_way=0), end, 2 * PICTURE)) is None


@pytest.mark.parametrize(
    "now",
    [
        an_account(app_limited=True, busy_s=0.3),
        an_account(rtt_ms=1.5, busy_s=0.3),
        an_account(busy_s=0.4, waited_s=0.1),
        b"",
        an_account()[:160],
    ],
    ids=["the program is slow", "no queue: TCP begins", "the receiver is slow", "closed", "an old kernel"],
)
def test_no_reading_where_something_else_is_the_limit(now: bytes) -> None:
    assert estimate(compare_senders(an_account(under_way=0), now, PICTURE)) is None


def test_no_reading_of_little_traffic() -> None:
    assert estimate(compare_senders(an_account(), an_account(busy_s=0.5), 32_000), sent=32_000) is None


def test_all_traffic_counts_where_a_connection_sends_all_the_time() -> None:
    """The rate of a delivery is that of one connection; beside it another one sends."""
    steady = compare_senders(an_account(rtt_ms=1.5), an_account(rtt_ms=1.5, busy_s=0.5), PICTURE)
    assert estimate(steady, Sender()) == 2 * (PICTURE + 300) / WINDOW_S
    often = compare_senders(an_account(rate=1.9e6), an_account(rate=1.9e6, busy_s=0.4), PICTURE)
    assert estimate(often) == 1.9e6, "in two bursts, with a pause between them"
