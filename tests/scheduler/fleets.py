# SPDX-License-Identifier: Apache-2.0
"""Shorthand for running the scheduler, and a simulated apply."""

from collections.abc import Mapping
from dataclasses import replace

from edgectl.model.assignment import Assignment, Decision, ExpectedLoad, RankedHost, Reason, Verdict
from edgectl.model.demand import ZERO
from edgectl.model.inventory import Inventory, Role
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.standby_plan import StandbyAction, StandbyStep
from edgectl.model.task import Task, Tasks
from edgectl.rules.measured_demand import WARM_UP_S
from edgectl.scheduler.assign import assign
from edgectl.scheduler.capacities import build_capacities
from edgectl.scheduler.demand import add_measured_demands, demand_at
from tests.builders import NOW, a_robot, an_edge, an_inventory

NO_MEMORY = ManagerState(managed=True)


def run_assign(
    inventory: Inventory,
    tasks: Tasks,
    snapshot: Snapshot,
    *,
    memory: ManagerState = NO_MEMORY,
    policy: Policy | None = None,
    now: float = NOW,
) -> Assignment:
    """Call ``assign`` with the policy of the task file."""
    return assign(inventory, tasks, snapshot, memory, policy or tasks.policy, now)


def decisions_by_task(assignment: Assignment) -> dict[str, Decision]:
    """Return the decisions by task."""
    return {decision.task: decision for decision in assignment.decisions}


def hosts_by_task(assignment: Assignment) -> dict[str, str | None]:
    """Return the host of each task."""
    return {decision.task: decision.host for decision in assignment.decisions}


def ranking_by_host(decision: Decision) -> dict[str, RankedHost]:
    """Return a decision's ranking by host."""
    return {entry.host: entry for entry in decision.ranking}


def list_terms(entry: RankedHost) -> tuple[float | None, ...]:
    """Return UT_cpu, UT_mem, UT_net, UT_task and the total."""
    return *(entry.terms[name] for name in ("cpu", "memory", "network", "task")), entry.total


def simulate_apply(
    assignment: Assignment, tasks: Tasks, snapshot: Snapshot, memory: ManagerState
) -> tuple[Snapshot, ManagerState]:
    """Return the snapshot after a perfect apply: the load gamma is as expected, each placed task runs on its
    host and uses its demand rho, or what it used before if that is more.
    """
    before = {
        decision.task: snapshot.hosts[decision.previous_host].tasks.get(decision.task)
        for decision in assignment.decisions
        if decision.previous_host is not None and decision.previous_host in snapshot.hosts
    }
    worn = add_demands(tasks, snapshot, memory)
    samples = {
        name: _sample_after_apply(name, sample, assignment, worn[name], before)
        for name, sample in snapshot.hosts.items()
    }
    moved = [d for d in assignment.decisions if d.verdict is Verdict.PLACED and d.host is not None]
    placements = {
        **memory.placements,
        **{d.task: Placement(host=str(d.host), since=snapshot.taken_at) for d in moved},
    }
    first = {**{d.task: str(d.host) for d in moved}, **memory.first}
    done = {
        d.task: tasks.tasks[d.task].spec_hash for d in assignment.decisions if d.verdict is Verdict.COMPLETED
    }
    return replace(snapshot, hosts=samples), replace(
        memory, managed=True, placements=placements, first=first, done={**memory.done, **done}
    )


def add_demands(tasks: Tasks, snapshot: Snapshot, memory: ManagerState) -> dict[str, Tasks]:
    """Return the tasks with the demand that counts on each host."""
    hosts = [
        (an_edge if sample.role is Role.EDGE else a_robot)(name) for name, sample in snapshot.hosts.items()
    ]
    fleet = add_measured_demands(
        build_capacities(an_inventory(*hosts), snapshot, memory, frozenset()), tasks, memory
    )
    return {
        host: replace(
            tasks,
            tasks={
                name: replace(task, demand=demand_at(fleet, task, place))
                for name, task in tasks.tasks.items()
            },
        )
        for host, place in fleet.index.items()
    }


def _sample_after_apply(
    name: str,
    sample: HostSample,
    assignment: Assignment,
    tasks: Tasks,
    before: Mapping[str, TaskSample | None],
) -> HostSample:
    if not sample.measured:
        return sample
    unchanged = ExpectedLoad(used=Usage({name: usage.used for name, usage in sample.usage.items()}))
    load = assignment.expected.get(name, unchanged)
    running = {
        decision.task: _sample_of_run(
            tasks.tasks[decision.task],
            name,
            sample,
            before=before.get(decision.task),
            new=decision.previous_host != name,
        )
        for decision in assignment.decisions
        if decision.host == name
        and decision.verdict in (Verdict.PLACED, Verdict.KEPT)
        and decision.reason is not Reason.UNMANAGED
    }
    held = {
        decision.task
        for decision in assignment.decisions
        if decision.host == name and decision.verdict is Verdict.HELD
    }
    left = {task: run for task, run in sample.tasks.items() if task in held or not _is_ours(task, run, tasks)}
    links = {
        robot: replace(link, used_bytes_per_s=load.links.get(robot, link.used_bytes_per_s))
        for robot, link in sample.links.items()
    }
    copies = {
        task: _sample_of_copy(tasks.tasks[task], name, sample, step)
        for task, steps in assignment.standbys.items()
        for step in steps
        if step.host == name and step.action.stays
    }
    ended = {task: copy for task, copy in sample.standbys.items() if not copy.state.alive}
    return replace(
        sample,
        standbys={**ended, **copies},
        usage={name: replace(usage, used=load.used[name]) for name, usage in sample.usage.items()},
        links=links,
        tasks={**left, **running},
    )


def _is_ours(name: str, run: TaskSample, tasks: Tasks) -> bool:
    return run.managed and (name not in tasks.tasks or tasks.tasks[name].managed)


def _sample_of_copy(task: Task, host: str, sample: HostSample, step: StandbyStep) -> TaskSample:
    before = sample.standbys.get(task.name)
    kept = before is not None and step.action is StandbyAction.KEEP
    return TaskSample(
        state=TaskState.READY,
        pid=1,
        started_at=before.started_at if before is not None and kept else NOW - WARM_UP_S,
        used=step.demand,
        links={},
        instance=before.instance if before is not None and kept else f"{task.name}-copy-on-{host}",
        spec_hash=before.spec_hash if before is not None and kept else task.spec_hash,
    )


def _sample_of_run(
    task: Task, host: str, sample: HostSample, *, before: TaskSample | None, new: bool
) -> TaskSample:
    assert sample.measured
    used = before.used if before is not None and before.state.alive else Usage()
    rate = task.demand["network"] or ZERO
    rates = {
        robot: max(
            rate.of(sample.links[robot].capacity_bytes_per_s) if robot in task.robots else 0.0,
            _find_link_rate(task, robot, before),
        )
        for robot in sample.links
    }
    return TaskSample(
        state=TaskState.READY,
        pid=1,
        started_at=NOW if new or before is None else before.started_at,
        used=Usage(
            cpu=max((task.demand["cpu"] or ZERO).of(sample.usage["cpu"].capacity), used["cpu"]),
            memory=max((task.demand["memory"] or ZERO).of(sample.usage["memory"].capacity), used["memory"]),
            network=sum(rates.values()),
        ),
        links=rates,
        instance=f"{task.name}-on-{host}",
        spec_hash=task.spec_hash,
    )


def _find_link_rate(task: Task, robot: str, before: TaskSample | None) -> float:
    """Return what a task used of the link to ``robot``; evenly where its host did not tell."""
    if before is None or not before.state.alive:
        return 0.0
    if before.links is not None:
        return before.links.get(robot, 0.0)
    return before.used["network"] / len(task.robots) if robot in task.robots else 0.0
