# SPDX-License-Identifier: Apache-2.0
"""A fleet in a closed loop: readings with noise, a decision in each cycle, and its moves carried out."""

import random
from dataclasses import dataclass, field

from edgectl.gateway.smoothing import smooth_snapshot
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.rules.slack import MAX_READINGS, estimate_noise
from tests.builders import a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import run_assign


@dataclass(slots=True)
class ClosedLoop:
    """Tasks that use 85 % of their demand in truth, on edges whose readings are off by a share of 4 cores.

    ``every`` (s): one cycle. ``readings``: of half a second each, of which a measurement is the mean.
    ``known``: the noise is measured.
    """

    demands: dict[str, float]
    base: dict[str, float]
    where: dict[str, str]
    noise: float
    smooth: bool
    seed: int = 1
    use: float = 0.85
    since: dict[str, float] = field(default_factory=dict)
    moves: int = 0
    every: float = 10.0
    readings: int = 1
    known: bool = False
    history: dict[str, list[float]] = field(default_factory=dict)

    def run(self, cycles: int = 360) -> int:
        """Return the moves in ``cycles``: an hour."""
        dice, before = random.Random(self.seed), None
        inventory = an_inventory(*map(an_edge, self.base))
        tasks = some_tasks(*(a_task(name, cpu=demand) for name, demand in self.demands.items()))
        self.since = dict.fromkeys(self.where, -3600.0)
        for cycle in range(cycles):
            now = cycle * self.every
            snapshot = self._measure(dice, now)
            before = smooth_snapshot(before, snapshot, period=10.0) if self.smooth else snapshot
            self._decide(inventory, tasks, before, now)
        return self.moves

    def _measure(self, dice: random.Random, now: float) -> Snapshot:
        samples = {}
        for edge, base in self.base.items():
            here = [name for name, host in self.where.items() if host == edge]
            used = base + sum(self.use * self.demands[name] for name in here)
            errors = [dice.uniform(-self.noise, self.noise) for _ in range(self.readings)]
            error = 4.0 * sum(errors) / self.readings
            self.history.setdefault(edge, []).append(max(0.0, used + error) / 4.0)
            runs = {
                name: a_run(
                    used=Usage(cpu=self.use * self.demands[name]), started_at=self.since[name], instance=name
                )
                for name in here
            }
            samples[edge] = a_sample(used=max(0.0, used + error), tasks=runs)
        return a_snapshot(samples, taken_at=now)

    def _decide(self, inventory: Inventory, tasks: Tasks, snapshot: Snapshot, now: float) -> None:
        placements = {n: Placement(host=h, since=self.since[n]) for n, h in self.where.items()}
        noise = {
            edge: {"cpu": estimate_noise(shares[-MAX_READINGS:])} for edge, shares in self.history.items()
        }
        memory = ManagerState(managed=True, placements=placements, noise=noise if self.known else {})
        policy = Policy(attended=False)
        for decision in run_assign(
            inventory, tasks, snapshot, memory=memory, policy=policy, now=now
        ).decisions:
            if decision.host is not None and decision.host != self.where[decision.task]:
                self.moves += 1
                self.where[decision.task], self.since[decision.task] = decision.host, now


def build_tight_loop(spare: float, noise: float, *, smooth: bool, seed: int = 1) -> ClosedLoop:
    """Two equal edges filled but for ``spare`` of their capacity, one of them by a task of half its cores."""
    base = 4.0 * (1.0 - spare) - 2.0
    return ClosedLoop(
        {"slam": 2.0}, {"edge1": base, "edge2": base}, {"slam": "edge1"}, noise, smooth, seed=seed
    )


def build_saturated_loop(*, smooth: bool, seed: int = 1) -> ClosedLoop:
    """Six tasks that use four times what they declare, on three edges that are all above their capacity."""
    names = [f"task{n}" for n in range(6)]
    edges = ("edge1", "edge2", "edge3")
    where = {name: edges[n % 3] for n, name in enumerate(names)}
    return ClosedLoop(
        dict.fromkeys(names, 0.4), dict.fromkeys(edges, 1.2), where, 0.02, smooth, seed=seed, use=4.0
    )
