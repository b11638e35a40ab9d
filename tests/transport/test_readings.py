# SPDX-License-Identifier: Apache-2.0
"""Readings that hosts send by themselves: feeds, and watches of real hosts that need no requests."""

import os
import signal
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import pytest

from edgectl.agent.supervise import records
from edgectl.gateway import readings as fleet_readings
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.cycle import Cycle
from edgectl.model.inventory import Capacity, Connection, Host
from edgectl.model.snapshot import Snapshot
from edgectl.state.heartbeats import load_heartbeats
from edgectl.transport import readings
from edgectl.transport.base import listen_to_calls
from edgectl.transport.fake import frame_reply
from edgectl.transport.readings import ReadingFeed
from edgectl.usecases import fleet as usecases
from edgectl.usecases.watch import WatchOptions, watch_fleet
from tests.agent.conftest import a_spec, is_running
from tests.builders import an_inventory, some_tasks
from tests.pace import patience
from tests.relay import Relay, RelayFault
from tests.sshd import Lab, running_lab
from tests.transport.test_conversation import (
    ANSWERS_S,
    FORBIDDING,
    CountingTransport,
    Fleet,
    begin_early,
    list_agents,
    list_threads,
    until,
)

MARKER = "ab" * 16
WHOLE = {"v": 1, "op": "probe", "cpu": {"used_cores": 1.0}, "resident": True}


def frame(document: Any) -> bytes:
    return frame_reply(MARKER, document)


def a_feed(*documents: Any, limit: int = 10_000) -> ReadingFeed:
    feed = ReadingFeed(marker=MARKER, limit=limit)
    for document in documents:
        feed.add(frame(document))
    return feed


def test_a_feed_merges_what_changed_and_notes_when_the_host_spoke() -> None:
    feed = a_feed(WHOLE)
    assert feed.whole
    assert feed.output == frame(WHOLE)
    first = feed.find_reading()
    assert first is not None
    assert first.document == WHOLE
    feed.add(frame({"changed": {"cpu": {"used_cores": 2.0}}, "gone": ["resident"]}))
    second = feed.find_reading()
    assert second is not None
    assert second.document == {"v": 1, "op": "probe", "cpu": {"used_cores": 2.0}}
    feed.add(frame({}))
    third = feed.find_reading()
    assert third is not None
    assert third.document is second.document
    assert third.came_at == second.came_at
    assert third.said_at > second.said_at > first.said_at


def test_a_feed_keeps_the_entries_of_which_nothing_was_said() -> None:
    links = {"robot2": {"rtt_ms": 1.0}, "robot1": {"rtt_ms": 1.0}}
    feed = a_feed(WHOLE | {"links": links})
    first = feed.find_reading()
    feed.add(frame({"changed": {}, "entries": {"links": {"robot1": {"rtt_ms": 9.0}}}, "gone": []}))
    second = feed.find_reading()
    assert first is not None
    assert second is not None
    before, after = (cast("dict[str, Any]", each.document["links"]) for each in (first, second))
    assert after == {"robot2": {"rtt_ms": 1.0}, "robot1": {"rtt_ms": 9.0}} != before == links
    assert after["robot2"] is before["robot2"]


def test_a_reading_is_taken_up_when_it_is_looked_for_and_is_as_old_as_it_is() -> None:
    feed, waiting = a_feed(WHOLE), [(frame({}), time.monotonic() - 1.0)]
    first = feed.reading

    def take_up() -> None:
        for each in waiting:
            feed.add(*each)

    feed.take_up = take_up
    found = feed.find_reading()
    assert first is not None
    assert found is not None
    assert (found.document, found.came_at, found.said_at) == (first.document, first.came_at, waiting[0][1])
    waiting[:] = [(frame({"changed": {"v": 3}, "gone": []}), time.monotonic() - readings.SILENT_S - 1.0)]
    assert feed.find_reading() is None
    assert feed.silent_s > readings.SILENT_S


def test_a_reply_may_come_in_pieces() -> None:
    feed = a_feed()
    for byte in frame(WHOLE) + frame({"changed": {"v": 2}, "gone": []}):
        feed.add(bytes([byte]))
    found = feed.find_reading()
    assert found is not None
    assert found.document["v"] == 2


@pytest.mark.parametrize(
    "wrong",
    [
        [],
        {"changed": []},
        {"changed": {}, "gone": "v"},
        {"changed": {}, "entries": [], "gone": []},
        {"changed": {}, "entries": {"cpu": []}, "gone": []},
        {"changed": {}, "entries": {"links": {"robot1": {}}}, "gone": []},
        {"changed": {}, "entries": {"resident": {"robot1": {}}}, "gone": []},
        {"error": {"kind": "agent-error", "message": "a bug", "hint": ""}},
        {"changed": {"v": "x" * 20_000}, "gone": []},
    ],
)
def test_a_wrong_reply_ends_a_feed_and_not_what_was_said_before(wrong: object) -> None:
    feed = a_feed(WHOLE, wrong)
    assert feed.is_over
    assert feed.whole
    assert feed.find_reading() is None
    feed.add(frame({"changed": {"v": 3}, "gone": []}))
    assert feed.find_reading() is None


def test_a_host_that_says_nothing_any_more_is_to_be_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    feed = a_feed(WHOLE)
    assert feed.find_reading() is not None
    monkeypatch.setattr(readings, "SILENT_S", -1.0)
    assert feed.find_reading() is None
    assert not feed.is_over


@contextmanager
def watching(
    tmp_path: Path, *hosts: Host, apply: bool = False, timeout: float = ANSWERS_S
) -> Iterator["Watch"]:
    watch = Watch(tmp_path, *hosts, apply=apply, timeout=timeout)
    with (
        listen_to_calls(lambda event: watch.asked.append((event.host, event.operation))),
        closing(watch.cycles),
    ):
        yield watch


class Watch:
    """A watch of real hosts; ``asked``: the requests of the last cycle."""

    def __init__(self, tmp_path: Path, *hosts: Host, apply: bool, timeout: float) -> None:
        self.transport, self.state = CountingTransport(), tmp_path / "manager"
        self.state.mkdir()
        site = usecases.Fleet(
            inventory=an_inventory(*hosts, probe_links=False),
            tasks=some_tasks(),
            transport=self.transport,
            state=self.state,
        )
        options = WatchOptions(every=0.3, apply=apply, probe=ProbeOptions(window=0.05, timeout=timeout))
        self.cycles: Generator[Cycle, None, None] = watch_fleet(site, options)
        self.asked: list[tuple[str, str]] = []

    def cycle(self) -> Snapshot:
        del self.asked[:]
        cycle = next(self.cycles)
        assert not cycle.error, cycle.error
        assert cycle.snapshot is not None
        return cycle.snapshot

    def until(self, found: Callable[[Snapshot], object]) -> Snapshot:
        deadline = time.monotonic() + ANSWERS_S
        while not found(snapshot := self.cycle()):
            assert time.monotonic() < deadline, snapshot
        return snapshot

    def until_quiet(self) -> Snapshot:
        """The snapshot of a cycle for which no host was asked."""
        return self.until(lambda found: not self.asked and all(host.ok for host in found.hosts.values()))


@pytest.fixture(params=[Connection.SSH, Connection.OPENSSH])
def hosts(request: pytest.FixtureRequest, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> list[Host]:
    begin_early(monkeypatch)
    return [a_slice(lab, name, connection=request.param) for name in sorted(lab.servers, reverse=True)[:3]]


def a_slice(lab: Lab, name: str, **changes: object) -> Host:
    """A host that shares its machine with others."""
    return lab.host(name, fleet="lab", capacity=Capacity(cpu=2.0, memory=4e9), **changes)


def test_a_cycle_needs_no_request_and_sees_what_changes(hosts: list[Host], lab: Lab, tmp_path: Path) -> None:
    other = Fleet(*hosts)
    with other.pool, watching(tmp_path, *hosts) as watch:
        snapshot = watch.until_quiet()
        assert list(snapshot.hosts) == sorted(host.name for host in hosts)
        other.ask(
            "start",
            task="slam",
            instance="i1",
            generation=1,
            spec=a_spec("exec sleep 600", runtime="process"),
        )
        name = hosts[0].name
        seen = watch.until(lambda found: "slam" in found.hosts[name].tasks)
        assert not any("slam" in host.tasks for host in seen.hosts.values() if host is not seen.hosts[name])
        started = seen.hosts[name].tasks["slam"].started_at
        for _ in range(4):
            found = watch.cycle()
            assert all(0.0 <= host.sample_age_s <= ANSWERS_S for host in found.hosts.values())
            # An age on a host, which is seen later than it was measured.
            assert abs(found.hosts[name].tasks["slam"].started_at - started) < 2.0
        other.stop()
        watch.until(
            lambda found: (
                "slam" not in found.hosts[name].tasks or not found.hosts[name].tasks["slam"].state.alive
            )
        )
    until(lambda: not any(list_agents(lab[host.name].directory) for host in hosts))
    until(lambda: not list_threads())


def test_a_host_has_heartbeats_for_which_no_cycle_waits(
    hosts: list[Host], lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manager's record of them catches up with that of the host, by which tasks stop themselves."""
    monkeypatch.setattr(fleet_readings, "_HEARTBEATS_EACH_S", (1.0,))
    name, other = hosts[0].name, Fleet(*hosts)
    with other.pool, watching(tmp_path, *hosts) as watch:
        other.start()
        watch.until_quiet()
        (file,) = lab[name].directory.rglob("contact")
        for _ in range(3):
            before = read_at(file)
            watch.until(lambda _, before=before: read_at(file) > before)  # type: ignore[misc]
            assert {operation for _, operation in watch.asked} <= {"heartbeat"}, watch.asked
            later = read_at(file)
            # It was recorded before it was sent, and is again once it has been replied to.
            assert before < load_heartbeats(watch.state).last[name].seconds
            watch.until(lambda _, at=later: load_heartbeats(watch.state).last[name].seconds >= at)  # type: ignore[misc]
        other.stop()
    until(lambda: not list_threads())


def read_at(file: Path) -> float:
    """When a host had its last heartbeat, in seconds since boot."""
    return float(records.read_record(str(file))["at"])


@pytest.mark.parametrize("hosts", [Connection.SSH], indirect=True)
def test_a_host_that_refuses_heartbeats_is_asked(
    hosts: list[Host], lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An agent that stays refuses all requests once its file is gone; a call brings a new one."""
    monkeypatch.setattr(fleet_readings, "_HEARTBEATS_EACH_S", (1.0,))
    name = hosts[0].name
    with watching(tmp_path, *hosts) as watch:
        watch.until_quiet()
        (file,) = lab[name].directory.rglob("*.pyz")
        file.unlink()
        watch.until(lambda found: (name, "readings") in watch.asked and found.hosts[name].ok)
        assert file.exists()


def test_a_host_that_is_gone_is_noticed_and_costs_the_others_nothing(
    hosts: list[Host], lab: Lab, tmp_path: Path
) -> None:
    gone, *others = [host.name for host in hosts]
    with watching(tmp_path, *hosts) as watch:
        watch.until_quiet()
        lab[gone].stop()
        seen = watch.until(lambda found: not found.hosts[gone].ok)
        assert all(seen.hosts[name].ok for name in others)
        lab[gone].restart()


@pytest.mark.parametrize("hosts", [Connection.SSH], indirect=True)
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_an_agent_that_is_killed_or_frozen_costs_a_request(
    fault: signal.Signals, hosts: list[Host], lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readings, "SILENT_S", 3.0)
    name, frozen = hosts[0].name, list[int]()
    # What a frozen agent costs once: its host is asked over it until the time is over.
    with watching(tmp_path, *hosts, timeout=8.0) as watch:
        watch.until_quiet()
        try:
            for agent in list_agents(lab[name].directory):
                os.kill(agent, fault)
                frozen += [agent] if fault is signal.SIGSTOP else []
            watch.until(lambda found: (name, "readings") in watch.asked and found.hosts[name].ok)
        finally:
            for agent in frozen:
                with suppress(ProcessLookupError):
                    os.kill(agent, signal.SIGKILL)
        assert {host for host, _ in watch.asked} <= {host.name for host in hosts}


def test_a_line_that_falls_silent_is_noticed_in_the_time_of_a_probe(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_early(monkeypatch)
    monkeypatch.setattr(readings, "SILENT_S", 3.0)
    server = lab["edge1"]
    relay = Relay((server.address, server.port), RelayFault.SILENCE, 1 << 40)
    lab.known_hosts.write_text(f"[127.0.0.1]:{relay.port} {server.key}\n")
    host = a_slice(lab, "edge1", host="127.0.0.1", port=relay.port)
    timeout = 8.0
    try:
        with watching(tmp_path, host, timeout=timeout) as watch:
            watch.until_quiet()
            (agent, *_) = list_agents(server.directory)
            began = time.monotonic()
            relay._left = 0
            watch.until(lambda found: not found.hosts["edge1"].ok)
            # Once the host owes a word, it has the rest of the time of a probe.
            assert time.monotonic() - began < timeout + patience(3.0)
            until(lambda: not is_running(agent))
    finally:
        relay.close()


@pytest.mark.parametrize(
    "extra", ["MaxSessions 1", FORBIDDING, "ForceCommand sh -c 'eval \"$SSH_ORIGINAL_COMMAND\"'"]
)
def test_a_host_that_allows_no_agent_beside_other_calls_is_asked_as_before(
    extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_early(monkeypatch)
    with running_lab(tmp_path / "lab", ["edge1"], extra=[extra]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        with watching(tmp_path, a_slice(lab, "edge1")) as watch:
            for _ in range(8):
                assert watch.cycle().hosts["edge1"].ok


def test_a_watch_that_applies_asks_each_host_in_each_cycle(hosts: list[Host], tmp_path: Path) -> None:
    with watching(tmp_path, *hosts, apply=True) as watch:
        for _ in range(6):
            assert all(host.ok for host in watch.cycle().hosts.values())
            assert {(host.name, "probe") for host in hosts} <= set(watch.asked)
