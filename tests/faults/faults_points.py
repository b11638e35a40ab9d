"""The manager killed (kill -9) at every named point of what it does: before and after each journalled step, request and file.

One fleet sees many kills. Each is followed by *one* plain apply, which must end with 0, and by the oracle's word. The points of an apply
are counted by running it once, unharmed.
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
Turn = Callable[[Fleet, int], tuple[str, ...]]
"""Gives edgectl something to do, another thing in odd turns than in even ones; returns the words of the command that does it."""


def every_point(fleet: Fleet, turn: Turn) -> None:
    """Kill at each point of both kinds of turn (of each, at a few drawn at random where the fleet wants a sample)."""
    counts = [points(fleet, turn, number) for number in (0, 1)]
    deaths = [(number, at) for number, count in enumerate(counts) for at in chosen(fleet, count)]
    turns = {number: [at for odd, at in deaths if odd == number] for number in (0, 1)}
    for number in range(2 * max(map(len, turns.values()))):
        odd = turns[number % 2]
        words = turn(fleet, number)
        if number // 2 < len(odd):
            killed_at(fleet, words, odd[number // 2])
        recover(fleet, words)


def points(fleet: Fleet, turn: Turn, number: int) -> int:
    """How many points a turn has."""
    fleet.notes.unlink(missing_ok=True)
    fleet.deadly = 0
    fleet.edgectl(*turn(fleet, number), *ONE_BY_ONE).must(0)
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
    died = fleet.edgectl(*words, *ONE_BY_ONE)
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
    return APPLY


def overlapping(fleet: Fleet, number: int) -> tuple[str, ...]:
    """slam moves start-first."""
    fleet.pin("slam", "edge1" if number % 2 else "edge2")
    return APPLY


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
            return APPLY
        fleet.pin("slam", None)
        fleet.edgectl("uncordon", "edge1").must(0)
        return ("drain", "edge1", "--yes")

    every_point(fleet, turn)
