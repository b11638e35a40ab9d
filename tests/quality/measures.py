"""What plans leave out, each figure from fleets of stated seeds."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from time import process_time

from edgectl.model.assignment import Assignment, Certificate
from edgectl.model.policy import Policy
from edgectl.model.resource import AFFINITY
from edgectl.scheduler.assign import assign
from edgectl.solver.highs import make_solver
from tests.builders import NOW
from tests.scheduler.fleets import simulate_apply
from tests.scheduler.tight_fleets import (
    TightFleet,
    build_full_fleet,
    build_random_fleet,
    count_unplaced,
    enlarge_edge,
)

PLAIN, REBALANCED, OPTIMAL = Policy(), Policy(rebalance=True), Policy(optimal=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shortfall:
    """Shares below the best sum that is known, and CPU seconds, of one way to plan."""

    mean: float
    most: float
    seconds: float


def sum_utilities(fleet: TightFleet, found: Assignment) -> float:
    """Sum of eq. (4) of all placed tasks, which have no predecessors, at the loads after the plan."""
    weights = found.policy.weights
    total = 0.0
    for decision in found.decisions:
        if decision.host is None:
            continue
        sample, load = fleet.snapshot.hosts[decision.host], found.expected[decision.host]
        for name, usage in sample.usage.items():
            total += weights[name] * (1 - load.used[name] / usage.capacity)
        links = (
            1 - load.links[robot] / sample.links[robot].capacity_bytes_per_s
            for robot in fleet.tasks.tasks[decision.task].robots
        )
        total += weights["network"] * min(links) + weights[AFFINITY] / 2
    return total


def find_best(fleet: TightFleet, deadline_s: float) -> tuple[Assignment, Certificate]:
    """The plan of ``--optimal`` and its certificate."""
    policy = replace(fleet.policy, optimal=True)
    solve = make_solver(deadline_s)
    found = assign(fleet.inventory, fleet.tasks, fleet.snapshot, fleet.memory, policy, NOW, solve)
    assert found.certificate is not None
    return found, found.certificate


def start_newcomers(fleet: TightFleet, newcomers: int) -> TightFleet:
    """``fleet`` in which all but the first ``newcomers`` tasks run."""
    names = sorted(fleet.tasks.tasks)[newcomers:]
    tasks = replace(fleet.tasks, tasks={name: fleet.tasks.tasks[name] for name in names})
    first = replace(fleet, tasks=tasks).assign()
    snapshot, memory = simulate_apply(first, tasks, fleet.snapshot, fleet.memory)
    return replace(fleet, snapshot=snapshot, memory=memory, policy=Policy(min_dwell=0.0))


def count_short_fleets(edges: int, tasks: int, seeds: Iterable[int]) -> int:
    """Fleets, filled to 88 to 95 % by construction, with a task that the plan leaves unplaced."""
    return sum(count_unplaced(build_full_fleet(edges, tasks, seed).assign()) > 0 for seed in seeds)


def count_losing_fleets(edges: int, tasks: int, seeds: Iterable[int], fill: float) -> int:
    """Fleets of which a plan leaves more tasks unplaced if one edge is 10 % larger."""
    lost = 0
    for seed in seeds:
        fleet = build_random_fleet(edges, tasks, seed, fill)
        before = count_unplaced(fleet.assign())
        lost += count_unplaced(enlarge_edge(fleet, f"edge{1 + seed % edges}").assign()) > before
    return lost


def measure_shortfalls(
    edges: int, tasks: int, seeds: Sequence[int], fill: float, deadline_s: float
) -> tuple[Shortfall, Shortfall, float, int]:
    """Plain and rebalanced plans against the best sum that is known; its mean gap to the bound, and how many
    of the fleets are proven. Fleets whose plain plan leaves a task out are passed over.
    """
    lost: dict[Policy, list[tuple[float, float]]] = {PLAIN: [], REBALANCED: []}
    gaps = []
    for seed in seeds:
        fleet = build_random_fleet(edges, tasks, seed, fill)
        if count_unplaced(fleet.assign()):
            continue
        _, certificate = find_best(fleet, deadline_s)
        best = certificate.utility_sum
        gaps.append((certificate.utility_sum_bound or best) / best - 1)
        for policy, found in lost.items():
            start = process_time()
            plan = replace(fleet, policy=policy).assign()
            found.append((1 - sum_utilities(fleet, plan) / best, process_time() - start))
    plain, rebalanced = (
        Shortfall(
            mean=sum(each for each, _ in found) / len(found),
            most=max(each for each, _ in found),
            seconds=max(each for _, each in found),
        )
        for found in lost.values()
    )
    return plain, rebalanced, sum(gaps) / len(gaps), sum(gap < 1e-5 for gap in gaps)


def count_proven_fleets(
    edges: int, tasks: int, seeds: Iterable[int], fill: float, newcomers: int, deadline_s: float
) -> int:
    """Fleets with ``newcomers`` for which the tasks placed and the moves are proven to be the best."""
    proven = 0
    for seed in seeds:
        fleet = start_newcomers(build_random_fleet(edges, tasks, seed, fill), newcomers)
        _, certificate = find_best(fleet, deadline_s)
        proven += (certificate.placed, certificate.moves) == (
            certificate.placed_bound,
            certificate.moves_bound,
        )
    return proven
