# SPDX-License-Identifier: Apache-2.0
"""Statements of ``edgectl explain -o json``: the fleet is changed as each says, and planned again.

Nothing here is shared with the code that makes the statements but the scheduler itself.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

from edgectl.executor.diff import plan_from_assignment
from edgectl.model.policy import Policy, Weights
from edgectl.model.snapshot import HostSample
from edgectl.transport.fake import FakeTransport
from edgectl.usecases.explain import explain_placement
from edgectl.usecases.fleet import Fleet
from edgectl.views.explanation import ExplanationView
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
from tests.scheduler.fleets import NO_MEMORY, hosts_by_task, simulate_apply
from tests.scheduler.tight_fleets import TightFleet

# Distance from a threshold, as a share of the amount and of the capacity: more than numbers are rounded by.
BESIDE = 2e-5
# Shares of the way to a threshold at which nothing may have moved yet.
BEFORE = (0.0, 0.25, 0.5, 0.75, 0.9)

Places = Mapping[str, str | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """One change that ``explain`` names for ``task``, as in its JSON."""

    task: str
    flip: Mapping[str, Any]


def build_explained_fleet(seed: int) -> TightFleet:
    """Three unlike edges, two robots, and nine tasks, some with predecessors; with odd seeds they run, and the
    load of others has changed since.
    """
    dice = Random(seed)
    edges, robots = ("edge1", "edge2", "edge3"), ("robot1", "robot2")
    tasks = [
        a_task(
            f"task{number}",
            cpu=dice.uniform(0.1, 0.9),
            memory=dice.uniform(0.1, 0.7) * GI,
            throughput=dice.uniform(0.0, 1e6),
            robots=[dice.choice(robots)],
            needs=[f"task{number - 1}"] if number % 3 == 2 else [],
        )
        for number in range(9)
    ]
    fleet = TightFleet(
        inventory=an_inventory(*map(an_edge, edges), *(a_robot(robot, probe=False) for robot in robots)),
        tasks=some_tasks(*tasks),
        snapshot=a_snapshot({edge: _draw_host(dice, robots) for edge in edges}, memory=NO_MEMORY),
        policy=Policy(min_dwell=0.0),
    )
    return _run_all(fleet, dice) if seed % 2 else fleet


def _draw_host(dice: Random, robots: Sequence[str]) -> HostSample:
    return a_sample(
        cores=dice.choice([2.0, 4.0]),
        used=dice.uniform(0.0, 1.0),
        used_memory=dice.uniform(0.0, 2.0) * GI,
        links={robot: a_link(10e6, dice.uniform(0.0, 4e6)) for robot in robots},
    )


def _run_all(fleet: TightFleet, dice: Random) -> TightFleet:
    snapshot, memory = simulate_apply(fleet.assign(), fleet.tasks, fleet.snapshot, fleet.memory)
    hosts = {name: _add_load(sample, dice.uniform(0.0, 0.6)) for name, sample in snapshot.hosts.items()}
    return replace(fleet, snapshot=replace(snapshot, hosts=hosts, manager=memory), memory=memory)


def _add_load(sample: HostSample, cores: float) -> HostSample:
    cpu = sample.usage["cpu"]
    return replace(sample, usage={**sample.usage, "cpu": replace(cpu, used=cpu.used + cores)})


def list_statements(fleet: TightFleet, names: Sequence[str] = ()) -> Iterator[Statement]:
    """Each change that ``explain -o json`` names for ``names``, or for all tasks."""
    plan = plan_from_assignment(fleet.inventory, fleet.tasks, fleet.snapshot, fleet.memory, fleet.assign())
    offline = Fleet(
        inventory=fleet.inventory, tasks=fleet.tasks, transport=FakeTransport({}), state=Path("/nowhere")
    )
    for step in plan.steps:
        if names and step.task not in names:
            continue
        view = ExplanationView(step, explain_placement(offline, plan, step.task))
        item: Any = view.document()["item"]
        for flip in item["flips"]:
            yield Statement(task=step.task, flip=flip)


def is_true(fleet: TightFleet, statement: Statement) -> bool:
    """Whether the whole plan does what is said: before the threshold, at the move of another task that is
    said to come first, between the two, and just beyond.
    """
    flip, task = statement.flip, statement.task
    base = hosts_by_task(fleet.assign())
    first, amount = flip["moves_first"], flip["amount"]
    until = amount if first is None else first["amount"]
    if any(plan_after(fleet, flip, each) != base for each in _list_amounts(fleet, flip, until)):
        return False
    if first is not None:
        moved = plan_after(fleet, flip, _step_beyond(fleet, flip, until))
        if moved[first["task"]] != first["host"] or first["host"] == base[first["task"]]:
            return False
        between = [until + share * (amount - until) for share in BEFORE[1:]]
        if any(plan_after(fleet, flip, each)[task] != base[task] for each in between):
            return False
    return bool(plan_after(fleet, flip, _step_beyond(fleet, flip, amount))[task] == flip["winner"])


def _list_amounts(fleet: TightFleet, flip: Mapping[str, Any], until: float) -> list[float]:
    """Amounts from none up to just short of the threshold ``until``."""
    start = _get_start(fleet, flip)
    near = _step_beyond(fleet, flip, until, sign=-1.0)
    inside = [start + share * (until - start) for share in BEFORE]
    return [*inside, near] if (near - start) * (until - start) > 0.0 else [start]


def _get_start(fleet: TightFleet, flip: Mapping[str, Any]) -> float:
    """The amount that changes nothing."""
    return fleet.policy.weights.normalised()[flip["term"]] if flip["unit"] == "weight" else 0.0


def _step_beyond(fleet: TightFleet, flip: Mapping[str, Any], amount: float, sign: float = 1.0) -> float:
    if flip["unit"] == "weight":
        return amount + sign * (BESIDE if flip["change"] == "weight-rises" else -BESIDE)
    return amount + sign * BESIDE * (amount + _get_capacity(fleet, flip))


def _get_capacity(fleet: TightFleet, flip: Mapping[str, Any]) -> float:
    host = fleet.snapshot.hosts[flip["host"]]
    if flip["robot"] is not None:
        return host.links[flip["robot"]].capacity_bytes_per_s
    return host.usage[flip["term"]].capacity


def plan_after(fleet: TightFleet, flip: Mapping[str, Any], amount: float) -> Places:
    """The host of each task in the plan of a fleet whose load or weight has changed by, or to, ``amount``."""
    if flip["unit"] == "weight":
        amount = min(1.0, max(0.0, amount))
        old = fleet.policy.weights.normalised()
        rest = (1.0 - amount) / (1.0 - old[flip["term"]])
        weights = {term: amount if term == flip["term"] else rest * value for term, value in old.items()}
        return hosts_by_task(replace(fleet, policy=replace(fleet.policy, weights=Weights(weights))).assign())
    added = amount if flip["change"] == "load-rises" else -amount
    host = fleet.snapshot.hosts[flip["host"]]
    if flip["robot"] is not None:
        link = host.links[flip["robot"]]
        link = replace(link, used_bytes_per_s=max(0.0, link.used_bytes_per_s + added))
        host = replace(host, links={**host.links, flip["robot"]: link})
    else:
        usage = host.usage[flip["term"]]
        usage = replace(usage, used=max(0.0, usage.used + added))
        host = replace(host, usage={**host.usage, flip["term"]: usage})
    hosts = {**fleet.snapshot.hosts, flip["host"]: host}
    return hosts_by_task(replace(fleet, snapshot=replace(fleet.snapshot, hosts=hosts)).assign())
