# SPDX-License-Identifier: Apache-2.0
"""Plans that are read again: with other CPU in use and at another time they are those that are made anew."""

from collections import Counter
from dataclasses import replace

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import PolicyName
from edgectl.model.resource import CPU, Usage
from edgectl.model.snapshot import HostSample, TaskSample, TaskState
from edgectl.rules.measured_demand import WARM_UP_S
from edgectl.scheduler.assign import assign, decide_plan, prepare_plan
from edgectl.scheduler.known_plan import read_again, remember_plan
from tests.builders import (
    NOW,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.test_properties import Case, cases, shares

LATER = NOW + 25.0


@st.composite
def changed_cases(draw: st.DrawFn) -> tuple[Case, Case]:
    """A fleet, and the same with other CPU in use and other times.

    What is seen twice keeps the order of its starts; what has run for long enough to be measured still has.
    """
    case = draw(cases())
    seen = Counter(name for host in case.snapshot.hosts.values() for name in host.tasks)
    placed = {
        name: host
        for host, sample in case.snapshot.hosts.items()
        for name in sample.tasks
        if name in case.tasks.tasks and draw(st.booleans())
    }
    hosts = {name: _change_sample(draw, sample, seen) for name, sample in case.snapshot.hosts.items()}
    before = _place(case.memory, placed, NOW - 300.0)
    after = _place(replace(case.memory, downtimes={}), placed, LATER - draw(st.sampled_from([5.0, 500.0])))
    policy = replace(case.policy, name=draw(st.sampled_from(PolicyName)))
    return (
        replace(case, memory=before, policy=policy),
        replace(
            case,
            snapshot=replace(case.snapshot, taken_at=LATER, hosts=hosts),
            memory=after,
            policy=replace(policy, seed=draw(st.integers(0, 3))),
        ),
    )


def _change_sample(draw: st.DrawFn, sample: HostSample, seen: Counter[str]) -> HostSample:
    if not sample.ok:
        return sample
    usage = sample.usage[CPU.name]
    tasks = {}
    for name, run in sample.tasks.items():
        age = NOW - run.started_at
        if seen[name] == 1:
            age = draw(st.sampled_from([WARM_UP_S, 300.0] if age >= WARM_UP_S else [0.0, 9.0]))
        tasks[name] = replace(run, started_at=LATER - age)
    used = replace(usage, used=draw(shares) * usage.capacity)
    return replace(sample, usage={**sample.usage, CPU.name: used}, tasks=tasks)


def _place(memory: ManagerState, placed: dict[str, str], since: float) -> ManagerState:
    return replace(
        memory, placements={name: Placement(host=host, since=since) for name, host in placed.items()}
    )


@settings(max_examples=settings().max_examples // 2)
@given(changed_cases())
def test_a_plan_read_again_is_the_one_made_anew(pair: tuple[Case, Case]) -> None:
    case, later = pair
    for explain in (False, True):
        before = prepare_plan(
            case.inventory, case.tasks, case.snapshot, case.memory, case.policy, NOW, explain=explain
        )
        decide_plan(before, case.tasks)
        known = remember_plan(before)
        assume(known is not None)
        assert known is not None
        hosts = later.snapshot.hosts
        again = read_again(
            known,
            {name: sample.usage[CPU.name].used if sample.ok else 0.0 for name, sample in hosts.items()},
            {name: run.started_at for sample in hosts.values() for name, run in sample.tasks.items()},
            later.memory,
            later.policy,
            LATER,
        )
        made = assign(
            later.inventory, later.tasks, later.snapshot, later.memory, later.policy, LATER, explain=explain
        )
        assert decide_plan(again, later.tasks) == made


@st.composite
def other_states(draw: st.DrawFn) -> tuple[Case, Case]:
    """A fleet, and the same hosts and links at another time: other tasks run elsewhere, and use something else."""
    case = draw(cases())
    policy = replace(case.policy, name=draw(st.sampled_from(PolicyName)))
    answering = [name for name, sample in case.snapshot.hosts.items() if sample.ok]
    runs: dict[str, dict[str, TaskSample]] = {name: {} for name in answering}
    for host in answering:
        for name, run in case.snapshot.hosts[host].tasks.items():
            for other in draw(st.lists(st.sampled_from(answering), max_size=2, unique=True)):
                age = draw(st.sampled_from([5.0, 500.0]))
                state = draw(st.sampled_from(TaskState))
                runs[other][name] = replace(run, state=state, started_at=LATER - age)
    hosts = {
        name: replace(
            sample,
            tasks=runs[name],
            usage={
                key: replace(each, used=draw(shares) * each.capacity) for key, each in sample.usage.items()
            },
        )
        if name in runs
        else sample
        for name, sample in case.snapshot.hosts.items()
    }
    placed = {name: host for host, found in runs.items() for name in found if name in case.tasks.tasks}
    memory = replace(_place(case.memory, placed, LATER - 5.0), first=placed, downtimes={}, stays={}, done={})
    later = replace(
        case,
        snapshot=replace(case.snapshot, taken_at=LATER, hosts=hosts),
        memory=memory,
        policy=replace(policy, seed=draw(st.integers(0, 3))),
    )
    return replace(case, policy=policy), later


@settings(max_examples=settings().max_examples // 2)
@given(other_states())
def test_what_a_former_plan_knows_of_hosts_and_files_holds_for_the_next(pair: tuple[Case, Case]) -> None:
    case, later = pair
    for explain in (False, True):
        former = prepare_plan(
            case.inventory, case.tasks, case.snapshot, case.memory, case.policy, NOW, explain=explain
        )
        decide_plan(former, case.tasks)  # what it keeps of tasks and places is kept by now
        given_later = (later.inventory, later.tasks, later.snapshot, later.memory, later.policy, LATER)
        for _ in range(2):
            again = prepare_plan(*given_later, explain=explain, former=former)
            assert decide_plan(again, later.tasks) == assign(*given_later, explain=explain)


def test_a_plan_in_which_a_load_is_taken_away_is_not_read_again() -> None:
    """Of two copies the older one is stopped: what it uses is no part of gamma, even where none is in use now."""
    inventory = an_inventory(an_edge("edge2"), an_edge("edge1"), a_robot("robot1"))
    tasks = some_tasks(a_task("stays", cpu=1.0))
    for copies, used in ((1, 1.0), (2, 1.0), (2, 0.0)):
        runs = [a_run(used=Usage(cpu=1.0), generation=number) for number in range(copies)]
        samples = {
            f"edge{2 - number}": a_sample(used=used, tasks={"stays": run}) for number, run in enumerate(runs)
        }
        snapshot = a_snapshot({"edge1": a_sample(), **samples, "robot1": a_sample()})
        prepared = prepare_plan(inventory, tasks, snapshot, ManagerState(managed=True), tasks.policy, NOW)
        assert (remember_plan(prepared) is None) == (copies == 2)
