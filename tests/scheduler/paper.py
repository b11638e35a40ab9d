# SPDX-License-Identifier: Apache-2.0
"""Measurements for the two scenarios of the paper's Section V, and an independent naive computation of
equations (1)-(5) as a reference.
"""

from edgectl.model.policy import Weights
from edgectl.model.resource import Usage
from edgectl.model.snapshot import Snapshot, TaskSample
from tests.builders import GI, a_link, a_run, a_sample, a_snapshot

# Percent of one edge's CPU and memory and of one link, from the authors' configuration.
DEMANDS = {
    "slam": (35.195, 2.5, 2.53),
    "navigation": (2.705, 2.33, 2.328),
    "detection": (60.035, 20.04, 35.652),
    "map-merge": (9.607, 2.83, 3.62),
}
BASE = {"edge1": (12.0, 35.0, 3.0), "edge2": (10.0, 35.0, 3.0), "edge3": (11.0, 35.0, 3.0)}
ROBOTS = ("robot1", "robot2", "robot3")
CORES, MEMORY, LINK = 4.0, 4 * GI, 6.75e6  # ARMv8 x 4, 4 GB, 54 Mbit/s
LIMIT = 1.2  # ten tasks ask for 303 % of three edges: the overcommit is reported


def paper_snapshot(placed: dict[str, str]) -> Snapshot:
    """Return base load plus the demands of the running tasks, measured exactly; tasks on no edge run on the
    robots.
    """
    samples = {}
    for edge, (cpu, memory, throughput) in BASE.items():
        here = [name for name, host in placed.items() if host == edge]
        rates = {
            robot: throughput + sum(DEMANDS[get_kind(name)][2] for name in here if has_link(name, robot))
            for robot in ROBOTS
        }
        samples[edge] = a_sample(
            cores=CORES, used=CORES * (cpu + sum(DEMANDS[get_kind(name)][0] for name in here)) / 100, memory=MEMORY,
            used_memory=MEMORY * (memory + sum(DEMANDS[get_kind(name)][1] for name in here)) / 100,
            links={robot: a_link(LINK, LINK * rate / 100) for robot, rate in rates.items()}, tasks={name: a_paper_run(name) for name in here},
        )  # fmt: skip
    for robot in ROBOTS:
        samples[robot] = a_sample(
            tasks={name: a_paper_run(name) for name, host in placed.items() if host == robot}
        )
    return a_snapshot(samples)


def a_paper_run(name: str) -> TaskSample:
    """A running task that uses exactly its demand."""
    cpu, memory, throughput = DEMANDS[get_kind(name)]
    links = {robot: LINK * throughput / 100 for robot in ROBOTS if has_link(name, robot)}
    return a_run(
        used=Usage(cpu=CORES * cpu / 100, memory=MEMORY * memory / 100, network=sum(links.values())),
        links=links,
    )


def get_kind(name: str) -> str:
    """``slam-robot1`` -> ``slam``."""
    return name.rsplit("-robot", 1)[0]


def has_link(name: str, robot: str) -> bool:
    """Return whether a task uses the link to ``robot``."""
    return name == "map-merge" or name.endswith(robot)


Numbers = dict[str, tuple[float, float, float, float, float]]


def compute_naively(
    placed: dict[str, str], order: list[str], weights: Weights, needs: dict[str, str]
) -> tuple[dict[str, str], dict[str, Numbers]]:
    """Place ``order`` on the three edges in percent, by the equations of the paper, without code of edgectl."""
    cpu = {e: BASE[e][0] + sum(DEMANDS[get_kind(t)][0] for t in placed if placed[t] == e) for e in BASE}
    memory = {e: BASE[e][1] + sum(DEMANDS[get_kind(t)][1] for t in placed if placed[t] == e) for e in BASE}
    net = {
        (e, r): BASE[e][2] + sum(DEMANDS[get_kind(t)][2] for t in placed if placed[t] == e and has_link(t, r))
        for e in BASE
        for r in ROBOTS
    }
    where, numbers = dict(placed), {}
    for task in order:
        rho = DEMANDS[get_kind(task)]
        table: Numbers = {}
        near = [e for e in BASE if task in needs and where[needs[task]] == e]
        for e in BASE:
            robot = next(r for r in ROBOTS if has_link(task, r))
            terms = (
                (100 * LIMIT - cpu[e] - rho[0]) / (100 * LIMIT),
                (100 - memory[e] - rho[1]) / 100,
                (100 - net[e, robot] - rho[2]) / 100,
                float(e in near) if near else 0.5,
            )
            table[e] = (
                *terms,
                weights["cpu"] * terms[0]
                + weights["memory"] * terms[1]
                + weights["network"] * terms[2]
                + weights["task"] * terms[3],
            )
        fitting = [e for e in BASE if min(table[e][:3]) >= 0]
        best = max(
            fitting,
            key=lambda e: (
                round(table[e][4], 9),
                round(sum(table[e][:3]), 9),
                -sum(where[t] == e for t in where if t not in placed),
                -int(e[-1]),
            ),
        )
        cpu[best] += rho[0]
        memory[best] += rho[1]
        net[best, robot] += rho[2]
        where[task] = best
        numbers[task] = table
    return where, numbers
