# SPDX-License-Identifier: Apache-2.0
"""Faults of an etcd of three members, and of three managers of which none sees all hosts.

New tasks, which run nowhere, come in every round, and every manager wants them on hosts that it sees.
"""

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from subprocess import Popen
from typing import TypeAlias

from tests.etcd import EtcdCluster, EtcdServer, running_etcd
from tests.faults.faults_etcd import NEW_TASKS, PAST_THE_LEASE_S, PATIENT
from tests.faults.faults_manager import DAY, build_skewed_env, find_missing_compiler
from tests.faults.faults_two_managers import check_nothing_doubled
from tests.faults.fleet import FaultFleet
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.manager import Manager, signal_manager
from tests.faults.registry import fault
from tests.faults.relay import Relay

# A member that stands still for so long, and works for so long, again and again, is as slow as one with a bad disk.
STALL_S, WORK_S = 0.3, 0.05
ROUNDS = 4


@dataclass(frozen=True, kw_only=True)
class Site:
    """A fleet with three managers and an etcd of three members; ``relays``: the line of the other members to each;
    ``lines``: those of each manager to the members, if it has its own.
    """

    fleet: FaultFleet
    cluster: EtcdCluster
    relays: list[Relay]
    managers: list[Manager]
    lines: dict[str, list[Relay]]

    def pick(self) -> EtcdServer:
        return self.fleet.random.choice(self.cluster.servers)


Disturb: TypeAlias = Callable[[Site, "list[Popen[str]]"], AbstractContextManager[None]]


def build_address(lines: list[Relay]) -> str:
    """The address of the etcd behind these lines; empty without them."""
    return "etcd://" + ",".join(f"127.0.0.1:{each.port}" for each in lines) if lines else ""


def open_site(fleet: FaultFleet, *, relayed: bool) -> Site:
    """Every manager sees all hosts but one. ``relayed``: each has lines of its own to the members."""
    directory = fleet.directory / "etcd"
    directory.mkdir()
    relays: list[Relay] = []

    def open_relay(port: int) -> Relay:
        relay = Relay(("127.0.0.1", port))
        relay.start()
        fleet.stack.callback(relay.stop)
        return relay

    def open_line(port: int) -> int:
        relays.append(open_relay(port))
        return relays[-1].port

    cluster = fleet.stack.enter_context(running_etcd(directory, 3, relay=open_line))
    fleet.coordination = cluster.address
    fleet.write_files()
    names = ("cem", "ben", "ana")
    lines = {name: [open_relay(each.port) for each in cluster.servers if relayed] for name in names}
    managers = [Manager(fleet=fleet, name=name, coordination=build_address(lines[name])) for name in names]
    for manager, hidden in zip(managers, fleet.random.sample(fleet.edges, 3), strict=True):
        manager.hide(hidden)
    return Site(fleet=fleet, cluster=cluster, relays=relays, managers=managers, lines=lines)


def play_rounds(
    fleet: FaultFleet,
    disturb: Disturb,
    *,
    most_s: float = 4.0,
    relayed: bool = False,
    build_env: Callable[[], Mapping[str, str]] = dict,
) -> None:
    """In each round all managers apply at once, and something is broken meanwhile; then one applies alone.

    ``most_s``: for so long it is broken at most. ``relayed``: as `open_site`. ``build_env``: of the first manager that
    applies.
    """
    site = open_site(fleet, relayed=relayed)
    for _ in range(1 if fleet.sample else ROUNDS):
        for _ in range(NEW_TASKS):
            fleet.add_task(f"t{len(fleet.tasks)}")
        for manager in site.managers:
            manager.want_at_random()
        first, *others = fleet.random.sample(site.managers, 3)
        running = [first.start(*PATIENT, **build_env()), *(each.start(*PATIENT) for each in others)]
        fleet.wait(fleet.random.uniform(0.3, 2.5))
        fleet.injected += 1
        with disturb(site, running):
            fleet.wait(fleet.random.uniform(0.5, most_s))
        for each in running:
            fleet.wait_for_edgectl(each).expect_exit(0, 4, 75, -signal.SIGKILL)
        site.cluster.wait_until_healthy()
        fleet.random.choice(site.managers).run(*PATIENT).expect_exit(0, 4)
        check_nothing_doubled(fleet)


@contextmanager
def kill_members(site: Site, count: int) -> Iterator[None]:
    for server in site.fleet.random.sample(site.cluster.servers, count):
        server.kill()
    yield
    site.cluster.start()


@contextmanager
def freeze_member(site: Site) -> Iterator[None]:
    server = site.pick()
    server.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        server.send_signal(signal.SIGCONT)


@contextmanager
def slow_member(site: Site) -> Iterator[None]:
    server, over = site.pick(), threading.Event()

    def stall() -> None:
        while not over.wait(WORK_S):
            server.send_signal(signal.SIGSTOP)
            over.wait(STALL_S)
            server.send_signal(signal.SIGCONT)

    thread = threading.Thread(target=stall, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def cut_member(site: Site) -> Iterator[None]:
    """No other member reaches this one; it reaches the others."""
    relay = site.fleet.random.choice(site.relays)
    relay.set(LinkFault(kind=LinkFaultKind.BLACK_HOLE, lasting=True))
    try:
        yield
    finally:
        relay.heal()
        relay.drop()


@contextmanager
def cut_manager(site: Site) -> Iterator[None]:
    """One manager reaches no member any more, and all of its hosts."""
    lines = site.lines[site.fleet.random.choice(sorted(site.lines))]
    for relay in lines:
        relay.set(LinkFault(kind=LinkFaultKind.BLACK_HOLE, lasting=True))
    try:
        yield
    finally:
        for relay in lines:
            relay.heal()
            relay.drop()


@contextmanager
def signal_managers(
    running: "list[Popen[str]]", first: signal.Signals, last: signal.Signals
) -> Iterator[None]:
    for each in running:
        signal_manager(each, first)
    yield
    for each in running:
        signal_manager(each, last)


@fault("three managers, three etcd members: one member is killed", kinds=("loopback",), quick=True, full=4)
def kill_a_member(fleet: FaultFleet) -> None:
    play_rounds(fleet, lambda site, _: kill_members(site, 1))


@fault("three managers, three etcd members: two members are killed", kinds=("loopback",), full=4)
def kill_the_majority(fleet: FaultFleet) -> None:
    play_rounds(fleet, lambda site, _: kill_members(site, 2))


@fault("three managers, three etcd members: one member freezes", kinds=("loopback",), full=4)
def freeze_a_member(fleet: FaultFleet) -> None:
    play_rounds(fleet, lambda site, _: freeze_member(site))


@fault("three managers, three etcd members: one member is slow", kinds=("loopback",), full=4)
def slow_a_member(fleet: FaultFleet) -> None:
    play_rounds(fleet, lambda site, _: slow_member(site))


@fault("three managers, three etcd members: one member is cut off", kinds=("loopback",), full=4)
def cut_a_member(fleet: FaultFleet) -> None:
    play_rounds(fleet, lambda site, _: cut_member(site))


@fault("three managers, three etcd members: a manager is cut off", kinds=("loopback",), full=4)
def cut_off_a_manager(fleet: FaultFleet) -> None:
    play_rounds(fleet, lambda site, _: cut_manager(site), most_s=PAST_THE_LEASE_S, relayed=True)


@fault("three managers, three etcd members: a manager is killed", kinds=("loopback",), full=4)
def kill_a_manager(fleet: FaultFleet) -> None:
    play_rounds(
        fleet,
        lambda site, running: signal_managers(
            [site.fleet.random.choice(running)], signal.SIGKILL, signal.SIGKILL
        ),
    )


@fault(
    "three managers, three etcd members: two managers freeze past their leases", kinds=("loopback",), full=4
)
def freeze_managers(fleet: FaultFleet) -> None:
    play_rounds(
        fleet,
        lambda site, running: signal_managers(
            site.fleet.random.sample(running, 2), signal.SIGSTOP, signal.SIGCONT
        ),
        most_s=PAST_THE_LEASE_S,
    )


@fault(
    "three managers, three etcd members: a manager's clock is a day ahead",
    kinds=("loopback",),
    full=4,
    missing=find_missing_compiler,
)
def skew_a_manager(fleet: FaultFleet) -> None:
    play_rounds(fleet, lambda _site, _running: nullcontext(), build_env=lambda: build_skewed_env(fleet, DAY))


@fault(
    "three managers, three etcd members: a manager's clock jumps while it applies",
    kinds=("loopback",),
    full=4,
    missing=find_missing_compiler,
)
def set_a_manager_clock(fleet: FaultFleet) -> None:
    """A day ahead or back, or years; the leases count another clock."""

    def build_env() -> dict[str, str]:
        moment = time.monotonic() + fleet.random.uniform(1.0, 5.0)
        seconds = fleet.random.choice([DAY, -DAY, 3650 * DAY])
        return build_skewed_env(fleet, seconds) | {"CLOCK_SKEW_FROM": f"{moment:.0f}"}

    play_rounds(fleet, lambda _site, _running: nullcontext(), build_env=build_env)
