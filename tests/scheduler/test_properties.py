"""Properties that hold for every fleet (safety: a bad thing never happens)."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from random import Random
from typing import TypeVar

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Assignment, Decision, RankedHost, Reason, Verdict
from edgectl.model.inventory import Host, Inventory
from edgectl.model.manager_state import ManagerState, MeasuredDemand
from edgectl.model.plan import Action, Step
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import OnboardRule, Task, Tasks
from edgectl.scheduler import settle
from edgectl.scheduler.assign import assign
from tests.builders import (
    GI,
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)
from tests.scheduler.fleets import decisions_by_task, hosts_by_task, simulate_apply

Value = TypeVar("Value")

ROBOTS = ("robot1", "robot2")
quick = settings(max_examples=settings().max_examples * 3 // 5)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Case:
    """The input of one decision."""

    inventory: Inventory
    tasks: Tasks
    snapshot: Snapshot
    memory: ManagerState
    policy: Policy

    def assign(self) -> Assignment:
        return assign(self.inventory, self.tasks, self.snapshot, self.memory, self.policy, NOW)


shares = st.floats(0.0, 1.0, allow_nan=False).map(lambda value: round(value, 3))
amounts = st.one_of(st.none(), shares, shares.map(lambda value: f"{value * 100}%"))
weights = (
    st.tuples(*[st.sampled_from([0.0, 0.1, 0.3, 1.0])] * 4)
    .filter(any)
    .map(lambda w: Weights(cpu=w[0], memory=w[1], network=w[2], task=w[3]))
)


@st.composite
def some_task(draw: st.DrawFn, number: int) -> Task:
    earlier = [f"task{n}" for n in range(number)]
    memory = draw(amounts)
    throughput = draw(amounts)
    return a_task(
        f"task{number}",
        cpu=draw(amounts),
        memory=memory * 2 * GI if isinstance(memory, float) else memory,
        throughput=throughput * 4e6 if isinstance(throughput, float) else throughput,
        robots=draw(st.lists(st.sampled_from(ROBOTS), unique=True, max_size=2)),
        needs=draw(st.lists(st.sampled_from(earlier), unique=True, max_size=2)) if earlier else [],
        never=draw(st.lists(st.sampled_from(["edge1", "edge2"]), max_size=1)),
        onboard=draw(st.sampled_from(OnboardRule)),
        priority=draw(st.sampled_from([0.0, 1.0])),
        managed=draw(st.sampled_from([True, True, True, False])),
        downtime_cost=draw(st.sampled_from([0.0, 1.0, 10.0])),
    )


@st.composite
def some_history(draw: st.DrawFn) -> MeasuredDemand:
    throughput = draw(st.none() | shares)
    return MeasuredDemand(
        samples=draw(st.sampled_from([59, 60, 412])), span_s=draw(st.sampled_from([299.0, 300.0])), used={"cpu": draw(shares), "memory": draw(shares) * 2 * GI, **({} if throughput is None else {"network": throughput * 4e6})},
    )  # fmt: skip


@st.composite
def a_host_sample(draw: st.DrawFn, host: Host, running: dict[str, TaskSample]) -> HostSample:
    if draw(st.integers(0, 9)) == 0:
        return silent(host.role)
    links = {
        robot: a_link(draw(st.sampled_from([0.0, 6e6, 9e6])), draw(shares) * 6e6)
        for robot in ROBOTS
        if draw(st.integers(0, 9))
    }
    return a_sample(
        cores=draw(st.sampled_from([2.0, 4.0])), used=draw(shares) * 4, used_memory=draw(shares) * 4 * GI, links=links, tasks=running, role=host.role,
    )  # fmt: skip


@st.composite
def cases(draw: st.DrawFn) -> Case:
    edges = [
        an_edge(f"edge{n}", cpu_limit=draw(st.sampled_from([0.8, 1.0, 1.2])))
        for n in range(1, draw(st.integers(1, 5)) + 1)
    ]
    robots = [a_robot(robot, onboard=draw(st.booleans())) for robot in ROBOTS]
    tasks = [draw(some_task(n)) for n in range(draw(st.integers(1, 7)))]
    running: dict[str, dict[str, TaskSample]] = {host.name: {} for host in (*edges, *robots)}
    for name in [*(task.name for task in tasks), "left", "foreign"]:
        for host in (
            draw(st.lists(st.sampled_from(sorted(running)), max_size=2, unique=True))
            if draw(st.booleans())
            else ()
        ):
            running[host][name] = a_run(
                draw(st.sampled_from(TaskState)), used=Usage(cpu=draw(shares), memory=draw(shares) * GI, network=draw(shares) * 1e6),
                managed=name != "foreign",
            )  # fmt: skip
    samples = {host.name: draw(a_host_sample(host, running[host.name])) for host in (*edges, *robots)}
    memory = ManagerState(
        managed=draw(st.booleans()),
        cordons=frozenset(draw(st.sets(st.sampled_from(["edge1"])))),
        draining=frozenset(draw(st.sets(st.sampled_from(["edge2"])))),
        done={task.name: task.spec_hash for task in tasks if draw(st.integers(0, 9)) == 0},
        downtimes={
            (task.name, draw(st.sampled_from(edges)).name): (draw(st.sampled_from([0.5, 5.0])),)
            * draw(st.integers(4, 5))
            for task in tasks
        },
        stays={
            task.name: (draw(st.sampled_from([30.0, 300.0, 3000.0])),)
            for task in tasks
            if draw(st.booleans())
        },
        measured={
            (task.name, kind): draw(some_history())
            for task in tasks
            if draw(st.booleans())
            for kind in draw(st.lists(st.sampled_from(["2c-4Gi", "4c-4Gi"]), unique=True))
        },
    )
    policy = Policy(
        weights=draw(weights),
        min_dwell=draw(st.sampled_from([0.0, 120.0])),
        move_margin=draw(st.sampled_from([0.0, 0.1])),
    )
    return Case(
        inventory=an_inventory(*edges, *robots),
        tasks=some_tasks(*tasks),
        snapshot=a_snapshot(samples),
        memory=memory,
        policy=policy,
    )


# Nine tenths of the time of an example are its fleet: one is drawn for all of these.
@given(cases())
def test_what_holds_for_every_assignment(case: Case) -> None:
    found = case.assign()
    for check in (
        check_limits,
        check_decisions_and_totals,
        check_ranks_and_leads,
        check_stops,
        check_held_tasks,
        check_kept_tasks,
    ):
        check(case, found)


def check_limits(case: Case, found: Assignment) -> None:
    """No limit is exceeded by a placement."""
    for decision in found.decisions:
        if decision.verdict is Verdict.PLACED:
            chosen = next(entry for entry in decision.ranking if entry.host == decision.host)
            values = (chosen.terms["cpu"], chosen.terms["memory"], chosen.terms["network"])
            if decision.reason is Reason.RELIEF:
                # Nothing fits anywhere: a running task moves only to where less is missing (ADR 62).
                before = next(entry for entry in decision.ranking if entry.host == decision.previous_host)
                assert least_free(chosen) > least_free(before)
                continue
            assert chosen.feasible
            assert all(value is not None and value >= -1e-9 for value in values)


def least_free(entry: RankedHost) -> float:
    """The smallest term of a host's capacity; negative where the task exceeds it."""
    return min(entry.terms[name] or 0.0 for name in ("cpu", "memory", "network"))


def check_decisions_and_totals(case: Case, found: Assignment) -> None:
    """Each task is decided once, and a total lies between its terms."""
    assert sorted(decision.task for decision in found.decisions) == sorted(case.tasks.tasks)
    for decision in found.decisions:
        assert len({entry.host for entry in decision.ranking}) == len(decision.ranking)
        for entry in decision.ranking:
            values = (entry.terms["cpu"], entry.terms["memory"], entry.terms["network"], entry.terms["task"])
            if entry.total is not None:
                known = [value for value in values if value is not None]
                assert min(known) - 1e-9 <= entry.total <= max(known) + 1e-9


def check_ranks_and_leads(case: Case, found: Assignment) -> None:
    """Rank 1 is the argmax, and leads are what they say."""
    for decision in found.decisions:
        feasible = [entry for entry in decision.ranking if entry.feasible]
        assert [entry.rank for entry in feasible] == list(range(1, len(feasible) + 1))
        totals = [entry.total or 0.0 for entry in feasible]
        assert all(one >= other - 1e-9 for one, other in pairwise(totals))
        others = [entry.total or 0.0 for entry in feasible if entry.host != decision.host]
        if decision.total is not None and others:
            assert decision.lead is not None
            assert abs(decision.lead - (decision.total - max(others))) < 1e-9


def check_stops(case: Case, found: Assignment) -> None:
    """Nothing unmanaged is ever stopped, and nothing runs twice."""
    for step in diff_assignment(found, case.tasks, case.snapshot, case.memory):
        task = case.tasks.tasks.get(step.task)
        assert step.task != "foreign"
        if task is not None and not task.managed:
            assert not step.action.changes
            assert not step.stop
        if step.action is Action.STOP and step.decision.reason is Reason.PREEMPTED:
            assert task is not None
            assert any(has_made_way(case, task, other) for other in found.decisions)
        elif step.action is Action.STOP:
            assert step.task == "left"
        running = {
            host
            for host, sample in case.snapshot.hosts.items()
            if sample.ok and step.task in sample.tasks and sample.tasks[step.task].state.alive
        }
        if (
            task is not None
            and task.managed
            and step.action in (Action.START, Action.MOVE, Action.KEEP, Action.RESTART)
        ):
            goes = {*step.stop, step.decision.previous_host if step.action is Action.MOVE else None}
            assert running - goes <= {step.decision.host}


def has_made_way(case: Case, task: Task, other: Decision) -> bool:
    """Whether ``other`` may have taken the place of ``task``."""
    newcomer = case.tasks.tasks[other.task]
    return other.verdict is Verdict.PLACED and newcomer.priority > task.priority and newcomer.preempt


def check_held_tasks(case: Case, found: Assignment) -> None:
    """Held tasks and frozen fleets do not move."""
    for decision in decisions_by_task(found).values():
        if found.frozen and decision.previous_host is not None and decision.verdict is not Verdict.COMPLETED:
            assert decision.host == decision.previous_host
        if decision.reason in (Reason.GAIN, Reason.GAIN_OVER_COST):
            assert decision.amount is not None
            assert (decision.cost is None) == (decision.reason is Reason.GAIN)


def check_kept_tasks(case: Case, found: Assignment) -> None:
    """What is kept would gain no more than a move costs."""
    for decision in found.decisions:
        if decision.reason in (Reason.BELOW_MARGIN, Reason.COST_ABOVE_GAIN):
            challenger = next(entry for entry in decision.ranking if entry.host == decision.challenger)
            needed = case.policy.move_margin if decision.cost is None else decision.cost.needed
            assert (challenger.total or 0.0) - (decision.total or 0.0) <= needed + 1e-9


@quick
@given(cases(), st.randoms(use_true_random=False))
def test_the_order_of_the_files_is_irrelevant(case: Case, dice: Random) -> None:
    def shuffled(mapping: Mapping[str, Value]) -> dict[str, Value]:
        items = list(mapping.items())
        dice.shuffle(items)
        return dict(items)

    other = replace(
        case,
        inventory=replace(case.inventory, hosts=shuffled(case.inventory.hosts)),
        tasks=replace(case.tasks, tasks=shuffled(case.tasks.tasks)),
        snapshot=replace(case.snapshot, hosts=shuffled(case.snapshot.hosts)),
    )
    assert repr(other.assign()) == repr(case.assign())


@quick
@given(cases(), st.sampled_from([0.5, 2.0, 8.0]))
def test_scaled_weights_are_the_same_weights(case: Case, factor: float) -> None:
    w = case.policy.weights
    scaled = Weights({term: weight * factor for term, weight in w.items()})
    assert repr(replace(case, policy=replace(case.policy, weights=scaled)).assign()) == repr(case.assign())


@quick
@given(cases(), st.floats(0.01, 2.0))
def test_utility_falls_as_load_rises(case: Case, more: float) -> None:
    tasks = some_tasks(replace(next(iter(case.tasks.tasks.values())), needs=(), managed=True))
    one = replace(
        case,
        tasks=tasks,
        policy=replace(case.policy, weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0)),
    )
    sample = one.snapshot.hosts["edge1"]
    assume(sample.measured)
    cpu = sample.usage["cpu"]
    heavier = replace(sample, usage={**sample.usage, "cpu": replace(cpu, used=cpu.used + more)})
    after = replace(one, snapshot=replace(one.snapshot, hosts={**one.snapshot.hosts, "edge1": heavier}))
    pairs = zip(_list_cpu_terms(one.assign(), "edge1"), _list_cpu_terms(after.assign(), "edge1"), strict=True)
    # own use beyond the measured load is floored at 0, so very small loads may be equal
    assert all(low <= high + 1e-12 for high, low in pairs)


def _list_cpu_terms(assignment: Assignment, host: str) -> list[float]:
    return [
        entry.terms["cpu"]
        for d in assignment.decisions
        for entry in d.ranking
        if entry.host == host and entry.terms["cpu"] is not None
    ]


@quick
@given(cases())
def test_a_plan_after_the_apply_of_a_settled_plan_changes_nothing(case: Case) -> None:
    first = case.assign()
    assume(first.settled)
    snapshot, memory = simulate_apply(first, case.tasks, case.snapshot, case.memory)
    again = replace(case, snapshot=snapshot, memory=memory).assign()
    assert hosts_by_task(again) == hosts_by_task(first)
    steps = diff_assignment(again, case.tasks, snapshot, memory)
    assert {step.action for step in steps} <= {Action.KEEP, Action.HOLD, Action.UNPLACED, Action.NONE}
    assert not any(step.stop for step in steps)


@quick
@given(cases(), st.sampled_from(PolicyName), st.booleans(), st.booleans())
def test_every_policy_decides_every_task(
    case: Case, name: PolicyName, best_effort: bool, attended: bool
) -> None:
    policy = replace(case.policy, name=name, best_effort=best_effort, attended=attended)
    found = replace(case, policy=policy).assign()
    assert sorted(decision.task for decision in found.decisions) == sorted(case.tasks.tasks)
    for step in diff_assignment(found, case.tasks, case.snapshot, case.memory):
        if step.action is Action.MOVE:
            assert step.decision.previous_host in step.instances
    for decision in found.decisions:
        if decision.verdict is Verdict.PLACED:
            assert decision.total is not None
        moves = [d for d in found.decisions if d.reason in (Reason.GAIN, Reason.GAIN_OVER_COST)]
        if not attended and name is PolicyName.UTILITY and found.settled:
            assert len(moves) <= (policy.max_moves or 0)


@quick
@given(cases(), st.sampled_from(PolicyName))
def test_a_plan_without_numbers_puts_every_task_where_the_explained_one_does(
    case: Case, policy: PolicyName
) -> None:
    used = replace(case.policy, name=policy)
    given_ = (case.inventory, case.tasks, case.snapshot, case.memory, used, NOW)
    full, plain = assign(*given_), assign(*given_, explain=False)
    assert _list_outcomes(plain) == _list_outcomes(full)
    assert plain.settled == full.settled
    assert [(step.task, step.action, step.stop) for step in _diff(case, plain)] == [
        (step.task, step.action, step.stop) for step in _diff(case, full)
    ]


@quick
@given(cases(), st.sampled_from(PolicyName))
def test_a_pass_that_is_taken_to_repeat_itself_does(case: Case, policy: PolicyName) -> None:
    used = replace(case.policy, name=policy)
    given_ = (case.inventory, case.tasks, case.snapshot, case.memory, used, NOW)
    short = assign(*given_)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settle, "repeats_itself", lambda *_: False)
        assert repr(assign(*given_)) == repr(short)


def _list_outcomes(assignment: Assignment) -> list[tuple[str, Verdict, str | None, str | None]]:
    return [(each.task, each.verdict, each.host, each.previous_host) for each in assignment.decisions]


def _diff(case: Case, assignment: Assignment) -> tuple[Step, ...]:
    return diff_assignment(assignment, case.tasks, case.snapshot, case.memory)
