# SPDX-License-Identifier: Apache-2.0
"""What requests cost on the line to a real host, by count: ways there and back, and bytes."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.model.inventory import Host
from edgectl.transport import conversation
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.relay import Relay
from tests.pace import patience
from tests.sshd import Lab, running_lab
from tests.transport.test_conversation import Fleet, begin_early, until

# There and back: so much that all else is a small part of it, and so little that calls of three follow each other
# closely enough for a conversation (`KEEP_S`).
ROUND_TRIP_S = min(patience(0.8), 1.5)


class FarHost:
    """A host behind a relay, and its fleet of one."""

    def __init__(self, lab: Lab, name: str) -> None:
        server = lab[name]
        self.lab, self.relay = lab, Relay((server.address, server.port))
        self.relay.start()
        lab.known_hosts.write_text(f"[{self.relay.address}]:{self.relay.port} {server.key}\n")
        self.fleet = Fleet(lab.host(name, host=self.relay.address, port=self.relay.port))

    @property
    def host(self) -> Host:
        return self.fleet.hosts[0]

    def count_bytes(self) -> int:
        """Return the bytes of both ways since the last call, once no more come."""
        seen = -1
        while seen != self.relay.passed:
            seen = self.relay.passed
            time.sleep(patience(0.1))
        # The relay counts from the fault on that was set last.
        self.relay.set(LinkFault())
        return seen

    def close(self) -> None:
        self.fleet.pool.close()
        self.relay.stop()
        self.lab.write_files()


@pytest.fixture
def far(lab: Lab) -> Iterator[FarHost]:
    found = FarHost(lab, "robot1")
    yield found
    found.close()


def test_ways_over_a_far_line(far: FarHost, monkeypatch: pytest.MonkeyPatch) -> None:
    """A call takes three ways there and back: its channel, its command, and its input with the reply, for which OpenSSH has
    no room before it has agreed to the command. An agent that stays takes one.
    """
    begin_early(monkeypatch)
    assert far.fleet.ask("status", task=None)["tasks"] == {}
    far.relay.set(LinkFault(kind=LinkFaultKind.DELAY, seconds=ROUND_TRIP_S / 2))
    ways = []
    for wanted in (False, True):
        if wanted:
            until(far.fleet.is_conversed)
        began = time.monotonic()
        assert far.fleet.is_conversed() == wanted
        ways.append(int((time.monotonic() - began) / ROUND_TRIP_S))
    assert ways == [3, 1]


def test_bytes_of_a_login_a_call_and_a_shared_request(far: FarHost, monkeypatch: pytest.MonkeyPatch) -> None:
    """A change of a kilobyte has a reason. Pulses pass beside shared requests, some 60 bytes each."""
    # Bytes are counted until no more come.
    monkeypatch.setattr(conversation, "KEEP_S", patience(conversation.KEEP_S))
    far.relay.set(LinkFault())
    assert far.fleet.ask("status", task=None)["tasks"] == {}
    # 11.6 kB when this was written.
    assert far.count_bytes() <= 12_600
    assert far.fleet.ask("probe", window_s=0.0)["tasks"] == {}
    # 8.9 kB, of which 7.0 are the program that loads the agent and the request.
    assert far.count_bytes() <= 9_800
    until(far.fleet.is_conversed)
    far.count_bytes()
    assert far.fleet.is_conversed()
    # 0.6 kB, and the others of that time.
    assert far.count_bytes() <= 1_200
    assert far.fleet.ask("probe", window_s=0.0)["tasks"] == {}
    # 1.6 kB.
    assert far.count_bytes() <= 2_400


def test_bytes_of_the_first_contact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running_lab(tmp_path / "lab", ["edge1"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        for kept in (lab["edge1"].home / "state" / "edgectl" / "agent").rglob("*"):
            if kept.is_file():
                kept.unlink()
        far = FarHost(lab, "edge1")
        try:
            far.relay.set(LinkFault())
            assert far.fleet.ask("status", task=None)["tasks"] == {}
            # 222 kB; 700 before the agent was compressed.
            assert 150_000 < far.count_bytes() <= 240_000
        finally:
            far.close()
