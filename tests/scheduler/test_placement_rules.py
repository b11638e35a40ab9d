# SPDX-License-Identifier: Apache-2.0
"""Rules between tasks: against every placement of small fleets, and case by case."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil
from random import Random

import pytest

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Assignment, Reason, RejectionRule, Verdict
from edgectl.model.demand import ZERO
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action
from edgectl.model.policy import Policy, PolicyName, Preference
from edgectl.model.resource import Usage
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Need, NeedCondition, Task, join_units
from edgectl.views.reasons import describe_reason
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import (
    NO_MEMORY,
    decisions_by_task,
    hosts_by_task,
    ranking_by_host,
    run_assign,
    simulate_apply,
)
from tests.scheduler.tight_fleets import TightFleet, build_random_fleet

EDGES = ["edge1", "edge2", "edge3"]
THREE = an_inventory(*map(an_edge, EDGES))
IDLE = a_snapshot({edge: a_sample() for edge in EDGES})


def list_broken_rules(tasks: Sequence[Task], hosts: Mapping[str, str | None], edges: int) -> list[str]:
    """The rules that the placement ``hosts`` breaks, computed from the tasks alone."""
    placed = {task.name: host for task in tasks if (host := hosts.get(task.name)) is not None}
    broken = []
    for task in tasks:
        if task.name not in placed:
            continue
        here = [name for name, host in placed.items() if host == placed[task.name]]
        broken += [f"{task.name} apart from {other}" for other in task.apart if other in here]
        broken += [
            f"{task.name} together with {other}"
            for other in task.together
            if other in placed and other not in here
        ]
        siblings = [each.name for each in tasks if each.template == task.template]
        if task.spread and sum(name in here for name in siblings) > ceil(len(siblings) / edges):
            broken.append(f"{task.template} spread")
    return broken


def add_random_rules(fleet: TightFleet, seed: int) -> TightFleet:
    """Three tasks of one entry are spread, two pairs are apart, one pair is together."""
    dice = Random(seed)
    tasks = dict(fleet.tasks.tasks)
    names = list(tasks)
    for name in names[:3]:
        tasks[name] = replace(tasks[name], template="spread", spread="host")
    for _ in range(2):
        one, other = dice.sample(names, 2)
        tasks[one] = replace(tasks[one], apart=(*tasks[one].apart, other))
    one, other = dice.sample(names[2:], 2)
    tasks[one] = replace(tasks[one], together=(other,))
    return replace(fleet, tasks=replace(fleet.tasks, tasks=tasks))


def is_consistent(tasks: Mapping[str, Task]) -> bool:
    """Whether the validation of the files would accept the rules."""
    units = join_units(tasks)
    return not any(other in units.get(name, ()) for name, task in tasks.items() for other in task.apart)


def has_full_placement(fleet: TightFleet) -> bool:
    """Whether some placement of all tasks fits and keeps the rules: all are tried."""
    tasks = list(fleet.tasks.tasks.values())
    free = {
        edge: [usage.capacity * (1 + 1e-9) - usage.used for usage in sample.usage.values()]
        for edge, sample in fleet.snapshot.hosts.items()
    }
    demands = [[(task.demand[name] or ZERO).value for name in ("cpu", "memory")] for task in tasks]

    def place_next(hosts: tuple[str, ...]) -> bool:
        if len(hosts) == len(tasks):
            named = dict(zip((task.name for task in tasks), hosts, strict=True))
            return not list_broken_rules(tasks, named, len(free))
        needed = demands[len(hosts)]
        for edge, left in free.items():
            if all(amount <= rest for amount, rest in zip(needed, left, strict=True)):
                free[edge] = [rest - amount for amount, rest in zip(needed, left, strict=True)]
                if place_next((*hosts, edge)):
                    return True
                free[edge] = left
        return False

    return place_next(())


def test_against_every_placement_of_a_small_fleet() -> None:
    """What can be placed whole is, no rule is ever broken, and the plan stands."""
    whole, partly = 0, 0
    for seed in range(16):
        fleet = add_random_rules(build_random_fleet(3, 6, seed, 0.5 + 0.05 * (seed % 8)), seed)
        if not is_consistent(fleet.tasks.tasks):
            continue
        result = fleet.assign()
        hosts = hosts_by_task(result)
        assert not list_broken_rules(list(fleet.tasks.tasks.values()), hosts, 3), seed
        whole += None not in hosts.values()
        partly += None in hosts.values()
        assert None not in hosts.values() or not has_full_placement(fleet), seed
        snapshot, memory = simulate_apply(result, fleet.tasks, fleet.snapshot, NO_MEMORY)
        again = replace(fleet, snapshot=snapshot, memory=memory, policy=Policy(min_dwell=0.0)).assign()
        if result.settled:
            steps = diff_assignment(again, fleet.tasks, snapshot, memory)
            assert {step.action for step in steps} <= {Action.KEEP, Action.UNPLACED}, seed
    assert whole > 4 < partly + 4


@pytest.mark.parametrize("seed", range(4))
def test_a_rebalanced_plan_keeps_the_rules(seed: int) -> None:
    fleet = add_random_rules(build_random_fleet(4, 12, seed, 0.6), seed)
    if is_consistent(fleet.tasks.tasks):
        hosts = hosts_by_task(replace(fleet, policy=Policy(rebalance=True)).assign())
        assert not list_broken_rules(list(fleet.tasks.tasks.values()), hosts, 4)


def siblings(count: int, *, cpu: float = 0.5, **fields: object) -> list[Task]:
    return [a_task(f"slam-{n}", template="slam", cpu=cpu, **fields) for n in range(count)]  # type: ignore[arg-type]


def run_at(
    places: Mapping[str, str], tasks: Sequence[Task], *, since: float = 3600.0
) -> tuple[Snapshot, ManagerState]:
    """A snapshot of three edges of 4 cores in which tasks run at ``places`` and use their demand."""
    demands = {task.name: (task.demand["cpu"] or ZERO).value for task in tasks}
    memory = ManagerState(
        managed=True,
        placements={name: Placement(host=host, since=NOW - since) for name, host in places.items()},
    )
    samples = {
        edge: a_sample(
            used=sum(demands[name] for name, host in places.items() if host == edge),
            tasks={
                name: a_run(used=Usage(cpu=demands[name]), spec_hash=f"hash-{name}", started_at=NOW - since)
                for name, host in places.items()
                if host == edge
            },
        )
        for edge in EDGES
    }
    return a_snapshot(samples, memory=memory), memory


def assign_running(
    places: Mapping[str, str], *tasks: Task, since: float = 3600.0, policy: Policy | None = None,
    draining: Sequence[str] = (),
) -> Assignment:  # fmt: skip
    snapshot, memory = run_at(places, tasks, since=since)
    memory = replace(memory, draining=frozenset(draining), cordons=frozenset(draining))
    return run_assign(THREE, some_tasks(*tasks), snapshot, memory=memory, policy=policy)


def test_spread_deals_out_evenly_whatever_is_freer() -> None:
    """edge1 has 60 of 64 cores free; still no edge gets more than ceil(4 / 3) = 2, or by rack ceil(4 / 2)."""
    snapshot = replace(IDLE, hosts={**IDLE.hosts, "edge1": a_sample(cores=64.0, used=4.0)})
    plain = hosts_by_task(run_assign(THREE, some_tasks(*siblings(4, cpu=3.0)), snapshot))
    assert list(plain.values()).count("edge1") > 2
    found = run_assign(THREE, some_tasks(*siblings(4, cpu=1.0, spread="host")), snapshot)
    assert sorted(map(list(hosts_by_task(found).values()).count, EDGES)) == [1, 1, 2]
    racks = an_inventory(
        an_edge("edge1", labels={"rack": "a"}),
        an_edge("edge2", labels={"rack": "a"}),
        an_edge("edge3", labels={"rack": "b"}),
    )
    by_rack = run_assign(racks, some_tasks(*siblings(4, cpu=1.0, spread="rack")), snapshot)
    assert list(hosts_by_task(by_rack).values()).count("edge3") == 2


def test_a_drained_host_is_none_to_spread_over() -> None:
    """Two of three edges are left, so 2 of 3 tasks may share one."""
    found = assign_running({}, *siblings(3, spread="host"), draining=["edge3"])
    assert sorted(str(host) for host in hosts_by_task(found).values()) in (
        ["edge1", "edge1", "edge2"],
        ["edge1", "edge2", "edge2"],
    )


def test_apart_counts_for_both_and_names_the_other() -> None:
    tasks = some_tasks(a_task("a", cpu=0.1), a_task("b", cpu=0.1, apart=("a",), only=["edge1", "edge2"]))
    decisions = decisions_by_task(assign_pinned := run_assign(THREE, tasks, IDLE))
    assert (decisions["a"].host, decisions["b"].host) == ("edge1", "edge2")
    rejected = ranking_by_host(decisions["b"])["edge1"].rejections[0]
    assert (rejected.rule, rejected.task) == (RejectionRule.APART, "a")
    steps = diff_assignment(assign_pinned, tasks, IDLE, NO_MEMORY)
    assert describe_reason(steps[1]) == "start: the only host that fits"


def test_tasks_that_go_together_are_placed_where_all_have_room() -> None:
    """a alone would go to edge1 (3.5 free), but b needs 2 more: 3.9 fit on edge3 only."""
    snapshot = a_snapshot(
        edge1=a_sample(used=0.5), edge2=a_sample(used=0.6), edge3=a_sample(cores=5.0, used=1.05)
    )
    tasks = some_tasks(a_task("a", cpu=1.9), a_task("b", cpu=2.0, together=("a",)), a_task("c", cpu=0.2))
    found = decisions_by_task(run_assign(THREE, tasks, snapshot))
    assert (found["a"].host, found["b"].host) == ("edge3", "edge3")
    assert (found["b"].reason, found["b"].subject) == (Reason.TOGETHER, "a")
    # c comes last; were b's room not kept, a task that comes between a and b could take it
    between = some_tasks(
        a_task("a", cpu=1.9, priority=2.0),
        a_task("b", cpu=2.0, together=("a",)),
        a_task("x", cpu=2.0, priority=1.0, only=["edge3"]),
    )
    assert hosts_by_task(run_assign(THREE, between, snapshot)) == {"a": "edge3", "b": "edge3", "x": None}


BREAKS = (a_task("a", cpu=0.5), a_task("b", cpu=0.5, apart=("a",)))


@pytest.mark.parametrize(
    ("since", "policy", "host", "reason"),
    [
        (3600.0, Policy(), "edge2", Reason.FORCED_RULE),
        (60.0, Policy(), "edge1", Reason.DWELL),
        (3600.0, Policy(attended=False, max_moves=0), "edge1", Reason.MAX_MOVES),
    ],
)
def test_a_rule_that_is_added_later_moves_within_dwell_and_max_moves(
    since: float, policy: Policy, host: str, reason: Reason
) -> None:
    """a and b run on edge1; the later in the sequence leaves."""
    found = decisions_by_task(
        assign_running({"a": "edge1", "b": "edge1"}, *BREAKS, since=since, policy=policy)
    )
    assert (found["a"].host, found["b"].host, found["b"].reason) == ("edge1", host, reason)


def test_where_nothing_else_fits_a_broken_rule_stops_nobody() -> None:
    tasks = (BREAKS[0], a_task("b", cpu=0.5, apart=("a",), only=["edge1"]))
    found = decisions_by_task(assign_running({"a": "edge1", "b": "edge1"}, *tasks))
    assert (found["b"].host, found["b"].verdict) == ("edge1", Verdict.KEPT)


PAIR = (a_task("a", cpu=1.0), a_task("b", cpu=1.0, together=("a",)))


def test_a_unit_leaves_a_drained_host_as_one() -> None:
    found = assign_running(
        {"a": "edge1", "b": "edge1"}, *PAIR, draining=["edge1"], policy=Policy(attended=False)
    )
    hosts = set(hosts_by_task(found).values())
    assert len(hosts) == 1
    assert hosts < {"edge2", "edge3"}


def test_a_unit_counts_as_one_move_when_its_host_is_overloaded() -> None:
    snapshot, memory = run_at({"a": "edge1", "b": "edge1"}, PAIR)
    snapshot = replace(snapshot, hosts={**snapshot.hosts, "edge1": replace(
        snapshot.hosts["edge1"], usage=a_sample(used=5.0).usage)})  # fmt: skip
    policy = Policy(attended=False, max_moves=1)
    found = run_assign(THREE, some_tasks(*PAIR), snapshot, memory=memory, policy=policy)
    assert hosts_by_task(found) == {"a": "edge2", "b": "edge2"}
    late = replace(memory, placements={**memory.placements, "b": Placement(host="edge1", since=NOW - 30.0)})
    found = run_assign(THREE, some_tasks(*PAIR), snapshot, memory=late, policy=policy)
    assert set(hosts_by_task(found).values()) == {"edge1"}
    assert decisions_by_task(found)["a"].reason is Reason.DWELL


def test_a_unit_that_runs_does_not_move_for_a_gain() -> None:
    snapshot, memory = run_at({"a": "edge1", "b": "edge1"}, PAIR)
    alone = run_assign(
        THREE,
        some_tasks(PAIR[0], a_task("b", cpu=1.0)),
        snapshot,
        memory=memory,
        policy=Policy(move_margin=0.0),
    )
    assert set(hosts_by_task(alone).values()) != {"edge1"}
    found = run_assign(THREE, some_tasks(*PAIR), snapshot, memory=memory, policy=Policy(move_margin=0.0))
    assert set(hosts_by_task(found).values()) == {"edge1"}


def test_others_make_room_for_a_task_that_joins_a_unit() -> None:
    """a runs on edge1 with x (2 cores); b (1.5) must join it, so x goes elsewhere."""
    tasks = (a_task("a", cpu=1.0), a_task("b", cpu=1.5, together=("a",)), a_task("x", cpu=2.0))
    found = assign_running({"a": "edge1", "x": "edge1"}, *tasks)
    assert (hosts_by_task(found)["a"], hosts_by_task(found)["b"]) == ("edge1", "edge1")
    assert decisions_by_task(found)["x"].reason is Reason.MADE_ROOM


def test_a_group_is_placed_whole_or_not_at_all() -> None:
    """Three edges of 4 cores hold three tasks of 3 cores: the group of two fits, that of four does not."""
    pair = [a_task(f"p{n}", cpu=3.0, group="pair") for n in range(2)]
    four = [a_task(f"f{n}", cpu=3.0, group="four") for n in range(4)]
    found = run_assign(THREE, some_tasks(*pair, *four, a_task("z", cpu=3.0)), IDLE)
    hosts = hosts_by_task(found)
    assert {name for name, host in hosts.items() if host} == {"p0", "p1", "z"}
    reasons = {name: decision.reason for name, decision in decisions_by_task(found).items()}
    assert [reasons[f"f{n}"] for n in range(4)].count(Reason.NO_FEASIBLE_HOST) >= 1
    withheld = [decision for decision in found.decisions if decision.reason is Reason.GROUP]
    assert all(hosts[str(decision.subject)] is None for decision in withheld)
    steps = diff_assignment(found, some_tasks(*pair, *four), IDLE, NO_MEMORY)
    assert {step.action for step in steps if step.task.startswith("f")} == {Action.UNPLACED}


def test_what_runs_of_an_incomplete_group_goes_on() -> None:
    tasks = [a_task(f"g{n}", cpu=3.0, group="g") for n in range(4)]
    found = assign_running({"g0": "edge1"}, *tasks)
    assert hosts_by_task(found) == {"g0": "edge1", "g1": None, "g2": None, "g3": None}
    assert decisions_by_task(found)["g0"].verdict is Verdict.KEPT


def test_a_group_does_not_wait_for_a_member_that_waits_for_a_job_of_it() -> None:
    tasks = some_tasks(
        a_task("job", cpu=1.0, group="g"),
        a_task("next", cpu=1.0, group="g", needs=[Need(task="job", until=NeedCondition.COMPLETED)]),
    )
    assert hosts_by_task(run_assign(THREE, tasks, IDLE)) == {"job": "edge1", "next": None}


def test_groups_against_every_placement_of_a_small_fleet() -> None:
    """A group that fits beside all others is placed; of none is only a part."""
    for seed in range(8):
        fleet = build_random_fleet(3, 6, seed, 0.75 + 0.05 * (seed % 6))
        tasks = {
            name: replace(task, group="g" if index % 2 else None)
            for index, (name, task) in enumerate(fleet.tasks.tasks.items())
        }
        fleet = replace(fleet, tasks=replace(fleet.tasks, tasks=tasks))
        hosts = hosts_by_task(fleet.assign())
        placed = {hosts[name] is not None for name, task in tasks.items() if task.group}
        assert len(placed) == 1, seed
        assert None not in hosts.values() or not has_full_placement(fleet), seed


def test_prefer_pack_fills_hosts_one_after_the_other() -> None:
    tasks = some_tasks(*(a_task(f"t{n}", cpu=1.0) for n in range(6)), policy=Policy(prefer=Preference.PACK))
    snapshot = replace(IDLE, hosts={**IDLE.hosts, "edge2": a_sample(used=0.5)})
    hosts = list(hosts_by_task(run_assign(THREE, tasks, snapshot)).values())
    assert [hosts.count(edge) for edge in EDGES] == [3, 3, 0]
    spread = list(hosts_by_task(run_assign(THREE, replace(tasks, policy=Policy()), snapshot)).values())
    assert [spread.count(edge) for edge in EDGES] == [2, 2, 2]
    settled, memory = simulate_apply(run_assign(THREE, tasks, snapshot), tasks, snapshot, NO_MEMORY)
    again = run_assign(THREE, tasks, settled, memory=memory, policy=replace(tasks.policy, min_dwell=0.0))
    assert list(hosts_by_task(again).values()) == hosts


def test_policy_paper_knows_no_rules() -> None:
    plain = some_tasks(*siblings(3), a_task("b"), policy=Policy(name=PolicyName.PAPER))
    ruled = some_tasks(
        *siblings(3, spread="host", group="g"), a_task("b", apart=("slam-0",)),
        policy=Policy(name=PolicyName.PAPER, prefer=Preference.PACK),
    )  # fmt: skip
    assert run_assign(THREE, plain, IDLE).decisions == run_assign(THREE, ruled, IDLE).decisions
