# SPDX-License-Identifier: Apache-2.0
"""Faults of links: black holes, cuts, garbled bytes and delays at any byte of the exchange."""

import time

from tests.faults.command_result import ExpectationError
from tests.faults.faults_host import check_held, start_tasks
from tests.faults.fleet import FaultFleet
from tests.faults.hosts import Host
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.registry import OWN, fault
from tests.faults.scan import Process, read_process
from tests.pace import patience

EXCHANGE = 40_000
"""Bytes of one host's part in an apply with a move, about; the agent's file included."""


def prepare_changes(fleet: FaultFleet) -> None:
    """Prepare changes on three hosts: slam moves from the first to the second, nav from there to the third, and
    map starts on the first.
    """
    start_tasks(fleet)
    fleet.pin_task("slam", fleet.second)
    fleet.pin_task("nav", fleet.third)
    fleet.add_task("map", on=fleet.first)


def apply_with_link_fault(fleet: FaultFleet, kind: LinkFaultKind, *, lasting: bool) -> None:
    """Apply with a link fault after a random byte."""
    prepare_changes(fleet)
    relay = fleet.get_relay(fleet.random.choice(fleet.edges[:3]))
    # Half of the bytes are drawn from the logins, where most of the protocol's steps are.
    after = fleet.random.randrange(fleet.random.choice([6_000, EXCHANGE]))
    relay.set(LinkFault(kind=kind, after=after, lasting=lasting))
    fleet.apply().expect_exit(0, 1, 4, within=100)


@fault("SSH black-holed", full=4)
def drop_ssh_bytes(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    after = fleet.random.choice([0, 30, 1_000, 2_500, 4_000])
    fleet.get_relay(fleet.first).set(LinkFault(kind=LinkFaultKind.BLACK_HOLE, after=after))
    check_held(fleet, fleet.first, within=60)
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})


@fault("connections left half open", full=2)
def leave_half_open(fleet: FaultFleet) -> None:
    """The link dies after the command and before its input. Repaired or not: nothing waits on the host
    forever.
    """
    start_tasks(fleet)
    relay = fleet.get_relay(fleet.first)
    relay.set(LinkFault())
    fleet.run_edgectl("probe").expect_exit(0)
    whole = relay.passed
    for share in fleet.random.sample([0.35, 0.45, 0.55, 0.65], 4):
        relay.set(LinkFault(kind=LinkFaultKind.BLACK_HOLE, after=int(whole * share), half_open=True))
        fleet.run_edgectl("probe").expect_exit(4, within=60)
        relay.heal()
        if list_waiting_processes(fleet.hosts[fleet.first]):
            break
    deadline = time.monotonic() + patience(45)
    while left := list_waiting_processes(fleet.hosts[fleet.first]):
        if time.monotonic() > deadline:
            raise ExpectationError(f"still waits on the host: {left}")
        fleet.wait(0.5)


def list_waiting_processes(host: Host) -> list[Process]:
    """List the processes that sshd still runs for us there; supervisors have the same command line and
    another parent.
    """
    ours = [each for each in host.processes() if "readline" in each.command]
    return [each for each in ours if (parent := read_process(each.parent)) and "sshd" in parent.command]


@fault("host accepts and never answers", full=2)
def mute_host(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.get_relay(fleet.first).set(LinkFault(kind=LinkFaultKind.MUTE))
    check_held(fleet, fleet.first, within=25)


@fault("packets dropped, cable plugged in", kinds=OWN, full=2)
def drop_packets(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.get_computer(fleet.first).drop_packets()
    check_held(fleet, fleet.first, within=25)
    fleet.check_verdict({**fleet.expected, "slam": fleet.first})


@fault("cable unplugged in the middle of an apply", kinds=OWN, full=8)
def unplug_during_apply(fleet: FaultFleet) -> None:
    prepare_changes(fleet)
    computer = fleet.get_computer(fleet.random.choice(fleet.edges[:3]))
    running = fleet.start_edgectl("apply", "--yes")
    fleet.wait(fleet.random.uniform(0.3, 2.5))
    computer.unplug_cable()
    fleet.wait_for_edgectl(running).expect_exit(0, 4, within=100)


@fault("link cut in the middle of an apply (FIN)", full=12)
def cut_link_with_fin(fleet: FaultFleet) -> None:
    apply_with_link_fault(fleet, LinkFaultKind.CUT_FIN, lasting=fleet.random.random() < 0.5)


@fault("link cut in the middle of an apply (RST)", full=12)
def cut_link_with_rst(fleet: FaultFleet) -> None:
    apply_with_link_fault(fleet, LinkFaultKind.CUT_RST, lasting=fleet.random.random() < 0.5)


@fault("link black-holed in the middle of an apply", full=8)
def black_hole_during_apply(fleet: FaultFleet) -> None:
    apply_with_link_fault(fleet, LinkFaultKind.BLACK_HOLE, lasting=False)


@fault("a byte garbled in the middle of an apply", full=6)
def garble_byte(fleet: FaultFleet) -> None:
    apply_with_link_fault(fleet, LinkFaultKind.GARBLE, lasting=False)


@fault("a slow link, 150 ms each way", full=2)
def delay_link(fleet: FaultFleet) -> None:
    prepare_changes(fleet)
    for name in fleet.hosts:
        fleet.get_relay(name).set(LinkFault(kind=LinkFaultKind.DELAY, seconds=0.15))
    fleet.apply().expect_exit(0, within=60)
    fleet.check_verdict()
