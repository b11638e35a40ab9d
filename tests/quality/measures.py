# SPDX-License-Identifier: Apache-2.0
"""What plans leave out, each figure from fleets of stated seeds."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from random import Random
from time import process_time

from edgectl.model.assignment import Assignment, Certificate
from edgectl.model.policy import Policy
from edgectl.model.resource import AFFINITY, Usage
from edgectl.model.snapshot import HostSample
from edgectl.scheduler.assign import assign
from edgectl.scheduler.integer_program import IntegerProgram, Solution, Solver
from edgectl.solver.highs import make_solver
from tests.builders import NOW
from tests.pace import patience
from tests.quality.statements import build_explained_fleet, is_true, list_statements
from tests.scheduler.fleets import hosts_by_task, simulate_apply
from tests.scheduler.tight_fleets import (
    TightFleet,
    build_full_fleet,
    build_random_fleet,
    count_unplaced,
    enlarge_edge,
)

PLAIN, REBALANCED, OPTIMAL = Policy(), Policy(rebalance=True), Policy(optimal=True)


def measure_yardstick() -> float:
    """CPU seconds of ten million additions in a loop: how fast the machine is for Python now."""
    start, total = process_time(), 0
    for number in range(10_000_000):
        total += number
    return process_time() - start


# --- tasks that are left unplaced


def count_short_fleets(edges: int, tasks: int, seeds: Iterable[int]) -> int:
    """Fleets, filled to 88 to 95 % by construction, with a task that the plan leaves unplaced."""
    return sum(count_unplaced(build_full_fleet(edges, tasks, seed).assign()) > 0 for seed in seeds)


def count_needless_fleets(edges: int, tasks: int, seeds: Iterable[int], fill: float) -> int:
    """Random fleets with a task that the plan leaves unplaced, although not proven that not all have room."""
    found = 0
    for seed in seeds:
        fleet = build_random_fleet(edges, tasks, seed, fill)
        if count_unplaced(fleet.assign()):
            _, certificate = find_best(fleet, _skip_last_level(make_solver(patience(10.0))))
            found += certificate.placed_bound == tasks
    return found


def count_losing_fleets(edges: int, tasks: int, seeds: Iterable[int], fill: float) -> int:
    """Fleets of which a plan leaves more tasks unplaced if one edge is 10 % larger."""
    lost = 0
    for seed in seeds:
        fleet = build_random_fleet(edges, tasks, seed, fill)
        before = count_unplaced(fleet.assign())
        lost += count_unplaced(enlarge_edge(fleet, f"edge{1 + seed % edges}").assign()) > before
    return lost


def count_evicting_fleets(edges: int, tasks: int, seeds: Iterable[int], fill: float) -> int:
    """Fleets in which a newcomer moves a task within its dwell, or is placed by its name."""
    found = 0
    for seed in seeds:
        fleet = replace(build_idling_fleet(edges, tasks, seed, fill), policy=PLAIN)
        homes = {task: host for host, each in fleet.snapshot.hosts.items() for task in each.tasks}
        plans = [hosts_by_task(_rename_newcomer(fleet, name).assign()) for name in ("a-new", "z-new")]
        moved = any(plan[task] != host for plan in plans for task, host in homes.items())
        found += moved or plans[0]["a-new"] != plans[1]["z-new"]
    return found


def build_idling_fleet(edges: int, tasks: int, seed: int, fill: float) -> TightFleet:
    """All tasks but the first run, since now, and use 20 to 100 % of what they declare."""
    dice = Random(seed)
    fleet = start_newcomers(build_random_fleet(edges, tasks, seed, fill), 1)
    hosts = {name: _idle_tasks(sample, dice) for name, sample in fleet.snapshot.hosts.items()}
    return replace(fleet, snapshot=replace(fleet.snapshot, hosts=hosts))


def _idle_tasks(sample: HostSample, dice: Random) -> HostSample:
    """``sample`` with each task at a share of its use; the host and its links have so much less load."""
    usage, links, runs = dict(sample.usage), dict(sample.links), dict(sample.tasks)
    for name, run in sample.tasks.items():
        share = dice.uniform(0.2, 1.0)
        rates = {robot: rate * share for robot, rate in (run.links or {}).items()}
        runs[name] = replace(
            run, used=Usage({key: value * share for key, value in run.used.items()}), links=rates
        )
        for key, each in usage.items():
            usage[key] = replace(each, used=each.used - (1.0 - share) * run.used[key])
        for robot, rate in (run.links or {}).items():
            used = links[robot].used_bytes_per_s - (1.0 - share) * rate
            links[robot] = replace(links[robot], used_bytes_per_s=max(0.0, used))
    return replace(sample, usage=usage, links=links, tasks=runs)


def _rename_newcomer(fleet: TightFleet, name: str) -> TightFleet:
    first, *others = sorted(fleet.tasks.tasks)
    tasks = {name: replace(fleet.tasks.tasks[first], name=name)}
    tasks |= {other: fleet.tasks.tasks[other] for other in others}
    return replace(fleet, tasks=replace(fleet.tasks, tasks=tasks))


# --- the best plan


def find_best(fleet: TightFleet, solve: Solver) -> tuple[Assignment, Certificate]:
    """The plan of ``--optimal`` and its certificate."""
    policy = replace(fleet.policy, optimal=True)
    found = assign(fleet.inventory, fleet.tasks, fleet.snapshot, fleet.memory, policy, NOW, solve)
    assert found.certificate is not None
    return found, found.certificate


def _skip_last_level(solve: Solver) -> Solver:
    """``solve`` for the first two levels alone: the third is given all the time that is left."""
    none = Solution(values=None, bound=inf)

    def solve_first(program: IntegerProgram, share: float) -> Solution:
        return none if share == 1.0 else solve(program, share)

    return solve_first


def start_newcomers(fleet: TightFleet, newcomers: int) -> TightFleet:
    """``fleet`` in which all but the first ``newcomers`` tasks run."""
    names = sorted(fleet.tasks.tasks)[newcomers:]
    tasks = replace(fleet.tasks, tasks={name: fleet.tasks.tasks[name] for name in names})
    first = replace(fleet, tasks=tasks).assign()
    snapshot, memory = simulate_apply(first, tasks, fleet.snapshot, fleet.memory)
    return replace(fleet, snapshot=snapshot, memory=memory, policy=Policy(min_dwell=0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """What ``--optimal`` reached in its first two levels, whether it is proven, and the CPU seconds of the
    whole plan without the third level.
    """

    certificate: Certificate
    seconds: float

    @property
    def complete(self) -> bool:
        """Whether tasks placed and moves are both proven."""
        found = self.certificate
        return (found.placed, found.moves) == (found.placed_bound, found.moves_bound)


def prove_first_levels(
    edges: int, tasks: int, seed: int, fill: float, newcomers: int, deadline_s: float
) -> Proof:
    """Plan a fleet with ``newcomers``; ``deadline_s`` of an idle machine, half of it for each level at most."""
    fleet = start_newcomers(build_random_fleet(edges, tasks, seed, fill), newcomers)
    start = process_time()
    _, certificate = find_best(fleet, _skip_last_level(make_solver(patience(deadline_s))))
    return Proof(certificate=certificate, seconds=process_time() - start)


def count_proven_fleets(
    edges: int, tasks: int, seeds: Iterable[int], fill: float, newcomers: int, deadline_s: float
) -> int:
    """Fleets with ``newcomers`` for which the tasks placed and the moves are proven to be the best."""
    prove = partial(prove_first_levels, edges, tasks)
    return sum(prove(seed, fill, newcomers, deadline_s).complete for seed in seeds)


# --- the sum of utilities


@dataclass(frozen=True, slots=True, kw_only=True)
class Shortfall:
    """One way to plan one fleet: its share below the best sum that is known, CPU seconds, and tasks that it
    leaves out; ``proven``: no plan has a greater sum.
    """

    below: float
    seconds: float
    unplaced: int
    proven: bool = False


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


def measure_shortfalls(
    edges: int, tasks: int, seeds: Sequence[int], fill: float, deadline_s: float
) -> dict[str, list[Shortfall]]:
    """By way to plan: what each of the fleets lacks of the best sum that any of the ways reaches."""
    found: dict[str, list[Shortfall]] = {"plan": [], "plan --rebalance": [], "plan --optimal": []}
    for seed in seeds:
        fleet = build_random_fleet(edges, tasks, seed, fill)
        plans, spent, certificate = {}, {}, None
        for way, policy in zip(found, (PLAIN, REBALANCED, OPTIMAL), strict=True):
            start = process_time()
            if policy is OPTIMAL:
                plans[way], certificate = find_best(fleet, make_solver(patience(deadline_s)))
            else:
                plans[way] = replace(fleet, policy=policy).assign()
            spent[way] = process_time() - start
        assert certificate is not None
        best = max(sum_utilities(fleet, plan) for plan in plans.values())
        bound = certificate.utility_sum_bound
        for way, plan in plans.items():
            below = 1.0 - sum_utilities(fleet, plan) / best
            found[way].append(
                Shortfall(
                    below=below,
                    seconds=spent[way],
                    unplaced=count_unplaced(plan),
                    proven=way == "plan --optimal" and bound is not None and bound / best < 1.0 + 1e-5,
                )
            )
    return found


# --- explanations


def count_true_statements(seeds: Iterable[int], names: Sequence[str] = ()) -> tuple[int, int]:
    """Statements of ``explain`` on ``names``, or on all tasks of the fleets, and how many of them are true."""
    total = true = 0
    for seed in seeds:
        fleet = build_explained_fleet(seed)
        for statement in list_statements(fleet, names):
            total += 1
            true += is_true(fleet, statement)
    return total, true
