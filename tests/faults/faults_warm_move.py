# SPDX-License-Identifier: Apache-2.0
"""Faults at every step of a warm move, with and without state and hold: the manager killed, or held at the step while
a host, a link, a supervisor or a disk fails.
"""

import signal
import time
from collections.abc import Callable

from tests.faults import failpoint_runner, scan
from tests.faults.command_result import ExpectationError
from tests.faults.faults_failpoints import (
    Change,
    choose_failpoints,
    count_failpoints,
    kill_at_every_failpoint,
)
from tests.faults.fleet import FaultFleet
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.registry import OWN, fault
from tests.faults.standby_fleet import (
    HOLD,
    STATE,
    change_places,
    check_memory,
    check_released,
    find_active,
    find_copy,
    leave_host,
    repair_and_check,
    start_standby_task,
)
from tests.pace import patience

Strike = Callable[[FaultFleet, str, str], None]
"""Breaks something on the host of the active instance, on that of the copy, or between."""
# Of the points of a move; a broken link or a dead host costs up to a minute.
SAMPLED = 8


def kill_in_every_kind(fleet: FaultFleet, turn: Change) -> None:
    """Kill at every point; whoever is active afterwards knows what the task knew, and nobody is on hold."""

    def checked(fleet: FaultFleet, number: int) -> tuple[str, ...]:
        if "state" in fleet.tasks["slam"]:
            check_memory(fleet)
        check_released(fleet)
        return turn(fleet, number)

    kill_at_every_failpoint(fleet, checked, kinds=1)
    checked(fleet, 0)


@fault("standby: manager killed at every point of a warm move", quick=True)
def kill_warm_move(fleet: FaultFleet) -> None:
    start_standby_task(fleet)
    kill_in_every_kind(fleet, leave_host)


@fault("standby: manager killed at every point of a warm move, the old instance stays as the copy")
def kill_change_of_places(fleet: FaultFleet) -> None:
    start_standby_task(fleet)
    kill_in_every_kind(fleet, change_places)


@fault("standby: manager killed at every point of a warm move with state and hold", quick=True)
def kill_with_state(fleet: FaultFleet) -> None:
    start_standby_task(fleet, state=STATE, handoff=HOLD)
    kill_in_every_kind(fleet, leave_host)


@fault("standby: manager killed at every point of a warm move with state, the old instance stays as the copy")
def kill_change_with_state(fleet: FaultFleet) -> None:
    start_standby_task(fleet, state=STATE, handoff=HOLD)
    kill_in_every_kind(fleet, change_places)


@fault("standby: manager killed at every point of a warm move whose state is saved before")
def kill_with_early_state(fleet: FaultFleet) -> None:
    start_standby_task(fleet, state={**STATE, "save_when": "active"}, handoff=HOLD)
    kill_at_every_failpoint(fleet, leave_host, kinds=1)


def strike_at_points(fleet: FaultFleet, strike: Strike, turn: Change = change_places) -> None:
    """Hold the manager at a point, break something, let it go on, repair, and judge; at each point of a sample."""
    count = count_failpoints(fleet, turn, 0)
    names = failpoint_runner.read_failpoints(fleet.failpoint_log)
    # From the first to the last request of the move; before and after them nothing is under way on the hosts.
    around = range(names.index("status sent"), names.index("commit fsynced"))
    points = [point for point in choose_failpoints(fleet, count) if point in around] or list(around)
    for number, point in enumerate(sorted(fleet.random.sample(points, min(SAMPLED, len(points)))), start=1):
        words = turn(fleet, number)
        old, new = find_active(fleet), find_copy(fleet)
        strike_at_point(fleet, words, point, lambda old=old, new=new: strike(fleet, old, new))  # type: ignore[misc]
        repair_and_check(fleet)


def strike_at_point(fleet: FaultFleet, words: tuple[str, ...], at: int, strike: Callable[[], None]) -> None:
    """Run edgectl, which waits at its ``at``-th point until ``strike`` is over."""
    fleet.failpoint_log.unlink(missing_ok=True)
    fleet.kill_at, fleet.kill_with = at, signal.SIGSTOP
    running = fleet.start_edgectl(*words)
    fleet.kill_at, fleet.kill_with = None, signal.SIGKILL
    deadline = time.monotonic() + patience(60.0)
    while (seen := scan.read_process(running.pid)) is not None and seen.state not in "TZX":
        if time.monotonic() > deadline:
            raise ExpectationError(f"neither ended nor at point {at}")
        time.sleep(0.005)
    if seen is not None and seen.state == "T":
        fleet.injected += 1
        strike()
        running.send_signal(signal.SIGCONT)
    fleet.wait_for_edgectl(running, words).expect_exit(0, 1, 4)
    assert failpoint_runner.read_failpoints(fleet.failpoint_log), "no point was hit"


def start_with_all(fleet: FaultFleet) -> None:
    """With state and hold for half of the seeds."""
    more = {"state": STATE, "handoff": HOLD} if fleet.random.random() < 0.5 else {}
    start_standby_task(fleet, **more)


@fault("standby: link cut in both directions at a point of a warm move", full=2)
def cut_link(fleet: FaultFleet) -> None:
    start_with_all(fleet)

    def strike(fleet: FaultFleet, old: str, new: str) -> None:
        kind = fleet.random.choice([LinkFaultKind.BLACK_HOLE, LinkFaultKind.CUT_RST])
        relays[fleet.random.choice([old, new])].set(LinkFault(kind=kind, lasting=True))

    relays = {name: fleet.get_relay(name) for name in fleet.edges}
    strike_at_points(fleet, strike)


@fault("standby: link cut in one direction at a point of a warm move", full=2)
def cut_link_one_way(fleet: FaultFleet) -> None:
    start_with_all(fleet)

    def strike(fleet: FaultFleet, old: str, new: str) -> None:
        kind = fleet.random.choice([LinkFaultKind.ANSWERS_LOST, LinkFaultKind.REQUESTS_LOST])
        relays[fleet.random.choice([old, new])].set(LinkFault(kind=kind))

    relays = {name: fleet.get_relay(name) for name in fleet.edges}
    strike_at_points(fleet, strike)


@fault("standby: power of a host cut at a point of a warm move", kinds=OWN, full=3)
def cut_power(fleet: FaultFleet) -> None:
    start_with_all(fleet)
    strike_at_points(fleet, lambda fleet, old, new: fleet.hosts[fleet.random.choice([old, new])].power_off())


@fault("standby: either supervisor killed at a point of a warm move", full=2)
def kill_supervisor(fleet: FaultFleet) -> None:
    start_with_all(fleet)
    strike_at_points(
        fleet, lambda fleet, old, new: kill_supervisor_on(fleet, fleet.random.choice([old, new]))
    )


def kill_supervisor_on(fleet: FaultFleet, name: str) -> None:
    """Kill every process on the host that is edgectl's and no session of it; what the task is lives on."""
    scan.kill_processes(fleet.list_supervisors(name))


@fault("standby: disk full on either host at a point of a warm move", kinds=OWN, full=3)
def fill_disk(fleet: FaultFleet) -> None:
    start_with_all(fleet)
    strike_at_points(
        fleet, lambda fleet, old, new: fleet.get_computer(fleet.random.choice([old, new])).fill_disk()
    )
