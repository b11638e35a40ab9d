"""Faults of the way to the host: black holes, cuts, garbled bytes, slowness, at any byte of the exchange."""

import time

from tests.faults.faults_host import held, pair
from tests.faults.fleet import Fleet
from tests.faults.hosts import Host
from tests.faults.outcome import ExpectationError
from tests.faults.registry import OWN, fault
from tests.faults.scan import Process, process
from tests.faults.trouble import Kind, Trouble
from tests.pace import patience

EXCHANGE = 40_000
"""Bytes of one host's part in an apply with a move, about; the agent's file included."""


def busy(fleet: Fleet) -> None:
    """A fleet with something to do for both hosts: slam moves from edge1 to edge2, map starts on edge1."""
    pair(fleet)
    fleet.pin("slam", "edge2")
    fleet.want("map", on="edge1")


def struck(fleet: Fleet, kind: Kind, *, lasting: bool) -> None:
    """Apply, while the way to one of the hosts is struck after a random byte."""
    busy(fleet)
    relay = fleet.relay(fleet.draw.choice(["edge1", "edge2"]))
    # Half of the bytes are drawn from the logins, where most of the protocol's steps are.
    after = fleet.draw.randrange(fleet.draw.choice([6_000, EXCHANGE]))
    relay.set(Trouble(kind=kind, after=after, lasting=lasting))
    fleet.apply().must(0, 1, 4, within=100)


@fault("SSH black-holed", full=4)
def black_hole(fleet: Fleet) -> None:
    pair(fleet)
    after = fleet.draw.choice([0, 30, 1_000, 2_500, 4_000])
    fleet.relay("edge1").set(Trouble(kind=Kind.BLACK_HOLE, after=after))
    held(fleet, "edge1", within=60)
    fleet.check({"slam": "edge1", "nav": "edge2"})


@fault("connections left half open, the host never told", full=2)
def half_open(fleet: Fleet) -> None:
    """The line dies after the command and before its input. Mended or not: nothing waits on the host for ever."""
    pair(fleet)
    relay = fleet.relay("edge1")
    relay.set(Trouble())
    fleet.edgectl("probe").must(0)
    whole = relay.passed
    for share in fleet.draw.sample([0.35, 0.45, 0.55, 0.65], 4):
        relay.set(Trouble(kind=Kind.BLACK_HOLE, after=int(whole * share), half_open=True))
        fleet.edgectl("probe").must(4, within=60)
        relay.heal()
        if waiting(fleet.hosts["edge1"]):
            break
    deadline = time.monotonic() + patience(45)
    while left := waiting(fleet.hosts["edge1"]):
        if time.monotonic() > deadline:
            raise ExpectationError(f"still waits on the host: {left}")
        fleet.clock(0.5)


def waiting(host: Host) -> list[Process]:
    """What sshd still runs for us there; supervisors have the same command line and another parent."""
    ours = [each for each in host.processes() if "readline" in each.command]
    return [each for each in ours if (parent := process(each.parent)) and "sshd" in parent.command]


@fault("host accepts and stays mute", full=2)
def mute(fleet: Fleet) -> None:
    pair(fleet)
    fleet.relay("edge1").set(Trouble(kind=Kind.MUTE))
    held(fleet, "edge1", within=25)


@fault("packets vanish, cable in", kinds=OWN, full=2)
def swallowed(fleet: Fleet) -> None:
    pair(fleet)
    fleet.computer("edge1").swallow()
    held(fleet, "edge1", within=25)
    fleet.check({"slam": "edge1", "nav": "edge2"})


@fault("cable out in the middle of an apply", kinds=OWN, full=8)
def cable_out(fleet: Fleet) -> None:
    busy(fleet)
    computer = fleet.computer(fleet.draw.choice(["edge1", "edge2"]))
    running = fleet.begin("apply", "--yes")
    fleet.clock(fleet.draw.uniform(0.3, 2.5))
    computer.cable_out()
    fleet.end(running).must(0, 4, within=100)


@fault("link cut in the middle of an apply (FIN)", quick=True, full=12)
def cut_fin(fleet: Fleet) -> None:
    struck(fleet, Kind.CUT_FIN, lasting=fleet.draw.random() < 0.5)


@fault("link cut in the middle of an apply (RST)", full=12)
def cut_rst(fleet: Fleet) -> None:
    struck(fleet, Kind.CUT_RST, lasting=fleet.draw.random() < 0.5)


@fault("link black-holed in the middle of an apply", full=8)
def hole_in_apply(fleet: Fleet) -> None:
    struck(fleet, Kind.BLACK_HOLE, lasting=False)


@fault("a byte garbled in the middle of an apply", full=6)
def garbled(fleet: Fleet) -> None:
    struck(fleet, Kind.GARBLE, lasting=False)


@fault("a slow link, 150 ms each way", full=2)
def slow(fleet: Fleet) -> None:
    busy(fleet)
    for name in fleet.hosts:
        fleet.relay(name).set(Trouble(kind=Kind.DELAY, seconds=0.15))
    fleet.apply().must(0, within=60)
    fleet.check()
