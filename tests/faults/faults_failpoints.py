# SPDX-License-Identifier: Apache-2.0
"""The manager killed with SIGKILL at every failpoint: before and after each journalled step, request and
file.

One fleet takes many kills. After each, the same command runs *once* more, must exit with 0, and the oracle
judges. The failpoints of a command are counted in an undisturbed run.
"""

import signal
from collections.abc import Callable

from tests.faults import failpoint_runner
from tests.faults.command_result import ExpectationError
from tests.faults.faults_host import start_tasks
from tests.faults.fleet import APPLY, FaultFleet
from tests.faults.registry import CONTAINERS, fault

ONE_BY_ONE = ("--max-parallel", "1")
APPLY_ONE = (*APPLY, *ONE_BY_ONE)
Change = Callable[[FaultFleet, int], tuple[str, ...]]
"""Gives edgectl something to do, each number in its own kind of turn (the number modulo the kinds); returns the words of the command."""


def kill_at_every_failpoint(fleet: FaultFleet, turn: Change, kinds: int = 2) -> None:
    """Kill at each failpoint of every variant of the command (or at a few of each, drawn at random:
    `EdgectlVariant.points`).
    """
    deaths = [choose_failpoints(fleet, count_failpoints(fleet, turn, kind)) for kind in range(kinds)]
    for number in range(kinds, kinds + kinds * max(map(len, deaths))):
        of_kind, round_number = deaths[number % kinds], number // kinds - 1
        words = turn(fleet, number)
        if round_number < len(of_kind):
            kill_at_failpoint(fleet, words, of_kind[round_number])
        rerun_command(fleet, words)


def count_failpoints(fleet: FaultFleet, turn: Change, number: int) -> int:
    """Count the failpoints of one variant."""
    fleet.failpoint_log.unlink(missing_ok=True)
    words = turn(fleet, number)
    fleet.kill_at = 0
    fleet.run_edgectl(*words).expect_exit(0)
    fleet.kill_at = None
    fleet.check_verdict()
    return len(failpoint_runner.read_failpoints(fleet.failpoint_log))


def choose_failpoints(fleet: FaultFleet, count: int) -> list[int]:
    """Choose the failpoints at which to kill."""
    every = list(range(1, count + 1))
    if fleet.points is None:
        return every
    if fleet.points < 0:
        return every[fleet.points :]
    return sorted(fleet.random.sample(every, min(fleet.points, count)))


def kill_at_failpoint(fleet: FaultFleet, words: tuple[str, ...], at: int) -> None:
    """Run edgectl until its ``at``-th failpoint, where it is killed. A run may have some failpoints less than
    counted, as where a copy stands already that was started in the run that was counted: then nothing is injected.
    """
    fleet.failpoint_log.unlink(missing_ok=True)
    fleet.kill_at = at
    died = fleet.run_edgectl(*words)
    fleet.kill_at = None
    if died.code == -signal.SIGKILL:
        fleet.injected += 1
    elif died.code or len(failpoint_runner.read_failpoints(fleet.failpoint_log)) < at / 2:
        raise ExpectationError(
            f"did not reach point {at}: {failpoint_runner.read_failpoints(fleet.failpoint_log)}, {died}"
        )


def rerun_command(fleet: FaultFleet, words: tuple[str, ...]) -> None:
    """Run the same command again, without a kill."""
    fleet.run_edgectl(*words).expect_exit(0)
    fleet.check_verdict()


def change_all_tasks(fleet: FaultFleet, number: int) -> tuple[str, ...]:
    """slam moves, nav restarts with another specification; map is started in even rounds and stopped in odd
    ones.
    """
    fleet.pin_task("slam", fleet.first if number % 2 else fleet.second)
    fleet.tasks["nav"]["env"] = {"TURN": str(number)}
    fleet.remove_task("map") if number % 2 else fleet.add_task("map", on=fleet.first)
    fleet.write_files()
    return APPLY_ONE


def move_slam(fleet: FaultFleet, number: int) -> tuple[str, ...]:
    """Start-first move of slam."""
    fleet.pin_task("slam", fleet.first if number % 2 else fleet.second)
    return APPLY_ONE


@fault("manager killed at every point of an apply: start, stop, restart, move", quick=True)
def kill_apply(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    kill_at_every_failpoint(fleet, change_all_tasks)


@fault("manager killed at every point of a start-first move")
def kill_start_first_move(fleet: FaultFleet) -> None:
    fleet.add_task("slam", on=fleet.first, handoff={"order": "start-first"})
    fleet.apply_and_check()
    fleet.overlap_allowed.add("slam")
    kill_at_every_failpoint(fleet, move_slam)


@fault("manager killed at every point of a drain", kinds=("loopback", *CONTAINERS))
def kill_drain(fleet: FaultFleet) -> None:
    """Even rounds drain slam's host; odd rounds uncordon it and bring slam back."""
    start_tasks(fleet)

    def turn(fleet: FaultFleet, number: int) -> tuple[str, ...]:
        if number % 2:
            fleet.run_edgectl("uncordon", fleet.first).expect_exit(0)
            fleet.pin_task("slam", fleet.first)
            return APPLY_ONE
        fleet.pin_task("slam", None)
        fleet.run_edgectl("uncordon", fleet.first).expect_exit(0)
        return ("drain", fleet.first, "--yes", *ONE_BY_ONE)

    kill_at_every_failpoint(fleet, turn)


@fault("manager killed at every point of a stop")
def kill_stop(fleet: FaultFleet) -> None:
    start_tasks(fleet)

    def turn(fleet: FaultFleet, _number: int) -> tuple[str, ...]:
        fleet.apply().expect_exit(0)
        fleet.expected.pop("slam", None)
        return ("stop", "slam", "--yes", *ONE_BY_ONE)

    kill_at_every_failpoint(fleet, turn, kinds=1)
    fleet.expected["slam"] = None


@fault("manager killed at every point of a done, and of the apply that follows")
def kill_done(fleet: FaultFleet) -> None:
    """Even rounds mark slam as done, which contacts no host; odd rounds stop it and start it again for the
    next round.
    """
    start_tasks(fleet)

    def turn(fleet: FaultFleet, number: int) -> tuple[str, ...]:
        if number % 2:
            fleet.expected.pop("slam", None)
            return APPLY_ONE
        fleet.run_edgectl("reopen", "slam").expect_exit(0)
        fleet.apply().expect_exit(0)
        fleet.expected["slam"] = None
        return ("done", "slam")

    kill_at_every_failpoint(fleet, turn)


@fault("manager killed at every point of a rollback")
def kill_rollback(fleet: FaultFleet) -> None:
    """Roll back to revision 1, where slam ran on the first host alone, then to revision 2, where it ran on the
    second and nav on the third.
    """
    fleet.add_task("slam", on=fleet.first)
    fleet.apply_and_check()
    fleet.add_task("nav", on=fleet.third)
    fleet.pin_task("slam", fleet.second)
    fleet.apply_and_check()
    for task in ("slam", "nav"):
        fleet.pin_task(task, None)

    def turn(fleet: FaultFleet, number: int) -> tuple[str, ...]:
        second = number % 2 == 1
        fleet.expected = {"slam": fleet.second, "nav": fleet.third} if second else {"slam": fleet.first}
        return ("rollback", "2" if second else "1", "--yes", *ONE_BY_ONE)

    kill_at_every_failpoint(fleet, turn)
