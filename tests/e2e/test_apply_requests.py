# SPDX-License-Identifier: Apache-2.0
"""The requests of an apply over warm connections, by count: those to one host share one agent and travel together."""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.agent.link import frames
from edgectl.model.check import Check
from edgectl.model.inventory import Connection, Host, Inventory
from edgectl.model.plan import Action
from edgectl.model.progress import ProgressEvent, ProgressStage
from edgectl.model.result import Phase
from edgectl.model.task import Task
from edgectl.transport import conversation
from edgectl.transport.base import OpenExchange, Reply, Session
from edgectl.transport.fake import unpack_request
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from tests.builders import a_task, an_inventory
from tests.e2e.bench import EAGER, GENTLE, QUICK, Bench, a_local, a_slice, open_bench
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.relay import Relay
from tests.pace import patience
from tests.sshd import Lab, running_lab

HOSTS = ("edge3", "edge2", "edge1")
COUNT = 10


class RecordingTransport:
    """Real sessions; ``said``: (host, way, operation) of all that was sent, in its order."""

    def __init__(self) -> None:
        self.said: list[tuple[str, str, str]] = []
        self._within = FleetTransport()

    def connect(self, host: Host, *, timeout: float) -> Session:
        session = self._within.connect(host, timeout=timeout)
        run, converse = session.run, session.converse  # type: ignore[attr-defined]
        self.said.append((host.name, "login", ""))

        def run_noted(command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
            self.said.append((host.name, "call", str(unpack_request(stdin)[1]["op"])))
            return run(command, stdin, timeout=timeout, limit=limit)

        def converse_noted(
            command: str, stdin: bytes, *, timeout: float, give_way: Callable[[], None]
        ) -> OpenExchange:
            self.said.append((host.name, "call", str(unpack_request(stdin)[1]["op"])))
            exchange = converse(command, stdin, timeout=timeout, give_way=give_way)
            write, reader = exchange.write, frames.FrameReader(frames.MANAGER_WORDS)

            def write_noted(data: bytes, *, timeout: float) -> None:
                for word, _, body in reader.feed(data):
                    if word == frames.ASK:
                        self.said.append((host.name, "frame", body.split(b"\n")[0].split()[6].decode()))
                write(data, timeout=timeout)

            exchange.write = write_noted
            return exchange  # type: ignore[no-any-return]

        session.run = run_noted  # type: ignore[method-assign]
        session.converse = converse_noted  # type: ignore[attr-defined]
        return session

    def address(self, host: Host) -> str:
        return self._within.address(host)

    def count(self, host: str) -> Counter[tuple[str, str]]:
        return Counter((way, operation) for name, way, operation in self.said if name == host)


def build_tasks(folder: Path) -> list[Task]:
    """Programs that are ready at once, on the hosts in turns."""
    return [
        a_task(
            f"task{number:02}",
            command="echo up; exec sleep 600",
            ready=Check(command="true", timeout=patience(20.0)),
            pin=HOSTS[number % len(HOSTS)],
            stop=GENTLE,
        )
        for number in range(COUNT, 0, -1)
    ]


@contextmanager
def recorded_bench(
    inventory: Inventory, folder: Path, hosts: Path | Lab
) -> Iterator[tuple[Bench, RecordingTransport]]:
    """A manager whose hosts have the compiled code of every operation of an apply."""
    recording = RecordingTransport()
    with open_bench(inventory, folder / "manager", hosts) as bench:
        found = Bench(replace(bench.fleet, transport=recording), bench.said).using(*build_tasks(folder))
        for _ in range(2):
            found.apply()
            found.stop()
        recording.said.clear()
        yield found, recording


@pytest.mark.parametrize("connection", [Connection.SSH, Connection.LOCAL])
def test_ten_starts_on_three_hosts(lab: Lab, tmp_path: Path, connection: Connection) -> None:
    lab_hosts = ("edge2", "edge1", "robot1")
    edges = [
        a_slice(replace(lab.host(at), name=name))
        if connection is Connection.SSH
        else a_local(lab.host(name), f"127.0.1.{n}")
        for n, (name, at) in enumerate(zip(HOSTS, lab_hosts, strict=True))
    ]
    where: Lab | Path = lab if connection is Connection.SSH else tmp_path
    with recorded_bench(an_inventory(*edges), tmp_path, where) as (bench, recording):
        assert bench.apply().plan.summary == {Action.START: COUNT}
        for number, host in enumerate(HOSTS):
            here = len([each for each in range(COUNT, 0, -1) if each % len(HOSTS) == number])
            assert recording.count(host) == {
                ("login", ""): 1,
                ("call", "probe"): 1,
                ("call", "converse"): 1,
                # Whether it is there, for all of its tasks; and after the run, whether anything runs twice.
                ("frame", "status"): 2,
                ("frame", "start"): here,
                ("frame", "wait"): here,
                ("frame", "lease"): 1,
            }
        recording.said.clear()
        bench.stop()
        for number, host in enumerate(HOSTS):
            here = len([each for each in range(COUNT, 0, -1) if each % len(HOSTS) == number])
            assert recording.count(host)["frame", "stop"] == here
            assert recording.count(host)["call", "stop"] == 0


def test_ten_starts_on_hosts_with_room_for_one_channel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The agent that stays has the channel and carries all; nothing is refused, however long tasks take to be ready."""
    with running_lab(tmp_path / "lab", ("edge2", "edge1", "edge3"), extra=["MaxSessions 1"]) as lab:
        monkeypatch.setenv("EDGECTL_SSH_CONFIG", str(lab.ssh_config))
        edges = [a_slice(lab.host(name)) for name in HOSTS]
        with recorded_bench(an_inventory(*edges), tmp_path, lab) as (bench, recording):
            slow = bench.using(*(replace(task, ready=None, up=2.0) for task in build_tasks(tmp_path)))
            assert slow.apply().plan.summary == {Action.START: COUNT}
            for host in HOSTS:
                assert recording.count(host)["call", "start"] == recording.count(host)["call", "wait"] == 0
            slow.stop()


# There and back: more than what all else takes differs from run to run. An agent that stays ends after 1.8 s of silence,
# as it hears when the delay begins.
ROUND_TRIP_S = min(patience(0.9), 1.6)


def test_ten_starts_cross_a_far_line_six_times(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the plan to the last ready: three times until the agent stays, and once each to look, to start and to wait.

    Were only two of the four requests to one host sent one after the other, it were seven.
    """
    monkeypatch.setattr(conversation, "PATIENCE_S", patience(30.0))
    with ExitStack() as stack:
        edges = []
        for name, at in zip(HOSTS, ("edge2", "edge1", "robot1"), strict=True):
            server = lab[at]
            relay = Relay((server.address, server.port))
            relay.start()
            stack.callback(relay.stop)
            lab.known_hosts.write_text(
                lab.known_hosts.read_text() + f"[{relay.address}]:{relay.port} {server.key}\n"
            )
            edges.append((relay, a_slice(lab.host(name, host=relay.address, port=relay.port))))
        stack.callback(lab.write_files)
        bench, _ = stack.enter_context(
            recorded_bench(an_inventory(*(edge for _, edge in edges)), tmp_path, lab)
        )
        for _ in range(3):
            took = [
                time_apply_s(bench, [relay for relay, _ in edges], delay_s)
                for delay_s in (0.0, ROUND_TRIP_S / 2)
            ]
            # A stall of the machine may end an agent, and all is asked by calls.
            if (crossed := round((took[1] - took[0]) / ROUND_TRIP_S)) == 6:
                break
    assert crossed == 6


def time_apply_s(bench: Bench, relays: Sequence[Relay], delay_s: float) -> float:
    """Time from the plan to the last ready, where from the plan on lines delay each way; all is stopped after it."""
    moments: list[float] = []

    def confirm(_plan: object) -> bool:
        for relay in relays:
            relay.set(LinkFault(kind=LinkFaultKind.DELAY, seconds=delay_s))
        moments.append(time.monotonic())
        return True

    def note(event: ProgressEvent) -> None:
        if event.stage is ProgressStage.PHASE_END and event.phase is Phase.READY:
            moments.append(time.monotonic())

    applied = plan_and_apply(
        bench.fleet, EAGER, confirm, ApplyOptions(probe=QUICK, progress=note, call_s=patience(20.0))
    )
    for relay in relays:
        relay.heal()
    bench.stop()
    assert applied.results is not None
    assert applied.results.done, [action.error for action in applied.results.actions]
    assert len(moments) == 1 + COUNT
    return moments[-1] - moments[0]


def test_an_apply_that_changes_nothing_begins_no_conversation(lab: Lab, tmp_path: Path) -> None:
    edges = [a_slice(replace(lab.host(at), name=name)) for name, at in zip(HOSTS, lab.servers, strict=False)]
    with recorded_bench(an_inventory(*edges), tmp_path, lab) as (bench, recording):
        bench.apply()
        recording.said.clear()
        assert bench.apply().results is None
        for host in HOSTS:
            assert recording.count(host) == {("login", ""): 1, ("call", "probe"): 1, ("call", "lease"): 1}
