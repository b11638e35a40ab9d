# SPDX-License-Identifier: Apache-2.0
"""Limits of readings: within them every task stays where it runs, and hardly any other plan leaves all in place."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from random import Random

import pytest
from hypothesis import given, settings

from edgectl.model.assignment import Assignment, Verdict
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy, PolicyName, Preference, Weights
from edgectl.model.resource import CPU, Usage
from edgectl.model.task import Task
from edgectl.scheduler.assign import PreparedPlan, assign, prepare_plan
from edgectl.scheduler.known_plan import KnownPlan, remember_plan, stays_within
from edgectl.scheduler.stay_limits import StayLimits, find_stay_limits, keep_running_tasks
from tests.builders import (
    GI,
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_standby_rule,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.test_known_plan import LATER, changed_cases
from tests.scheduler.test_properties import Case

EDGES = ("west", "north", "east", "alpha")
ROBOTS = ("walle", "eve")
POLICIES = (
    Policy(weights=Weights(cpu=1.0, memory=1.0, network=1.0, task=1.0)),
    Policy(weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0), move_margin=0.05),
    Policy(weights=Weights(cpu=0.5, memory=1.0, network=0.0, task=1.0), move_margin=0.3, min_dwell=0.0),
    Policy(weights=Weights(cpu=0.0, memory=1.0, network=1.0, task=0.0)),
    Policy(name=PolicyName.LEAST_LOADED),
)


def list_moved(prepared: PreparedPlan, made: Assignment) -> list[str]:
    """Tasks that run, and that the plan does not leave there."""
    places = prepared.how.context.fleet.places
    running = prepared.how.initial.running
    return [
        decision.task
        for decision in made.decisions
        if decision.task in running
        and (decision.verdict, decision.host) != (Verdict.KEPT, places[running[decision.task].place].name)
    ]


def prepare(case: Case) -> tuple[PreparedPlan, KnownPlan | None, StayLimits | None]:
    prepared = prepare_plan(case.inventory, case.tasks, case.snapshot, case.memory, case.policy, NOW)
    return prepared, remember_plan(prepared), find_stay_limits(prepared)


@settings(max_examples=settings().max_examples)
@given(changed_cases())
def test_within_the_limits_nothing_leaves_its_place(pair: tuple[Case, Case]) -> None:
    case, later = pair
    prepared, known, limits = prepare(case)
    if known is None or limits is None:
        return
    used = {
        name: sample.usage["cpu"].used if sample.ok else 0.0 for name, sample in later.snapshot.hosts.items()
    }
    if stays_within(known, limits, used, later.memory):
        made = assign(
            later.inventory, later.tasks, later.snapshot, later.memory, later.policy, LATER, explain=False
        )
        assert not list_moved(prepared, made)
        kept = keep_running_tasks(prepared)
        assert [(d.task, d.verdict, d.host, d.previous_host) for d in kept.decisions] == [
            (d.task, d.verdict, d.host, d.previous_host) for d in made.decisions
        ]
        assert kept.standbys == made.standbys
        if not prepared.how.rules.moves:
            assert [d.reason for d in kept.decisions] == [d.reason for d in made.decisions]


def some_fleet(dice: Random, policy: Policy) -> Case:
    """Edges with tasks that run for long, some of them too full."""
    tasks, runs = list[Task](), {edge: dict[str, float]() for edge in EDGES}
    for number in range(dice.randint(2, 6)):
        name, cpu = f"task{9 - number}", dice.choice([0.2, 0.8, 1.5])
        robots = dice.sample(ROBOTS, dice.randint(0, 1))
        needs = [dice.choice(tasks).name] if tasks and dice.random() < 0.4 else []
        tasks.append(a_task(name, cpu=cpu, memory=0.1 * GI, throughput=4e5, robots=robots, needs=needs))
        runs[dice.choice(EDGES)][name] = cpu
    samples = {
        edge: a_sample(
            used=sum(cpus.values()) + dice.uniform(0.0, 1.0),
            used_memory=dice.uniform(0.5, 2.0) * GI,
            links={robot: a_link(6e6) for robot in ROBOTS},
            tasks={name: a_run(used=Usage(cpu=cpu, memory=0.1 * GI)) for name, cpu in cpus.items()},
        )
        for edge, cpus in runs.items()
    }
    placements = {
        name: Placement(host=edge, since=NOW - 3600.0) for edge, cpus in runs.items() for name in cpus
    }
    return Case(
        inventory=an_inventory(*map(an_edge, EDGES), *map(a_robot, ROBOTS)),
        tasks=some_tasks(*tasks, policy=policy),
        snapshot=a_snapshot({**samples, **{robot: a_sample() for robot in ROBOTS}}),
        memory=ManagerState(managed=True, placements=placements),
        policy=policy,
    )


def read_cpu(case: Case, used: dict[str, float]) -> Case:
    hosts = {
        name: replace(sample, usage={**sample.usage, "cpu": replace(sample.usage["cpu"], used=used[name])})
        for name, sample in case.snapshot.hosts.items()
    }
    return replace(case, snapshot=replace(case.snapshot, hosts=hosts))


def list_readings(case: Case, dice: Random) -> Iterator[dict[str, float]]:
    before = {name: sample.usage["cpu"].used for name, sample in case.snapshot.hosts.items()}
    for _ in range(12):
        spread = dice.choice([0.1, 0.5, 2.0])
        yield {name: min(4.0, max(0.0, used + dice.gauss(0.0, spread))) for name, used in before.items()}


@pytest.mark.parametrize("policy", POLICIES)
def test_limits_are_kept_and_hardly_too_narrow(policy: Policy) -> None:
    """Also with names in reverse order, tasks that need others, hosts within their slack, and beyond."""
    dice, seen = Random(13), Counter[tuple[bool, bool]]()
    for _ in range(25):
        case = some_fleet(dice, policy)
        prepared, known, limits = prepare(case)
        assert known is not None
        for used in list_readings(case, dice):
            within = limits is not None and stays_within(known, limits, used, case.memory)
            stays = not list_moved(prepared, read_cpu(case, used).assign())
            seen[within, stays] += 1
    assert seen[True, False] == 0
    assert seen[True, True] >= 20
    assert seen[False, True] <= seen[True, True], seen
    # Where CPU does not count, no reading of it does, but for hosts that are too full.
    assert seen[False, False] or not policy.weights[CPU.name], seen


def test_a_reading_beyond_a_limit_moves_the_task() -> None:
    """The limit is where the plan changes, to a millionth of a core."""
    policy = Policy(weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0), move_margin=0.1)
    run = a_run(used=Usage(cpu=1.0))
    case = Case(
        inventory=an_inventory(*map(an_edge, EDGES[:3])),
        tasks=some_tasks(a_task("only", cpu=1.0), policy=policy),
        snapshot=a_snapshot({"west": a_sample(used=2.0, tasks={"only": run}), "north": a_sample(used=4.0), "east": a_sample(used=3.0)}),
        memory=ManagerState(managed=True, placements={"only": Placement(host="west", since=NOW - 3600.0)}),
        policy=policy,
    )  # fmt: skip
    prepared, known, limits = prepare(case)
    assert known is not None
    assert limits is not None
    # Of 4 cores: free with the task at west 2 - x, at east 0.6, at north none; the margin is 0.4 cores.
    for used, stays in ((2.799999, True), (2.800001, False)):
        reading = {"west": used, "north": 4.0, "east": 1.4}
        assert stays_within(known, limits, reading, case.memory) is stays
        assert (not list_moved(prepared, read_cpu(case, reading).assign())) is stays
    slow = replace(case.memory, downtimes={("only", "east"): (9.0,) * 5})
    assert not stays_within(known, limits, {"west": 2.0, "north": 4.0, "east": 3.0}, slow)


@pytest.mark.parametrize("name", [name for name in PolicyName if name.startswith("static")])
def test_under_a_policy_that_moves_nothing_every_reading_is_within(name: PolicyName) -> None:
    dice = Random(5)
    case = some_fleet(dice, Policy(name=name))
    prepared, known, limits = prepare(case)
    assert known is not None
    assert limits is not None
    for used in list_readings(case, dice):
        assert stays_within(known, limits, used, case.memory)
        made = read_cpu(case, used).assign()
        assert not list_moved(prepared, made)
        assert [decision.reason for decision in keep_running_tasks(prepared).decisions] == [
            decision.reason for decision in made.decisions
        ]


@pytest.mark.parametrize(
    "changed",
    [
        {"prefer": Preference.PACK},
        {"rebalance": True},
        {"weights": Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0, latency=1.0)},
        {"name": PolicyName.PAPER},
    ],
)
def test_no_limits_where_more_than_totals_decides(changed: dict[str, object]) -> None:
    case = some_fleet(Random(1), POLICIES[0])
    assert prepare(case)[2] is not None
    assert prepare(replace(case, policy=replace(case.policy, **changed)))[2] is None  # type: ignore[arg-type]


@pytest.mark.parametrize("extra", [{"standby": a_standby_rule()}, {"hard_deadline": True}, {}])
def test_no_limits_with_a_task_that_waits_for_more(extra: dict[str, object]) -> None:
    """A copy that is placed beside it, a deadline, or a place at all."""
    case = some_fleet(Random(1), POLICIES[0])
    name, *_ = case.tasks.tasks
    changed = a_task("starts") if not extra else replace(case.tasks.tasks[name], **extra)  # type: ignore[arg-type]
    tasks = some_tasks(*{**case.tasks.tasks, changed.name: changed}.values(), policy=case.policy)
    assert prepare(replace(case, tasks=tasks))[2] is None
