# SPDX-License-Identifier: Apache-2.0
"""Fleets that are nearly full, of which it is known that every task has room."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from random import Random

from edgectl.model.assignment import Assignment
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.task import Tasks
from tests.builders import (
    GI,
    a_link,
    a_robot,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import NO_MEMORY, run_assign

ROBOTS = ("robot1", "robot2", "robot3")
LINK = 10e6


@dataclass(frozen=True, slots=True, kw_only=True)
class TightFleet:
    """The input of one decision."""

    inventory: Inventory
    tasks: Tasks
    snapshot: Snapshot
    memory: ManagerState = NO_MEMORY
    policy: Policy = Policy()

    def assign(self) -> Assignment:
        """Decide."""
        return run_assign(self.inventory, self.tasks, self.snapshot, memory=self.memory, policy=self.policy)


def count_unplaced(assignment: Assignment) -> int:
    """Tasks without a host."""
    return sum(decision.host is None for decision in assignment.decisions)


def build_full_fleet(
    edges: int, tasks: int, seed: int, fill: tuple[float, float] = (0.88, 0.95)
) -> TightFleet:
    """``tasks`` dealt to ``edges`` of unlike sizes so that each edge is filled to ``fill`` in CPU and memory:
    a full placement exists by construction.
    """
    dice = Random(seed)
    names = [f"edge{number}" for number in range(1, edges + 1)]
    cores = {name: dice.choice([2.0, 4.0, 6.0, 8.0]) for name in names}
    memory = {name: dice.choice([2.0, 4.0, 8.0, 16.0]) * GI for name in names}
    dealt: dict[str, list[str]] = {name: [] for name in names}
    for number in range(tasks):
        dealt[names[number] if number < edges else dice.choice(names)].append(f"task{number:02}")
    demands: dict[str, tuple[float, float]] = {}
    for name, group in dealt.items():
        shares = [[dice.uniform(0.2, 1.0) for _ in group] for _ in range(2)]
        wholes = [cores[name] * dice.uniform(*fill), memory[name] * dice.uniform(*fill)]
        for index, task in enumerate(group):
            demands[task] = tuple(  # type: ignore[assignment]
                whole * share[index] / sum(share) for whole, share in zip(wholes, shares, strict=True)
            )
    return TightFleet(
        inventory=an_inventory(*map(an_edge, names), *(a_robot(robot, probe=False) for robot in ROBOTS)),
        tasks=some_tasks(
            *(
                a_task(
                    task,
                    cpu=cpu,
                    memory=ram,
                    throughput=dice.uniform(0.0, 0.2e6),
                    robots=[dice.choice(ROBOTS)],
                )
                for task, (cpu, ram) in demands.items()
            )
        ),
        snapshot=a_snapshot(
            {
                name: a_sample(
                    cores=cores[name], memory=memory[name], links={robot: a_link(LINK) for robot in ROBOTS}
                )
                for name in names
            }
        ),
    )


def build_random_fleet(edges: int, tasks: int, seed: int, fill: float) -> TightFleet:
    """Tasks of ten kinds whose memory adds up to ``fill`` of all edges, and their CPU to at most 0.75."""
    dice = Random(seed)
    names = [f"edge{number}" for number in range(1, edges + 1)]
    cores = {name: dice.choice([2.0, 4.0, 8.0]) for name in names}
    memory = {name: dice.choice([2.0, 4.0, 8.0]) * GI for name in names}
    kinds = [(dice.uniform(0.1, 1.0), dice.uniform(0.1, 1.0), dice.uniform(0.0, 0.3e6)) for _ in range(10)]
    drawn = [dice.choice(kinds) for _ in range(tasks)]
    cpu_scale = min(1.0, 0.75 * sum(cores.values()) / sum(kind[0] for kind in drawn))
    memory_scale = fill * sum(memory.values()) / sum(kind[1] for kind in drawn)
    return TightFleet(
        inventory=an_inventory(*map(an_edge, names), *(a_robot(robot, probe=False) for robot in ROBOTS)),
        tasks=some_tasks(
            *(
                a_task(
                    f"task{number:02}",
                    cpu=kind[0] * cpu_scale,
                    memory=kind[1] * memory_scale,
                    throughput=kind[2],
                    robots=[dice.choice(ROBOTS)],
                )
                for number, kind in enumerate(drawn)
            )
        ),
        snapshot=a_snapshot(
            {
                name: a_sample(
                    cores=cores[name],
                    used=cores[name] * dice.uniform(0.0, 0.1),
                    memory=memory[name],
                    used_memory=memory[name] * dice.uniform(0.0, 0.1),
                    links={robot: a_link(LINK, LINK * dice.uniform(0.0, 0.2)) for robot in ROBOTS},
                )
                for name in names
            }
        ),
    )


def enlarge_edge(fleet: TightFleet, name: str, factor: float = 1.1) -> TightFleet:
    """``fleet`` with one edge that is larger in every resource."""
    host = fleet.snapshot.hosts[name]
    larger: Mapping[str, HostSample] = {
        **fleet.snapshot.hosts,
        name: replace(
            host,
            usage={
                key: replace(usage, capacity=usage.capacity * factor) for key, usage in host.usage.items()
            },
        ),
    }
    return replace(fleet, snapshot=replace(fleet.snapshot, hosts=larger))
