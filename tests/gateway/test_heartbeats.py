# SPDX-License-Identifier: Apache-2.0
"""Hosts that send readings by themselves have heartbeats, for which no cycle of a watch waits."""

import time
from collections.abc import Callable

import pytest

from edgectl.errors import HostError
from edgectl.gateway.readings import FleetReadings
from edgectl.transport.fake import frame_reply
from edgectl.transport.readings import ReadingFeed, ReadingFeeds

MARKER = "ab" * 16
REQUEST: dict[str, object] = {"op": "readings"}


class Host:
    """A host that has sent a reading; ``sent``: its heartbeats; ``dropped``: requests for which nobody listens."""

    def __init__(self) -> None:
        self.feeds, self.noted = ReadingFeeds(), 0
        self.sent: list[ReadingFeed] = []
        self.dropped = 0
        self.has_room = True
        self.readings = FleetReadings[object](self.feeds, every=1.0)
        self.readings.begin_cycle((), self.note)
        self.ask()

    def note(self, _host: str) -> None:
        self.noted += 1

    def ask(self) -> None:
        self.readings.ask_anew("edge1", REQUEST)
        feed = ReadingFeed(marker=MARKER, limit=1000)
        feed.add(frame_reply(MARKER, {"v": 1}))
        feed.send_heartbeat = self.send
        self.feeds.put("edge1", feed)

    def send(self) -> ReadingFeed | None:
        if not self.has_room:
            return None
        self.sent.append(ReadingFeed(marker=MARKER, limit=1000, drop=self.note_drop))
        return self.sent[-1]

    def note_drop(self) -> None:
        self.dropped += 1

    def is_known(self) -> bool:
        """Look at it, as each cycle does; False where it is to be asked."""
        return self.readings.find("edge1", REQUEST) is not None


@pytest.fixture
def pass_s(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """A function that lets so many seconds pass, for all that is not the host's own word."""
    clock = [1000.0]

    def pass_seconds(seconds: float) -> None:
        clock[0] += seconds

    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    # The host is never silent here.
    monkeypatch.setattr(ReadingFeed, "silent_s", 0.0)
    return pass_seconds


def test_a_heartbeat_is_recorded_before_it_is_sent_and_when_it_was_replied_to(
    pass_s: Callable[[float], None],
) -> None:
    host = Host()
    pass_s(29.0)
    assert host.is_known()
    assert (host.noted, host.sent) == (0, [])
    pass_s(16.1)
    assert host.is_known()
    assert (host.noted, len(host.sent)) == (1, 1)
    pass_s(1.0)
    assert host.is_known()
    assert (host.noted, len(host.sent)) == (1, 1)
    host.sent[0].add(frame_reply(MARKER, {}))
    assert host.is_known()
    assert host.noted == 2
    pass_s(45.1)
    assert host.is_known()
    assert (host.noted, len(host.sent), host.dropped) == (3, 2, 0)


def test_a_host_that_refuses_one_or_does_not_reply_is_asked(pass_s: Callable[[float], None]) -> None:
    for end in (lambda host: host.sent[-1].end(whole=False), lambda _host: pass_s(10.1)):
        host = Host()
        pass_s(45.1)
        assert host.is_known()
        end(host)
        assert not host.is_known()
        before = host.noted
        host.ask()
        # What it was sent may have arrived until now.
        assert host.noted == before + 1
        assert host.is_known()
        assert len(host.sent) == 1


def test_one_that_takes_nothing_for_long_is_asked(pass_s: Callable[[float], None]) -> None:
    """One that takes it a little later is not."""
    for patient_s, expected in ((5.0, True), (11.0, False)):
        host = Host()
        host.has_room = False
        while not host.noted:
            pass_s(0.5)
            assert host.is_known()
        pass_s(patient_s)
        assert host.is_known() is expected
        assert host.sent == []
        host.has_room = True
        assert host.is_known()
        assert len(host.sent) == 1


def test_nothing_is_sent_that_cannot_be_recorded(pass_s: Callable[[float], None]) -> None:
    host = Host()

    def fail(_host: str) -> None:
        raise HostError("the disk is full", host="edge1")

    host.readings.begin_cycle((), fail)
    pass_s(46.0)
    with pytest.raises(HostError, match="full"):
        host.is_known()
    assert host.sent == []
    # It is asked, which fails as well.
    host.readings.drop("edge1")
    assert not host.is_known()


def test_a_late_cycle_takes_the_reply_first(pass_s: Callable[[float], None]) -> None:
    host = Host()
    pass_s(46.0)
    assert host.is_known()
    host.sent[0].add(frame_reply(MARKER, {}))
    host.sent[0].end(whole=False)
    pass_s(60.0)
    assert host.is_known()
    assert host.noted == 2


def test_the_heartbeats_of_a_fleet_are_in_few_cycles_and_not_all_in_one(
    pass_s: Callable[[float], None],
) -> None:
    """The manager's record is written once for those of a cycle."""
    names = [f"edge{number}" for number in range(64)]
    sent: list[str] = []
    fleet = FleetReadings[object](ReadingFeeds(), every=1.0)
    fleet.begin_cycle((), sent.append)
    for name in names:
        fleet.ask_anew(name, REQUEST)
        feed = ReadingFeed(marker=MARKER, limit=1000)
        feed.add(frame_reply(MARKER, {"v": 1}))
        feed.send_heartbeat = lambda: ReadingFeed(marker=MARKER, limit=1000)
        fleet._feeds.put(name, feed)
    counts = []
    for _ in range(46):
        pass_s(1.0)
        before = len(sent)
        assert all(fleet.find(name, REQUEST) is not None for name in names if name not in sent)
        counts.append(len(sent) - before)
    assert sorted(sent) == sorted(names)
    assert sum(count > 0 for count in counts) <= 4
    assert max(counts) <= 32
