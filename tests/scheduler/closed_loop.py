# SPDX-License-Identifier: Apache-2.0
"""A fleet in a closed loop: readings with noise, a decision in each cycle, and its moves carried out."""

import random
from collections.abc import Mapping
from dataclasses import dataclass, field

from edgectl.gateway.smoothing import smooth_snapshot
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.rules.slack import MAX_READINGS, estimate_noise
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
from tests.scheduler.fleets import run_assign

# Of each edge: cores, bytes, and bytes/s to the robot.
CAPACITIES: Mapping[str, float] = {"cpu": 4.0, "memory": 4 * GI, "network": 10e6}


@dataclass(slots=True)
class ClosedLoop:
    """Tasks that use 85 % of their demand of ``resource`` in truth, on edges whose readings of it are off.

    ``demands``, ``base`` (load of others) and ``noise`` are shares of the capacity. ``every`` (s): one cycle.
    ``readings``: of half a second each, of which a measurement is the mean. ``known``: the noise is measured.
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
    resource: str = "cpu"
    history: dict[str, list[float]] = field(default_factory=dict)

    def run(self, cycles: int = 360) -> int:
        """Return the moves in ``cycles``: an hour."""
        dice, before = random.Random(self.seed), None
        inventory = an_inventory(*map(an_edge, self.base), a_robot())
        tasks = some_tasks(*map(self._build_task, self.demands))
        self.since = dict.fromkeys(self.where, -3600.0)
        for cycle in range(cycles):
            now = cycle * self.every
            snapshot = self._measure(dice, now)
            before = smooth_snapshot(before, snapshot, period=10.0) if self.smooth else snapshot
            self._decide(inventory, tasks, before, now)
        return self.moves

    def _build_task(self, name: str) -> Task:
        amount = self.demands[name] * CAPACITIES[self.resource]
        key = "throughput" if self.resource == "network" else self.resource
        return a_task(name, robots=["robot1"], **{key: amount})  # type: ignore[arg-type]

    def _measure(self, dice: random.Random, now: float) -> Snapshot:
        samples = {}
        for edge, base in self.base.items():
            here = [name for name, host in self.where.items() if host == edge]
            used = base + sum(self.use * self.demands[name] for name in here)
            errors = [dice.uniform(-self.noise, self.noise) for _ in range(self.readings)]
            share = max(0.0, used + sum(errors) / self.readings)
            self.history.setdefault(edge, []).append(share)
            samples[edge] = self._build_sample(share, {name: self._build_run(name) for name in here})
        return a_snapshot(samples, taken_at=now)

    def _build_run(self, name: str) -> TaskSample:
        amount = self.use * self.demands[name] * CAPACITIES[self.resource]
        links = {"robot1": amount} if self.resource == "network" else None
        used = Usage({self.resource: amount})
        return a_run(used=used, links=links, started_at=self.since[name], instance=name)

    def _build_sample(self, share: float, runs: Mapping[str, TaskSample]) -> HostSample:
        used = dict.fromkeys(CAPACITIES, 0.0) | {self.resource: share * CAPACITIES[self.resource]}
        return a_sample(
            cores=CAPACITIES["cpu"],
            used=used["cpu"],
            memory=CAPACITIES["memory"],
            used_memory=used["memory"],
            links={"robot1": a_link(CAPACITIES["network"], used["network"])},
            tasks=runs,
        )

    def _decide(self, inventory: Inventory, tasks: Tasks, snapshot: Snapshot, now: float) -> None:
        placements = {n: Placement(host=h, since=self.since[n]) for n, h in self.where.items()}
        noise = {
            edge: {self.resource: estimate_noise(shares[-MAX_READINGS:])}
            for edge, shares in self.history.items()
        }
        memory = ManagerState(managed=True, placements=placements, noise=noise if self.known else {})
        policy = Policy(attended=False)
        for decision in run_assign(
            inventory, tasks, snapshot, memory=memory, policy=policy, now=now
        ).decisions:
            if decision.host is not None and decision.host != self.where[decision.task]:
                self.moves += 1
                self.where[decision.task], self.since[decision.task] = decision.host, now


def build_tight_loop(
    spare: float, noise: float, *, smooth: bool, seed: int = 1, resource: str = "cpu", known: bool = False
) -> ClosedLoop:
    """Two equal edges filled but for ``spare`` of their capacity, one of them by a task of half of it.

    The other one is first by its name.
    """
    return ClosedLoop(
        {"slam": 0.5},
        dict.fromkeys(("zeta", "beta"), 1.0 - spare - 0.5),
        {"slam": "zeta"},
        noise,
        smooth,
        seed=seed,
        known=known,
        resource=resource,
    )


def build_saturated_loop(*, smooth: bool, seed: int = 1, resource: str = "cpu") -> ClosedLoop:
    """Six tasks that use four times what they declare, on three edges that are all above their capacity."""
    names = [f"task{n}" for n in range(6)]
    edges = ("zeta", "beta", "alpha")
    where = {name: edges[n % 3] for n, name in enumerate(names)}
    return ClosedLoop(
        dict.fromkeys(names, 0.1),
        dict.fromkeys(edges, 0.3),
        where,
        0.02,
        smooth,
        seed=seed,
        use=4.0,
        resource=resource,
    )
