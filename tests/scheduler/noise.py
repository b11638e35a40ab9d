# SPDX-License-Identifier: Apache-2.0
"""Simulation of measurement noise: measured loads are off by some points, and the scheduler runs periodically.

    python -m tests.scheduler.noise

prints how often tasks change hosts under each scheme, and the reaction to a lasting step of the load.
"""

import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from edgectl.gateway.smoothing import smooth_snapshot
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import WEIGHT_PRESETS, Policy, PolicyName
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.assign import assign
from tests.builders import (
    GI,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.paper import DEMANDS, get_kind

Points = tuple[float, float, float]
# Load of others in percent of CPU, memory and each link.
BASE: Mapping[str, Points] = {
    "edge1": (12.0, 35.0, 3.0),
    "edge2": (10.0, 35.0, 3.0),
    "edge3": (11.0, 35.0, 3.0),
}
ROBOTS = ("robot1", "robot2")
MIXED = ("detection-robot1", "detection-robot2", "navigation-robot1", "navigation-robot2")
PERIOD_S = 10.0
LINK = 6.75e6
STEP = 25.0
STEP_AT = 60
# Step of the load that each variant weighs; tasks placed by their predecessors alone never move.
STEPS: Mapping[str, Points] = {
    "cpu": (STEP, 0.0, 0.0), "memory": (0.0, STEP, 0.0), "network": (0.0, 0.0, STEP), "task": (STEP, STEP, STEP),
    "all": (STEP, STEP, STEP), "resources": (STEP, STEP, STEP),
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseTrial:
    """One simulation.

    ``noise``: greatest error of CPU, memory and links in points. ``smooth``: as ``watch`` does.
    ``downtime_s``: measured downtime of every earlier move. ``step``: points added to the first task's host
    from cycle ``STEP_AT`` on.
    """

    policy: Policy
    names: tuple[str, ...] = MIXED
    noise: Points = (8.0, 0.0, 0.0)
    smooth: bool = False
    cycles: int = 200
    period_s: float = PERIOD_S
    downtime_s: float | None = None
    step: Points = (0.0, 0.0, 0.0)
    seed: int = 1


@dataclass(slots=True)
class SimulatedSite:
    """Placement of every task and its start; ``moves`` are (cycle, task)."""

    where: dict[str, str] = field(default_factory=dict)
    since: dict[str, float] = field(default_factory=dict)
    stays: dict[str, tuple[float, ...]] = field(default_factory=dict)
    moves: list[tuple[int, str]] = field(default_factory=list)

    def put(self, task: str, host: str, cycle: int, now: float) -> None:
        if self.where.get(task) == host:
            return
        if task in self.where:
            self.moves.append((cycle, task))
            self.stays[task] = (*self.stays.get(task, ()), now - self.since[task])
        self.where[task], self.since[task] = host, now


def build_tasks(names: Iterable[str]) -> Tasks:
    made = []
    for name in names:
        cpu, memory, throughput = DEMANDS[get_kind(name)]
        robot = name.rsplit("-", 1)[1]
        made.append(
            a_task(name, cpu=f"{cpu}%", memory=f"{memory}%", throughput=f"{throughput}%", robots=[robot])
        )
    return some_tasks(*made)


def run_trial(trial: NoiseTrial) -> list[tuple[int, str]]:
    """Return (cycle, task) of every change of host."""
    dice, site, tasks = random.Random(trial.seed), SimulatedSite(), build_tasks(trial.names)
    inventory = an_inventory(*map(an_edge, BASE), *map(a_robot, ROBOTS))
    downtimes = {
        (task, edge): (trial.downtime_s,) * 5
        for task in trial.names
        for edge in BASE
        if trial.downtime_s is not None
    }
    before: Snapshot | None = None
    stepped = ""
    for cycle in range(trial.cycles):
        now = cycle * trial.period_s
        if cycle == STEP_AT:
            stepped = site.where[trial.names[0]]
        measured = {
            edge: sample_host(trial, site, edge, trial.step if edge == stepped else (0.0, 0.0, 0.0), dice)
            for edge in BASE
        }
        snapshot = a_snapshot(measured, taken_at=now)
        before = smooth_snapshot(before, snapshot, period=trial.period_s) if trial.smooth else snapshot
        placements = {task: Placement(host=host, since=site.since[task]) for task, host in site.where.items()}
        memory = ManagerState(managed=True, placements=placements, downtimes=downtimes, stays=site.stays)
        for decision in assign(inventory, tasks, before, memory, trial.policy, now).decisions:
            assert decision.host is not None
            site.put(decision.task, decision.host, cycle, now)
    return site.moves


def sample_host(
    trial: NoiseTrial, site: SimulatedSite, edge: str, step: Points, dice: random.Random
) -> HostSample:
    """Return the sample of ``edge``: load of others, load of the tasks, and an error."""
    here = [task for task, host in site.where.items() if host == edge]
    cpu, memory, link = (base + more for base, more in zip(BASE[edge], step, strict=True))
    errors = [dice.uniform(-points, points) if points else 0.0 for points in (*trial.noise, trial.noise[2])]
    tasks = {
        task: a_run(used=Usage(cpu=4.0 * DEMANDS[get_kind(task)][0] / 100, memory=4 * GI * DEMANDS[get_kind(task)][1] / 100, network=LINK * DEMANDS[get_kind(task)][2] / 100), started_at=site.since[task])
        for task in here
    }  # fmt: skip
    rates = {
        robot: link + sum(DEMANDS[get_kind(task)][2] for task in here if task.endswith(robot))
        for robot in ROBOTS
    }
    return a_sample(
        used=4.0 * max(0.0, cpu + sum(DEMANDS[get_kind(task)][0] for task in here) + errors[0]) / 100,
        used_memory=4
        * GI
        * max(0.0, memory + sum(DEMANDS[get_kind(task)][1] for task in here) + errors[1])
        / 100,
        links={
            robot: a_link(LINK, LINK * max(0.0, rate + error) / 100)
            for (robot, rate), error in zip(rates.items(), errors[2:], strict=True)
        },
        tasks=tasks,
    )


def watch_policy(variant: str) -> Policy:
    """Return the defaults as used by ``watch``."""
    return Policy(weights=WEIGHT_PRESETS[variant], attended=False)


def compute_handoff_rate(trial: NoiseTrial) -> float:
    """Return the changes of host per cycle, over all tasks."""
    return len(run_trial(trial)) / trial.cycles


def a_steady_trial(variant: str, **changes: object) -> NoiseTrial:
    """Return a trial with every load off by up to 8 points of 100, under ``watch``'s defaults."""
    return replace(NoiseTrial(policy=watch_policy(variant), noise=(8.0, 8.0, 8.0), smooth=True), **changes)  # type: ignore[arg-type]


def measure_response(variant: str, seed: int = 1) -> list[int]:
    """Return the cycles after the step in which the one task moved, under the same noise."""
    trial = a_steady_trial(variant, names=("slam-robot1",), step=STEPS[variant], seed=seed)
    return [cycle - STEP_AT for cycle, _ in run_trial(trial)]


def main() -> None:
    cycles, seeds = 400, range(1, 6)
    print(
        f"Handoffs per cycle of {len(MIXED)} tasks on 3 edges, every load off by up to 8 points; {cycles} cycles of {PERIOD_S:g} s, {len(seeds)} seeds."
    )
    print(
        "Last column: a load of 25 points that comes to one task's host and stays: cycles until it is answered, and moves that it took.\n"
    )
    print(
        f"{'variant':<10}{'paper':>8}{'utility, unbraked':>20}{'margin and dwell':>18}{'as watch':>10}   answered after"
    )
    for variant in STEPS:
        weights = WEIGHT_PRESETS[variant]
        free = Policy(weights=weights, move_margin=0.0, min_dwell=0.0, max_moves=None)
        schemes = (
            a_steady_trial(variant, policy=Policy(name=PolicyName.PAPER, weights=weights), smooth=False),
            a_steady_trial(variant, policy=free, smooth=False),
            a_steady_trial(variant, smooth=False),
            a_steady_trial(variant),
        )
        figures = [
            sum(compute_handoff_rate(replace(trial, cycles=cycles, seed=seed)) for seed in seeds) / len(seeds)
            for trial in schemes
        ]
        answers = [measure_response(variant, seed) for seed in seeds]
        told = (
            f"{min(a[0] for a in answers)} to {max(a[0] for a in answers)} cycles, {max(map(len, answers))} move"
            if all(answers)
            else "no move"
        )
        print(
            f"{variant:<10}{figures[0]:>8.2f}{figures[1]:>20.3f}{figures[2]:>18.3f}{figures[3]:>10.4f}   {told}"
        )


if __name__ == "__main__":
    main()
