"""The manager killed (kill -9) at every named point of what it does: before and after each journalled step, request and file.

One fleet sees many kills. Each is followed by the same command *once* more, which must end with 0, and by the oracle's word. The points of
a command are counted by running it once, unharmed.
"""

import signal
from collections.abc import Callable

from tests.faults import armed
from tests.faults.faults_host import pair
from tests.faults.fleet import APPLY, Fleet
from tests.faults.outcome import ExpectationError
from tests.faults.registry import fault

SAMPLE = 1
ONE_BY_ONE = ("--max-parallel", "1")
APPLY_ONE = (*APPLY, *ONE_BY_ONE)
Turn = Callable[[Fleet, int], tuple[str, ...]]
"""Gives edgectl something to do, each number in its own kind of turn (the number modulo the kinds); returns the words of the command."""


def every_point(fleet: Fleet, turn: Turn, kinds: int = 2) -> None:
    """Kill at each point of every kind of turn (of each, at a few drawn at random where the fleet wants a sample)."""
    deaths = [chosen(fleet, points(fleet, turn, kind)) for kind in range(kinds)]
    for number in range(kinds, kinds + kinds * max(map(len, deaths))):
        of_kind, round_number = deaths[number % kinds], number // kinds - 1
        words = turn(fleet, number)
        if round_number < len(of_kind):
            killed_at(fleet, words, of_kind[round_number])
        recover(fleet, words)


def points(fleet: Fleet, turn: Turn, number: int) -> int:
    """How many points a turn has."""
    fleet.notes.unlink(missing_ok=True)
    words = turn(fleet, number)
    fleet.deadly = 0
    fleet.edgectl(*words).must(0)
    fleet.deadly = None
    fleet.check()
    return len(armed.reached(fleet.notes))


def chosen(fleet: Fleet, count: int) -> list[int]:
    """The points at which to kill."""
    every = range(1, count + 1)
    return sorted(fleet.draw.sample(every, SAMPLE)) if fleet.sample else list(every)


def killed_at(fleet: Fleet, words: tuple[str, ...], at: int) -> None:
    """Run edgectl until its ``at``-th point, where it dies. Some runs have a point less than the one that was counted: no injection then."""
    fleet.notes.unlink(missing_ok=True)
    fleet.deadly = at
    died = fleet.edgectl(*words)
    fleet.deadly = None
    if died.code == -signal.SIGKILL:
        fleet.injected += 1
    elif died.code or len(armed.reached(fleet.notes)) < at - 3:
        raise ExpectationError(f"did not reach point {at}: {armed.reached(fleet.notes)}, {died}")


def recover(fleet: Fleet, words: tuple[str, ...]) -> None:
    """The same command again, unharmed."""
    fleet.edgectl(*words).must(0)
    fleet.check()


def mixed(fleet: Fleet, number: int) -> tuple[str, ...]:
    """slam moves, nav restarts with another spec, map is started in even turns and stopped in odd ones."""
    fleet.pin("slam", "edge1" if number % 2 else "edge2")
    fleet.tasks["nav"]["env"] = {"TURN": str(number)}
    fleet.unwant("map") if number % 2 else fleet.want("map", on="edge1")
    fleet.write()
    return APPLY_ONE


def overlapping(fleet: Fleet, number: int) -> tuple[str, ...]:
    """slam moves start-first."""
    fleet.pin("slam", "edge1" if number % 2 else "edge2")
    return APPLY_ONE


@fault("manager killed at every point of an apply: start, stop, restart, move", quick=True)
def killed_at_points(fleet: Fleet) -> None:
    pair(fleet)
    every_point(fleet, mixed)


@fault("manager killed at every point of a start-first move")
def killed_at_points_start_first(fleet: Fleet) -> None:
    fleet.want("slam", on="edge1", handoff={"order": "start-first"})
    fleet.settle()
    fleet.overlap_allowed.add("slam")
    every_point(fleet, overlapping)


@fault("manager killed at every point of a drain", kinds=("loopback",))
def killed_at_points_of_drain(fleet: Fleet) -> None:
    """Even turns drain slam's host; odd ones open both again and bring slam back."""
    pair(fleet)

    def turn(fleet: Fleet, number: int) -> tuple[str, ...]:
        if number % 2:
            fleet.edgectl("uncordon", "edge1").must(0)
            fleet.pin("slam", "edge1")
            return APPLY_ONE
        fleet.pin("slam", None)
        fleet.edgectl("uncordon", "edge1").must(0)
        return ("drain", "edge1", "--yes", *ONE_BY_ONE)

    every_point(fleet, turn)


@fault("manager killed at every point of a stop", quick=True)
def killed_at_points_of_stop(fleet: Fleet) -> None:
    pair(fleet)

    def turn(fleet: Fleet, _number: int) -> tuple[str, ...]:
        fleet.apply().must(0)
        fleet.expected.pop("slam", None)
        return ("stop", "slam", "--yes", *ONE_BY_ONE)

    every_point(fleet, turn, kinds=1)
    fleet.expected["slam"] = None


@fault("manager killed at every point of a done, and of the apply that follows", quick=True)
def killed_at_points_of_done(fleet: Fleet) -> None:
    """Even turns mark slam done, which touches no host; odd ones stop it, and bring it back for the next turn."""
    pair(fleet)

    def turn(fleet: Fleet, number: int) -> tuple[str, ...]:
        if number % 2:
            fleet.expected.pop("slam", None)
            return APPLY_ONE
        fleet.edgectl("reopen", "slam").must(0)
        fleet.apply().must(0)
        fleet.expected["slam"] = None
        return ("done", "slam")

    every_point(fleet, turn)


@fault("manager killed at every point of a rollback", quick=True)
def killed_at_points_of_rollback(fleet: Fleet) -> None:
    """Back to revision 1, where slam ran on edge1 alone, and to revision 2, where it ran on edge2 beside nav."""
    fleet.want("slam", on="edge1")
    fleet.settle()
    fleet.want("nav", on="edge2")
    fleet.pin("slam", "edge2")
    fleet.settle()
    for task in ("slam", "nav"):
        fleet.pin(task, None)

    def turn(fleet: Fleet, number: int) -> tuple[str, ...]:
        second = number % 2 == 1
        fleet.expected = {"slam": "edge2", "nav": "edge2"} if second else {"slam": "edge1"}
        return ("rollback", "2" if second else "1", "--yes", *ONE_BY_ONE)

    every_point(fleet, turn)
