# SPDX-License-Identifier: Apache-2.0
"""Faults of tasks with standby copies: at most one instance is ever active, and one is in the end."""

import signal
import time

from tests.faults import oracle, scan
from tests.faults.command_result import ExpectationError
from tests.faults.faults_failpoints import APPLY_ONE, kill_at_every_failpoint
from tests.faults.faults_host import wait_random_part
from tests.faults.fleet import FaultFleet
from tests.faults.hosts import wait_for
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.registry import OWN, fault
from tests.faults.standby_fleet import GRACE_S, find_active, force_move, start_standby_task
from tests.pace import patience

SELF_FENCE_S, SLACK_S = 6.0, 10.0
FAULTS_OF_LINK = (LinkFaultKind.BLACK_HOLE, LinkFaultKind.CUT_RST, LinkFaultKind.MUTE)


@fault("standby: manager killed at every point of a start and a stop of copies")
def kill_copies(fleet: FaultFleet) -> None:
    """Odd rounds drop the copies, even ones ask for one."""
    start_standby_task(fleet)
    rule = fleet.tasks["slam"]["standby"]
    assert isinstance(rule, dict)

    def turn(fleet: FaultFleet, number: int) -> tuple[str, ...]:
        fleet.tasks["slam"]["standby"] = {**rule, "warm": {"hosts": 1 + number % 2}}
        fleet.write_files()
        return APPLY_ONE

    kill_at_every_failpoint(fleet, turn)


@fault("standby: link broken at any byte of a warm move", full=6)
def break_link(fleet: FaultFleet) -> None:
    start_standby_task(fleet)
    force_move(fleet)
    kind = fleet.random.choice(FAULTS_OF_LINK)
    relay = fleet.get_relay(fleet.random.choice(fleet.edges[:3]))
    relay.set(LinkFault(kind=kind, after=fleet.random.randrange(40_000)))
    fleet.apply().expect_exit(0, 1, 4, within=100)


@fault("standby: power of a host cut in a warm move", kinds=OWN, full=6)
def cut_power(fleet: FaultFleet) -> None:
    start_standby_task(fleet)
    force_move(fleet)
    victim = fleet.random.choice(fleet.edges[:3])
    running = fleet.start_edgectl("apply", "--yes")
    wait_random_part(fleet, 2.5)
    fleet.hosts[victim].power_off()
    fleet.wait_for_edgectl(running).expect_exit(0, 1, 4)


@fault("standby: every supervisor killed", full=3)
def kill_supervisors(fleet: FaultFleet) -> None:
    """Of the active instance, of the copy, or both; then a warm move."""
    start_standby_task(fleet)
    for name in fleet.random.choice([fleet.edges, [find_active(fleet)], fleet.edges[1:]]):
        victims = [
            each
            for each in fleet.hosts[name].processes()
            if fleet.mark not in each.command and "sshd" not in each.command
        ]
        scan.kill_processes(victims)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()
    force_move(fleet)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()


@fault("standby: disk full on either host of a warm move", kinds=OWN, full=4)
def fill_disk(fleet: FaultFleet) -> None:
    start_standby_task(fleet)
    old = force_move(fleet)
    others = [name for name in fleet.edges if name != old]
    fleet.get_computer(fleet.random.choice([old, *others])).fill_disk()
    fleet.apply().expect_exit(0, 1, 4)


@fault("standby: host of the active instance powered off under a watch", kinds=OWN, full=3)
def fail_over(fleet: FaultFleet) -> None:
    """Its copy is activated at the moment at which the instance has stopped itself: self_fence, the grace of its
    stop and 10 s for the clocks after the last contact.
    """
    rule = {"policy": "replace", "after": "1s"}
    start_standby_task(fleet, self_fence=f"{SELF_FENCE_S:g}s", on_unreachable=rule)
    watch = fleet.start_edgectl("watch", "--apply", "--every", "7s")
    fleet.wait(4.0)
    old = find_active(fleet)
    fleet.hosts[old].power_off()
    cut = time.monotonic()
    try:
        wait_for(lambda: has_active_elsewhere(fleet, old), "an activation", 60)
    finally:
        watch.send_signal(signal.SIGINT)
        fleet.wait_for_edgectl(watch)
    # The last contact may be a request that is not answered any more: a quarter of self_fence later.
    most = SELF_FENCE_S + GRACE_S + SLACK_S + SELF_FENCE_S / 4 + patience(1.5)
    if time.monotonic() - cut > most:
        raise ExpectationError(
            f"activated {time.monotonic() - cut:.1f} s after the power cut, not within {most:.1f}"
        )


def has_active_elsewhere(fleet: FaultFleet, old: str) -> bool:
    lives = oracle.watch_launches(fleet.records, seconds=0.1)
    return any(life.host != old for life in lives.get("slam", []))
