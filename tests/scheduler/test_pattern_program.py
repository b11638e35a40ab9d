# SPDX-License-Identifier: Apache-2.0
"""The first two levels by ways to fill each place, against the program of counts and against enumeration (ADR 78)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from random import Random

import pytest

from edgectl.scheduler import optimum
from edgectl.scheduler.array_patterns import list_patterns
from edgectl.scheduler.integer_program import IntegerProgram, Solution
from edgectl.scheduler.pattern_program import solve_by_patterns
from edgectl.scheduler.placement_problem import PlacementModel, Requirements
from edgectl.solver.highs import make_solver, solve_program
from tests.pace import patience
from tests.quality.measures import _skip_last_level, find_best, prove_first_levels, start_newcomers
from tests.scheduler.tight_fleets import TightFleet, build_random_fleet

Call = tuple[PlacementModel, Requirements, bool]


@pytest.mark.parametrize("seed", range(12))
def test_every_way_to_fill_a_place_is_one_of_the_list_or_a_part_of_one(seed: int) -> None:
    dice = Random(seed)
    shares = [[dice.choice([0.0, dice.uniform(0.05, 0.7)]) for _ in range(3)] for _ in range(4)]
    most, homes = [dice.randint(0, 4) for _ in shares], [dice.randint(0, 2) for _ in shares]
    limits = [dice.uniform(-0.1, 1.0) for _ in range(3)]
    found = list_patterns(shares, most, limits, homes, [1.0, 2.0, 1.0, 0.5])
    assert found is not None

    def fits(counts: Sequence[float]) -> bool:
        loads = [
            sum(count * row[column] for count, row in zip(counts, shares, strict=True)) for column in range(3)
        ]
        return all(
            load <= max(0.0, limit) + 1e-8 for load, limit in zip(loads, limits, strict=True) if load > 0.0
        )

    rows = found.counts.tolist()
    assert all(fits(row) and all(n <= top for n, top in zip(row, most, strict=True)) for row in rows)
    for counts in product(*[range(top + 1) for top in most]):
        if fits(counts):
            assert any(all(n <= top for n, top in zip(counts, row, strict=True)) for row in rows), counts
    prices = [dice.uniform(0.0, 2.0) for _ in shares]
    gains = [
        sum(g * min(n, h) for g, n, h in zip((1.0, 2.0, 1.0, 0.5), row, homes, strict=True)) for row in rows
    ]
    costs = [sum(price * n for price, n in zip(prices, row, strict=True)) for row in rows]
    worth, _, _ = found.find_best(prices)
    assert worth == pytest.approx(max(gain - cost for gain, cost in zip(gains, costs, strict=True)))


def test_too_many_ways_are_not_listed() -> None:
    assert list_patterns([[0.01]] * 8, [50] * 8, [1.0], [0] * 8, [1.0] * 8) is None


def collect_calls(fleet: TightFleet, monkeypatch: pytest.MonkeyPatch) -> list[Call]:
    """The programs of the first two levels of the best plan of ``fleet``, as they are given to patterns."""
    calls: list[Call] = []

    def collect(
        model: PlacementModel, required: Requirements, solve: Callable[..., Solution], *, rounded: bool
    ) -> Solution | None:
        calls.append((model, required, rounded))
        return solve_by_patterns(model, required, solve, rounded=rounded)

    monkeypatch.setattr(optimum, "solve_by_patterns", collect)
    find_best(fleet, _skip_last_level(make_solver(patience(20.0))))
    return [call for call in calls if not call[0].exact]


def find_broken_rows(program: IntegerProgram, values: Sequence[float]) -> list[int]:
    """The rows and bounds of ``program`` that ``values`` break."""
    sums = [
        sum(
            coefficient * values[variable]
            for variable, coefficient in zip(row.variables, row.coefficients, strict=True)
        )
        for row in program.rows
    ]
    broken = [
        number for number, (row, total) in enumerate(zip(program.rows, sums, strict=True))
        if not row.lower - 1e-7 <= total <= row.upper + 1e-7
    ]  # fmt: skip
    return broken + [
        -1 for value, upper in zip(values, program.uppers, strict=True) if not 0.0 <= value <= upper
    ]


@pytest.mark.parametrize(("seed", "fill", "urgent"), [(0, 0.84, 0), (3, 0.87, 2), (5, 0.84, 3), (8, 0.87, 0)])
def test_bound_and_plan_are_those_of_the_program_of_counts(
    seed: int, fill: float, urgent: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also with tasks of two priorities, and where places are too large to be listed."""
    fleet = start_newcomers(build_random_fleet(28, 80, seed, fill), 9)
    tasks = {
        name: replace(task, priority=1.0) if index < urgent else task
        for index, (name, task) in enumerate(fleet.tasks.tasks.items())
    }
    fleet = replace(fleet, tasks=replace(fleet.tasks, tasks=tasks))
    calls = collect_calls(fleet, monkeypatch)
    assert calls
    for model, required, rounded in calls:
        program = model.program
        best = solve_program(program, patience(20.0))
        found = solve_by_patterns(
            model, required, lambda each: solve_program(each, patience(20.0)), rounded=rounded
        )
        assert found is not None
        assert not best.timed_out
        assert found.bound >= (int(best.bound + 1e-6) if rounded else best.bound) - 1e-6
        if found.values is None:
            continue
        assert find_broken_rows(program, found.values) == []
        value = sum(gain * each for gain, each in zip(program.gains, found.values, strict=True))
        assert value <= best.bound + 1e-6
        if not found.timed_out:
            assert int(value + 1e-6) == int(best.bound + 1e-6)


def test_a_fleet_that_the_program_of_counts_does_not_prove_in_time_is_proven() -> None:
    """20 of 200 tasks are new on 50 edges whose memory is 82 % full: the search for room leaves one of them out."""
    proof = prove_first_levels(50, 200, 90, 0.825, 20, 10.0)
    assert proof.complete
    assert proof.certificate.placed == 200
