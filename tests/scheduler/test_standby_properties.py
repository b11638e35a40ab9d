# SPDX-License-Identifier: Apache-2.0
"""Properties of inactive copies that hold for every fleet."""

from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.model.assignment import Assignment, Decision, Reason, Verdict
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, TaskSample, TaskState
from edgectl.model.standby_plan import StandbyAction, StandbyReason, StandbyStep
from edgectl.model.task import OnboardRule, Task
from tests.builders import (
    GI,
    NOW,
    a_run,
    a_sample,
    a_snapshot,
    a_standby_rule,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import decisions_by_task, simulate_apply
from tests.scheduler.test_properties import Case, Value, cases, shares

quick = settings(max_examples=settings().max_examples * 3 // 5)


standby_rules = st.builds(
    a_standby_rule,
    hosts=st.integers(1, 3),
    cpu=st.sampled_from([None, 0.0, 0.1, "10%"]),
    memory=st.sampled_from([None, 0.3 * GI, GI, "20%"]),
)


@st.composite
def roomy_cases(draw: st.DrawFn) -> Case:
    """Tasks that have room on most edges; most run, and most have copies."""
    edges = [f"edge{number}" for number in range(1, draw(st.integers(2, 5)) + 1)]
    runs: dict[str, dict[str, TaskSample]] = {edge: {} for edge in edges}
    copies: dict[str, dict[str, TaskSample]] = {edge: {} for edge in edges}
    tasks = []
    for number in range(draw(st.integers(1, 5))):
        task = a_task(
            f"task{number}",
            cpu=draw(st.sampled_from([0.1, 0.5, 1.0])),
            memory=draw(st.sampled_from([0.2, 0.5])) * GI,
            standby=draw(standby_rules),
        )
        tasks.append(task)
        there = draw(st.permutations(edges))[: draw(st.integers(1, 3))]
        for host in there[1:]:
            copies[host][task.name] = draw(some_copy(task))
        if draw(st.integers(0, 4)):
            runs[there[0]][task.name] = a_run(
                used=Usage(cpu=0.4, memory=0.3 * GI), spec_hash=task.spec_hash, instance=task.name, links={}
            )
    samples = {
        edge: a_sample(
            used=draw(shares) * 2
            + sum(each.used["cpu"] for each in (*runs[edge].values(), *copies[edge].values())),
            used_memory=draw(shares) * 3 * GI
            + sum(each.used["memory"] for each in (*runs[edge].values(), *copies[edge].values())),
            tasks=runs[edge],
            standbys=copies[edge],
        )
        for edge in edges
    }
    return Case(
        inventory=an_inventory(*map(an_edge, edges)),
        tasks=some_tasks(*tasks),
        snapshot=a_snapshot(samples),
        memory=ManagerState(managed=True, cordons=frozenset(draw(st.sets(st.just("edge1"))))),
        policy=Policy(
            min_dwell=draw(st.sampled_from([0.0, 120.0])), move_margin=draw(st.sampled_from([0.0, 0.1]))
        ),
    )


@st.composite
def some_copy(draw: st.DrawFn, task: Task) -> TaskSample:
    use = draw(shares)
    return a_run(
        draw(st.sampled_from([TaskState.READY, TaskState.READY, TaskState.STARTING, TaskState.FAILED])),
        used=Usage(cpu=0.1 * use, memory=0.5 * use * GI),
        instance=f"copy-of-{task.name}",
        spec_hash=task.spec_hash if use < 0.9 else "older",
        started_at=NOW - draw(st.sampled_from([5, 60, 3600])),
        given_up=draw(st.booleans()),
        links={},
    )


@st.composite
def mixed_cases(draw: st.DrawFn) -> Case:
    """A fleet in which some tasks ask for copies, and some hosts have one."""
    case = draw(cases())
    tasks = [draw(with_standby(task)) for task in case.tasks.tasks.values()]
    samples = {host: draw(with_specs(sample)) for host, sample in case.snapshot.hosts.items()}
    for task in tasks:
        if task.standby is None and draw(st.integers(0, 4)):
            continue
        for host in draw(st.lists(st.sampled_from(sorted(samples)), max_size=2, unique=True)):
            if samples[host].ok and task.name not in samples[host].tasks:
                samples[host] = add_copy(
                    samples[host], task, draw(shares), draw(st.sampled_from([5, 60, 3600]))
                )
    return replace(case, tasks=some_tasks(*tasks), snapshot=replace(case.snapshot, hosts=samples))


@st.composite
def with_specs(draw: st.DrawFn, sample: HostSample) -> HostSample:
    """Most runs are of the present specification, and can become copies."""
    runs = {
        name: replace(run, spec_hash=f"hash-{name}" if draw(st.integers(0, 4)) else "older")
        for name, run in sample.tasks.items()
    }
    return replace(sample, tasks=runs)


@st.composite
def with_standby(draw: st.DrawFn, task: Task) -> Task:
    """Most of those that may have copies ask for some."""
    task = replace(task, onboard=OnboardRule.ALLOW) if draw(st.booleans()) else task
    if not task.managed or task.onboard is OnboardRule.ONLY or not draw(st.integers(0, 3)):
        return task
    return replace(task, standby=draw(standby_rules))


def add_copy(sample: HostSample, task: Task, use: float, age: float) -> HostSample:
    """Return ``sample`` with a copy of ``task``, which uses a part of the measured load."""
    copy = a_run(
        TaskState.READY if use < 0.9 else TaskState.FAILED,
        used=Usage(cpu=0.2 * use, memory=use * GI),
        instance=f"copy-of-{task.name}",
        spec_hash=task.spec_hash if use < 0.8 else "older",
        started_at=NOW - age,
        links={},
    )
    usage = {name: replace(each, used=each.used + copy.used[name]) for name, each in sample.usage.items()}
    return replace(sample, usage=usage, standbys={**sample.standbys, task.name: copy})


def drop_copies(case: Case) -> Case:
    """Return the fleet without copies, and without a task that asks for one."""
    tasks = [replace(task, standby=None) for task in case.tasks.tasks.values()]
    samples = {name: drop_load(sample) for name, sample in case.snapshot.hosts.items()}
    return replace(case, tasks=some_tasks(*tasks), snapshot=replace(case.snapshot, hosts=samples))


def drop_load(sample: HostSample) -> HostSample:
    alive = [copy for copy in sample.standbys.values() if copy.state.alive]
    usage = {
        name: replace(each, used=max(0.0, each.used - sum(copy.used[name] for copy in alive)))
        for name, each in sample.usage.items()
    }
    return replace(sample, usage=usage, standbys={})


def list_steps(found: Assignment) -> list[tuple[str, StandbyStep]]:
    return [(task, step) for task, steps in found.standbys.items() for step in steps]


standby_cases = st.one_of(roomy_cases(), roomy_cases(), mixed_cases())


@given(standby_cases)
def test_what_holds_for_every_copy(case: Case) -> None:
    found = case.assign()
    decisions = decisions_by_task(found)
    for name, steps in found.standbys.items():
        check_steps_of_task(case, found, decisions[name], steps)
    check_reservations(case, found)


def check_steps_of_task(
    case: Case, found: Assignment, decision: Decision, steps: tuple[StandbyStep, ...]
) -> None:
    """A copy is never on the host of its task, never twice on one, and not on more than were asked for."""
    task = case.tasks.tasks[decision.task]
    after = [step.host for step in steps if step.action.stays]
    assert len(after) == len(set(after))
    assert decision.host not in after
    asked = task.standby.hosts if task.standby is not None else 0
    if decision.verdict is not Verdict.HELD:
        assert len(after) <= asked
    if decision.verdict in (Verdict.UNPLACED, Verdict.COMPLETED):
        assert not after
    for step in steps:
        present = step.host is not None and task.name in case.snapshot.hosts[step.host].standbys
        if step.action in (
            StandbyAction.KEEP,
            StandbyAction.STOP,
            StandbyAction.RESTART,
            StandbyAction.ACTIVATE,
        ):
            assert present
            assert step.instance
        if step.action is StandbyAction.ACTIVATE:
            assert step.host == decision.host
        if step.action is StandbyAction.DEACTIVATE:
            assert step.host == decision.previous_host
        if step.action is StandbyAction.START and step.host is not None:
            assert (
                not case.snapshot.hosts[step.host]
                .standbys.get(task.name, a_run(TaskState.FAILED))
                .state.alive
            )
            assert task.hosts.allow(step.host, {})
            assert not found.frozen
    stops = [step.action is StandbyAction.STOP for step in steps]
    assert stops == sorted(stops, reverse=True)


def check_reservations(case: Case, found: Assignment) -> None:
    """No copy brings the memory that is expected on a host above its limit; and every one is in it."""
    for name, sample in case.snapshot.hosts.items():
        copies = [step for _, step in list_steps(found) if step.host == name and step.action.stays]
        reserved = sum(step.demand["memory"] for step in copies)
        free_to_choose = [step for step in copies if step.reason is not StandbyReason.HELD]
        if any(step.demand["memory"] for step in free_to_choose) and name in found.expected:
            limit = sample.usage["memory"].capacity * case.inventory.hosts[name].limits["memory"]
            held = sum(step.demand["memory"] for step in copies) - sum(
                step.demand["memory"] for step in free_to_choose
            )
            assert found.expected[name].used["memory"] <= limit + held + 1.0
        assert name not in found.expected or found.expected[name].used["memory"] >= reserved - 1.0


@given(standby_cases)
def test_copies_never_change_where_a_task_is_placed(case: Case) -> None:
    """But for a task whose active instance is gone: it goes where a copy waits."""
    found, plain = case.assign(), drop_copies(case).assign()
    activated = {each.task for each in found.decisions if each.reason is Reason.STANDBY_ACTIVATED}
    activated |= {task for task, step in list_steps(found) if step.action is StandbyAction.ACTIVATE}
    if not activated:
        assert [strip(each) for each in found.decisions] == [strip(each) for each in plain.decisions]


def strip(decision: Decision) -> tuple[object, ...]:
    return decision.task, decision.verdict, decision.reason, decision.host, decision.previous_host


@given(standby_cases)
def test_an_activation_is_of_a_task_that_ran_nowhere(case: Case) -> None:
    for decision in case.assign().decisions:
        if decision.reason is Reason.STANDBY_ACTIVATED:
            assert decision.verdict is Verdict.PLACED
            chosen = next(each for each in decision.ranking if each.host == decision.host)
            assert chosen.feasible
            copy = case.snapshot.hosts[decision.host or ""].standbys[decision.task]
            assert copy.spec_hash == case.tasks.tasks[decision.task].spec_hash


@given(standby_cases)
def test_a_settled_plan_is_done_once_it_is_applied(case: Case) -> None:
    case = without_use(case)
    found = case.assign()
    if not found.settled:
        return
    snapshot, memory = simulate_apply(found, case.tasks, case.snapshot, case.memory)
    again = replace(case, snapshot=snapshot, memory=memory).assign()
    if [strip(each)[3] for each in again.decisions] != [each.host for each in found.decisions]:
        return  # what makes a plan of tasks alone change is not about copies
    before = {(task, step.host) for task, step in list_steps(found) if step.action.stays}
    after = {(task, step.host) for task, step in list_steps(again) if step.action.stays}
    assert after == before
    assert not any(step.action.changes for _, step in list_steps(again))


def without_use(case: Case) -> Case:
    """Return the case with runs and copies that use nothing of their own: what one used counts for nothing
    while it starts anew, and is forgotten once it is gone.
    """
    samples = {
        host: replace(sample, tasks=drop_use(sample.tasks), standbys=drop_use(sample.standbys))
        for host, sample in case.snapshot.hosts.items()
    }
    return replace(case, snapshot=replace(case.snapshot, hosts=samples))


def drop_use(samples: Mapping[str, TaskSample]) -> dict[str, TaskSample]:
    return {name: replace(sample, used=Usage()) for name, sample in samples.items()}


@quick
@given(standby_cases)
def test_the_order_of_the_files_is_irrelevant(case: Case) -> None:
    def turn(mapping: Mapping[str, Value]) -> dict[str, Value]:
        return dict(reversed(list(mapping.items())))

    other = replace(
        case,
        inventory=replace(case.inventory, hosts=turn(case.inventory.hosts)),
        tasks=replace(case.tasks, tasks=turn(case.tasks.tasks)),
        snapshot=replace(case.snapshot, hosts=turn(case.snapshot.hosts)),
    )
    assert repr(other.assign()) == repr(case.assign())


@quick
@given(standby_cases)
def test_numpy_decides_the_same(case: Case) -> None:
    pytest.importorskip("edgectl.scheduler.array_scan")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edgectl.scheduler.assign.MIN_ARRAY_PAIRS", 0)
        arrays = case.assign()
    assert arrays == case.assign()


@quick
@given(standby_cases)
def test_other_names_change_ties_alone(case: Case) -> None:
    """With hosts named in the opposite order, the copies have the same totals, or differ where the tasks do."""
    edges = [host.name for host in case.inventory.edges]
    names = dict(zip(edges, (f"edge{9 - number}" for number in range(len(edges))), strict=True))
    found, other = case.assign(), rename_edges(case, names).assign()
    if [names.get(each.host or "", each.host) for each in found.decisions] != [
        each.host for each in other.decisions
    ]:
        return
    totals = [(task, step.action, round(step.total or 0.0, 9)) for task, step in list_steps(found)]
    assert sorted(totals) == sorted(
        (task, step.action, round(step.total or 0.0, 9)) for task, step in list_steps(other)
    )


def rename_edges(case: Case, names: Mapping[str, str]) -> Case:
    """Return the case with other names of hosts everywhere."""

    def get(host: str) -> str:
        return names.get(host, host)

    memory = replace(
        case.memory,
        cordons=frozenset(map(get, case.memory.cordons)),
        draining=frozenset(map(get, case.memory.draining)),
        downtimes={(task, get(host)): known for (task, host), known in case.memory.downtimes.items()},
    )
    tasks = [
        replace(task, hosts=replace(task.hosts, never=tuple(map(get, task.hosts.never))))
        for task in case.tasks.tasks.values()
    ]
    hosts = [replace(host, name=get(host.name)) for host in case.inventory.hosts.values()]
    return replace(
        case,
        inventory=an_inventory(*hosts),
        tasks=some_tasks(*tasks),
        snapshot=replace(
            case.snapshot, hosts={get(host): each for host, each in case.snapshot.hosts.items()}
        ),
        memory=memory,
    )
