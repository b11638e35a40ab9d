# SPDX-License-Identifier: Apache-2.0
"""Faults of two managers of one fleet that disagree: each has a state of its own and wants every task elsewhere."""

import json
import signal
import subprocess
from collections.abc import Callable

from tests.faults import oracle, scan
from tests.faults.command_result import ExpectationError
from tests.faults.fleet import APPLY, FaultFleet
from tests.faults.manager import Manager, signal_manager
from tests.faults.registry import ALL, fault

TASKS = ("t0", "t1", "t2", "t3", "t4")
# Longer than the lease on the hosts, counted from a renewal just before the freeze.
PAST_THE_LEASE_S = 33.0


def open_managers(fleet: FaultFleet) -> tuple[Manager, Manager]:
    """Two managers of five tasks, which are not started yet."""
    for task in TASKS:
        fleet.add_task(task)
    ana, ben = Manager(fleet=fleet, name="ana"), Manager(fleet=fleet, name="ben")
    for manager in (ana, ben):
        manager.want_at_random()
    return ana, ben


def finish(
    fleet: FaultFleet, *running: "subprocess.Popen[str]", codes: tuple[int, ...] = (0, 75)
) -> list[int]:
    """The exit codes, each one of ``codes``; who is refused is told who leads, who is left with work why."""
    found = []
    for each in running:
        result = fleet.wait_for_edgectl(each).expect_exit(*codes)
        if result.code == 75:
            result.expect_output("holds this fleet")
        found.append(result.code)
    return found


def check_nothing_doubled(fleet: FaultFleet) -> None:
    """No two instances at any moment since the beginning; what is placed now is the business of the winner."""
    clashes = oracle.find_overlaps(oracle.list_lifetimes(fleet.records))
    if clashes:
        raise ExpectationError(f"doubled: {clashes}")


def play_rounds(fleet: FaultFleet, count: int, play: Callable[[FaultFleet, Manager, Manager], None]) -> None:
    """Interleave two managers ``count`` times on the same hosts; each time they want other places.

    At random nothing runs before the first round, and both change roles.
    """
    ana, ben = open_managers(fleet)
    if fleet.random.random() < 0.6:
        ana.run(*APPLY).expect_exit(0)
    for _ in range(count):
        ana, ben = fleet.random.sample([ana, ben], 2)
        ana.want_at_random()
        ben.want_at_random()
        fleet.injected += 1
        play(fleet, ana, ben)
        check_nothing_doubled(fleet)


@fault(
    "two managers that disagree: at once or staggered, from nothing or not",
    quick=True,
    full=8,
    kinds=ALL,
)
def conflict_at_random(fleet: FaultFleet) -> None:
    play_rounds(fleet, 1 if fleet.sample else 6, _collide)


def _collide(fleet: FaultFleet, ana: Manager, ben: Manager) -> None:
    first = ana.start(*APPLY)
    fleet.wait(fleet.random.choice([0.0, fleet.random.uniform(0.0, 3.0)]))
    if finish(fleet, first, ben.start(*APPLY)) == [75, 75]:
        raise ExpectationError("both were refused")


@fault(
    "two managers that disagree: one freezes in an apply and thaws while the other acts",
    full=4,
    kinds=ALL,
)
def freeze_within_the_lease(fleet: FaultFleet) -> None:
    play_rounds(fleet, 5, _freeze_shortly)


def _freeze_shortly(fleet: FaultFleet, ana: Manager, ben: Manager) -> None:
    frozen = ana.start(*APPLY)
    fleet.wait(fleet.random.uniform(0.3, 2.5))
    signal_manager(frozen, signal.SIGSTOP)
    acting = ben.start(*APPLY)
    fleet.wait(fleet.random.uniform(0.0, 3.0))
    signal_manager(frozen, signal.SIGCONT)
    finish(fleet, acting, frozen)


@fault(
    "two managers that disagree: one freezes past its lease, the other acts, it thaws",
    full=8,
    kinds=ALL,
)
def freeze_past_the_lease(fleet: FaultFleet) -> None:
    """Also for a start that was under way: it is not sent once the lease has run out."""
    play_rounds(fleet, 2, _freeze_long)


def _freeze_long(fleet: FaultFleet, ana: Manager, ben: Manager) -> None:
    frozen = ana.start(*APPLY)
    fleet.wait(fleet.random.uniform(0.6, 2.5))
    signal_manager(frozen, signal.SIGSTOP)
    finish(fleet, ben.start(*APPLY))
    fleet.wait(PAST_THE_LEASE_S)
    found = scan.read_process(frozen.pid)
    assert found is None or found.state in "TZ", f"somebody else has thawed it: {found}"
    ben.want_at_random()
    # A starved host may have granted the fleet to the frozen manager later than it was asked.
    finish(fleet, ben.start(*APPLY, "--lock-timeout", "60s"), codes=(0,))
    signal_manager(frozen, signal.SIGCONT)
    finish(fleet, frozen, codes=(0, 4, 75))


@fault(
    "two managers that disagree: one is killed in an apply, the other waits for the lease",
    full=4,
    kinds=ALL,
)
def kill_and_take_over(fleet: FaultFleet) -> None:
    play_rounds(fleet, 2, _kill_and_wait)


def _kill_and_wait(fleet: FaultFleet, ana: Manager, ben: Manager) -> None:
    killed = ana.start(*APPLY)
    fleet.wait(fleet.random.uniform(0.6, 2.5))
    signal_manager(killed, signal.SIGKILL)
    killed.communicate()
    finish(fleet, ben.start(*APPLY, "--lock-timeout", "60s"), codes=(0,))


@fault("two managers that disagree: each reaches one half", full=6, kinds=ALL)
def split_the_fleet(fleet: FaultFleet) -> None:
    """Both know where the tasks run: what runs on a host that a manager does not reach is held."""
    ana, ben = open_managers(fleet)
    for _ in range(1 if fleet.sample else 4):
        ana.want_at_random()
        ben.want(_read_pins(ana))
        for manager in (ana, ben):
            manager.hide()
            manager.run(*APPLY).expect_exit(0)
        ana.hide(*fleet.edges[fleet.random.choice([1, 2]) :])
        ben.hide(fleet.first)
        for manager in (ana, ben):
            manager.want_at_random()
        fleet.injected += 1
        finish(fleet, ana.start(*APPLY), ben.start(*APPLY), codes=(4, 75))
        check_nothing_doubled(fleet)


@fault("two managers that disagree: one acts, the other loses sight of a host", quick=True, full=6, kinds=ALL)
def act_behind_its_back(fleet: FaultFleet) -> None:
    """What one manager remembers is no longer true, and where a task went it cannot see. New tasks come, too."""
    ana, ben = open_managers(fleet)
    ana.run(*APPLY).expect_exit(0)
    for _ in range(1 if fleet.sample else 4):
        ana, ben = fleet.random.sample([ana, ben], 2)
        for manager in (ana, ben):
            manager.hide()
        if fleet.random.random() < 0.7:
            ben.want_at_random()
            ben.run(*APPLY).expect_exit(0)
        ana.want_at_random()
        ana.run(*APPLY).expect_exit(0)
        ben.hide(fleet.random.choice(fleet.edges))
        ben.want_at_random()
        fleet.injected += 1
        finish(fleet, ben.start(*APPLY), codes=(4,))
        check_nothing_doubled(fleet)


@fault("two managers that disagree: one has a host that the other lacks", full=6, kinds=ALL)
def lack_a_host(fleet: FaultFleet) -> None:
    """What runs there is held by the manager that lacks the host, whether it knows of it by itself or not."""
    ana, _ = open_managers(fleet)
    missing = fleet.random.choice(fleet.edges)
    ben = Manager(fleet=fleet, name="ben", lacks=(missing,))
    if fleet.random.random() < 0.5:
        ben.want_at_random()
        ben.run(*APPLY).expect_exit(0)
    for _ in range(1 if fleet.sample else 4):
        ana.want_at_random()
        ana.run(*APPLY).expect_exit(0)
        ben.want_at_random()
        fleet.injected += 1
        # A copy elsewhere that the record or a pin of this manager contradicts is stopped, and its task held, too.
        codes = (4,) if missing in _read_pins(ana).values() else (0, 4)
        result = ben.run(*APPLY).expect_exit(*codes)
        if result.code == 4:
            result.expect_output(f"may run on {missing}")
        check_nothing_doubled(fleet)


def _read_pins(manager: Manager) -> dict[str, str]:
    document = json.loads(manager.tasks.read_text())
    return {task: entry["hosts"]["pin"] for task, entry in document["tasks"].items()}


@fault(
    "two managers that disagree: two watches, and a person's command between",
    quick=True,
    full=4,
    kinds=ALL,
)
def watch_twice(fleet: FaultFleet) -> None:
    ana, ben = open_managers(fleet)
    first = ana.start("watch", "--apply", "--every", "2s", "--cycles", "6")
    fleet.wait(4.0)
    ben.run("watch", "--apply", "--every", "2s", "--cycles", "3").expect_exit(75).expect_output(
        "watches this fleet every 2", "--take-over"
    )
    ben.run(*APPLY).expect_exit(0, 4, 75)
    fleet.wait_for_edgectl(first).expect_exit(0, 4, 75)
    check_nothing_doubled(fleet)
    ben.run("watch", "--apply", "--every", "1s", "--cycles", "1").expect_exit(0, 4)
    check_nothing_doubled(fleet)
