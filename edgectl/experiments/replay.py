"""Decide recorded snapshots again under another rule. Open loop: what the tasks used and how long they ran stays as it was recorded.

Each variant lives in its own world: a task that the record shows on one host and the variant on another takes its measured use along,
and one that the record does not show running uses what it demands. The first cycle begins where the record begins.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean

from edgectl.experiments.model.comparison import ReplayResult, Scheme, Utilisation
from edgectl.model.assignment import Assignment, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import HostSample, LinkSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.names import natural_key
from edgectl.scheduler.assign import assign
from edgectl.scheduler.ledger import TaskUsage


@dataclass(slots=True, kw_only=True)
class _ReplayCounts:
    """Counts and utilisations so far."""

    handoffs: int = 0
    unplaced: int = 0
    unsettled: int = 0
    cpu: list[float] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    network: list[float] = field(default_factory=list)


def replay_snapshots(
    inventory: Inventory, tasks: Tasks, snapshots: Sequence[Snapshot], variant: Scheme
) -> ReplayResult:
    """What ``variant`` would have done at each of ``snapshots``, which stand in the order of their time."""
    tally, unseen = _ReplayCounts(), set[str]()
    placed = dict(_list_living_tasks(snapshots[0])) if snapshots else {}
    memory = ManagerState(
        managed=True,
        first=placed,
        placements={task: _placement_from_sample(snapshots[0], task, host) for task, host in placed.items()},
    )
    for snapshot in snapshots:
        memory = _adopt_recorded_state(memory, snapshot)
        world = relocate_tasks(
            snapshot, tasks, {task: there.host for task, there in memory.placements.items()}
        )
        assignment = assign(inventory, tasks, world, memory, variant.policy, snapshot.taken_at)
        memory = _apply_assignment(memory, assignment, snapshot.taken_at, tally)
        unseen |= memory.placements.keys()
        after = relocate_tasks(
            snapshot, tasks, {task: there.host for task, there in memory.placements.items()}
        )
        _record_utilisation(after, tally)
    unseen -= {task for snapshot in snapshots for task, _ in _list_living_tasks(snapshot)}
    return ReplayResult(
        scheme=variant,
        cycles=len(snapshots),
        handoffs=tally.handoffs,
        unplaced=tally.unplaced,
        unsettled=tally.unsettled,
        assumed=tuple(sorted(unseen, key=natural_key)),
        cpu=_compute_utilisation(tally.cpu),
        memory=_compute_utilisation(tally.memory),
        network=_compute_utilisation(tally.network),
    )


def _list_living_tasks(snapshot: Snapshot) -> Iterable[tuple[str, str]]:
    """(task, host) of each living task that is ours."""
    for host, sample in snapshot.hosts.items():
        yield from (
            (task, host) for task, found in sample.tasks.items() if found.state.alive and found.managed
        )


def _placement_from_sample(snapshot: Snapshot, task: str, host: str) -> Placement:
    found = snapshot.hosts[host].tasks[task]
    return Placement(host=host, since=found.started_at, spec_hash=found.spec_hash)


def _adopt_recorded_state(memory: ManagerState, snapshot: Snapshot) -> ManagerState:
    """The variant's memory with what is recorded of operators and of missions: cordons, done marks, measured demands."""
    recorded = snapshot.manager or ManagerState()
    ended = {
        task
        for host in snapshot.hosts.values()
        for task, found in host.tasks.items()
        if found.state is TaskState.COMPLETED
    }
    placements = {
        task: there
        for task, there in memory.placements.items()
        if task not in ended and task not in recorded.done
    }
    return replace(
        memory, placements=placements, cordons=recorded.cordons, draining=recorded.draining, done=recorded.done, measured=recorded.measured,
        downtimes=recorded.downtimes,
    )  # fmt: skip


def _apply_assignment(
    memory: ManagerState, assignment: Assignment, now: float, tally: _ReplayCounts
) -> ManagerState:
    """The memory after the decisions were carried out at once."""
    placements, stays = dict(memory.placements), dict(memory.stays)
    for decision in assignment.decisions:
        before = placements.get(decision.task)
        if decision.verdict is Verdict.UNPLACED:
            tally.unplaced += 1
        if decision.verdict in (Verdict.UNPLACED, Verdict.COMPLETED):
            placements.pop(decision.task, None)
        elif decision.host is not None and (before is None or before.host != decision.host):
            if before is not None:
                tally.handoffs += 1
                stays[decision.task] = (*stays.get(decision.task, ()), now - before.since)[-20:]
            placements[decision.task] = Placement(host=decision.host, since=now)
    tally.unsettled += not assignment.settled
    first = {**{task: there.host for task, there in placements.items()}, **memory.first}
    return replace(memory, placements=placements, stays=stays, first=first)


def relocate_tasks(snapshot: Snapshot, tasks: Tasks, placed: Mapping[str, str]) -> Snapshot:
    """``snapshot`` as it would look with the managed tasks on the hosts ``placed``, their use moved along."""
    hosts = dict(snapshot.hosts)
    for task, host in list(_list_living_tasks(snapshot)):
        if task in tasks.tasks and placed.get(task) != host:
            found = hosts[host].tasks[task]
            hosts[host] = _remove_task_and_load(
                hosts[host], task, _usage_from_sample(found, tasks.tasks[task])
            )
            there = hosts.get(placed.get(task, ""))
            if there is not None and there.ok:
                hosts[placed[task]] = _add_task_and_load(
                    there, task, found, _usage_from_sample(found, tasks.tasks[task])
                )
    shown = {task for task, _ in _list_living_tasks(snapshot)}
    for task, host in placed.items():
        if task not in shown and task in tasks.tasks and host in hosts and hosts[host].ok:
            use = _usage_from_demand(tasks.tasks[task], hosts[host])
            hosts[host] = _add_task_and_load(
                hosts[host], task, _build_assumed_sample(snapshot, tasks.tasks[task], use), use
            )
    return replace(snapshot, hosts=hosts)


def _usage_from_sample(found: TaskSample, task: Task) -> TaskUsage:
    even = {robot: found.used_bytes_per_s / len(task.robots) for robot in task.robots}
    return TaskUsage(
        cpu=found.used_cores, memory=found.used_bytes, links=found.links if found.links is not None else even
    )


def _usage_from_demand(task: Task, host: HostSample) -> TaskUsage:
    """The task's declared demand at ``host``."""
    demand = task.demand
    links = {} if demand.throughput is None else {
        robot: demand.throughput.of(host.links[robot].capacity_bytes_per_s) for robot in task.robots if robot in host.links
    }  # fmt: skip
    return TaskUsage(
        cpu=demand.cpu.of(host.cpu.cores) if demand.cpu and host.cpu else 0.0,
        memory=demand.memory.of(host.memory.total_bytes) if demand.memory and host.memory else 0.0,
        links=links,
    )


def _build_assumed_sample(snapshot: Snapshot, task: Task, use: TaskUsage) -> TaskSample:
    return TaskSample(
        state=TaskState.READY, started_at=snapshot.taken_at, used_cores=use.cpu, used_bytes=use.memory,
        used_bytes_per_s=sum(use.links.values()), links=use.links, spec_hash=task.spec_hash,
    )  # fmt: skip


def _remove_task_and_load(host: HostSample, task: str, use: TaskUsage) -> HostSample:
    return replace(
        _shift_host_load(host, use, -1.0),
        tasks={name: found for name, found in host.tasks.items() if name != task},
    )


def _add_task_and_load(host: HostSample, task: str, found: TaskSample, use: TaskUsage) -> HostSample:
    return replace(_shift_host_load(host, use, 1.0), tasks={**host.tasks, task: found})


def _shift_host_load(host: HostSample, use: TaskUsage, sign: float) -> HostSample:
    """The load of ``host`` with the use added or taken out, never below 0."""
    if host.cpu is None or host.memory is None:
        return host
    return replace(
        host,
        cpu=replace(host.cpu, used_cores=max(0.0, host.cpu.used_cores + sign * use.cpu)),
        memory=replace(host.memory, used_bytes=max(0.0, host.memory.used_bytes + sign * use.memory)),
        links={
            robot: _shift_link_load(link, sign * use.links.get(robot, 0.0))
            for robot, link in host.links.items()
        },
    )


def _shift_link_load(link: LinkSample, change: float) -> LinkSample:
    return replace(link, used_bytes_per_s=max(0.0, link.used_bytes_per_s + change))


def _record_utilisation(snapshot: Snapshot, tally: _ReplayCounts) -> None:
    """The utilisation of every edge and link that was measured."""
    for host in snapshot.hosts.values():
        if host.ok and host.cpu is not None and host.memory is not None and host.role.value == "edge":
            tally.cpu.append(host.cpu.used_cores / host.cpu.cores)
            tally.memory.append(host.memory.used_bytes / host.memory.total_bytes)
            links = (link for link in host.links.values() if link.capacity_bytes_per_s > 0)
            tally.network += [link.used_bytes_per_s / link.capacity_bytes_per_s for link in links]


def _compute_utilisation(values: Sequence[float]) -> Utilisation:
    return Utilisation(mean=fmean(values), peak=max(values)) if values else Utilisation(mean=0.0, peak=0.0)
