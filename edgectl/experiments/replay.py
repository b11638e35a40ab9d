"""Re-run the scheduler on recorded snapshots under another scheme, in an open loop.

Usage and run time of tasks stay as recorded. Where a scheme places a task on another host than the recorded
one, the task's measured usage moves with it; a task that was not recorded as running uses its demand. The
replay begins with the placement of the first snapshot.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean

from edgectl.experiments.model.comparison import ReplayResult, Utilisation
from edgectl.experiments.model.schemes import Scheme
from edgectl.model.assignment import Assignment, Verdict
from edgectl.model.demand import ZERO
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.resource import NETWORK, RESOURCES_BY_NAME, Usage
from edgectl.model.snapshot import HostSample, LinkSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.names import natural_key
from edgectl.scheduler.assign import assign
from edgectl.scheduler.task_usage import TaskUsage


@dataclass(slots=True, kw_only=True)
class _ReplayCounts:
    """Counters, and by resource the utilisation of every edge or link in every cycle."""

    handoffs: int = 0
    unplaced: int = 0
    unsettled: int = 0
    shares: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in RESOURCES_BY_NAME})


def replay_snapshots(
    inventory: Inventory, tasks: Tasks, snapshots: Sequence[Snapshot], scheme: Scheme
) -> ReplayResult:
    """Decisions of ``scheme`` over ``snapshots``, which are ordered by time."""
    counts, assumed = _ReplayCounts(), set[str]()
    placed = dict(_list_live_tasks(snapshots[0])) if snapshots else {}
    manager = ManagerState(
        managed=True,
        first=placed,
        placements={task: _placement_from_sample(snapshots[0], task, host) for task, host in placed.items()},
    )
    for snapshot in snapshots:
        manager = _adopt_recorded_state(manager, snapshot)
        before = relocate_tasks(
            snapshot, tasks, {task: there.host for task, there in manager.placements.items()}
        )
        assignment = assign(inventory, tasks, before, manager, scheme.policy, snapshot.taken_at)
        manager = _apply_assignment(manager, assignment, snapshot.taken_at, counts)
        assumed |= manager.placements.keys()
        after = relocate_tasks(
            snapshot, tasks, {task: there.host for task, there in manager.placements.items()}
        )
        _record_utilisation(after, counts)
    assumed -= {task for snapshot in snapshots for task, _ in _list_live_tasks(snapshot)}
    return ReplayResult(
        scheme=scheme,
        cycles=len(snapshots),
        handoffs=counts.handoffs,
        unplaced=counts.unplaced,
        unsettled=counts.unsettled,
        assumed=tuple(sorted(assumed, key=natural_key)),
        utilisation={name: _compute_utilisation(shares) for name, shares in counts.shares.items()},
    )


def _list_live_tasks(snapshot: Snapshot) -> Iterable[tuple[str, str]]:
    """(task, host) of each live task that edgectl manages."""
    for host, sample in snapshot.hosts.items():
        yield from (
            (task, host) for task, found in sample.tasks.items() if found.state.alive and found.managed
        )


def _placement_from_sample(snapshot: Snapshot, task: str, host: str) -> Placement:
    found = snapshot.hosts[host].tasks[task]
    return Placement(host=host, since=found.started_at, spec_hash=found.spec_hash)


def _adopt_recorded_state(manager: ManagerState, snapshot: Snapshot) -> ManagerState:
    """The replayed state with recorded operator marks, completions, measured demands and downtimes."""
    recorded = snapshot.manager or ManagerState()
    ended = {
        task
        for host in snapshot.hosts.values()
        for task, found in host.tasks.items()
        if found.state is TaskState.COMPLETED
    }
    placements = {
        task: there
        for task, there in manager.placements.items()
        if task not in ended and task not in recorded.done
    }
    return replace(
        manager,
        placements=placements,
        cordons=recorded.cordons,
        draining=recorded.draining,
        pins=recorded.pins,
        done=recorded.done,
        measured=recorded.measured,
        downtimes=recorded.downtimes,
    )


def _apply_assignment(
    manager: ManagerState, assignment: Assignment, now: float, counts: _ReplayCounts
) -> ManagerState:
    """The state after all decisions, applied instantly."""
    placements, stays = dict(manager.placements), dict(manager.stays)
    for decision in assignment.decisions:
        before = placements.get(decision.task)
        if decision.verdict is Verdict.UNPLACED:
            counts.unplaced += 1
        if decision.verdict in (Verdict.UNPLACED, Verdict.COMPLETED):
            placements.pop(decision.task, None)
        elif decision.host is not None and (before is None or before.host != decision.host):
            if before is not None:
                counts.handoffs += 1
                stays[decision.task] = (*stays.get(decision.task, ()), now - before.since)[-20:]
            placements[decision.task] = Placement(host=decision.host, since=now)
    counts.unsettled += not assignment.settled
    first = {**{task: there.host for task, there in placements.items()}, **manager.first}
    return replace(manager, placements=placements, stays=stays, first=first)


def relocate_tasks(snapshot: Snapshot, tasks: Tasks, placed: Mapping[str, str]) -> Snapshot:
    """``snapshot`` with the managed tasks on the hosts ``placed``, and their usage moved with them."""
    hosts = dict(snapshot.hosts)
    for task, host in list(_list_live_tasks(snapshot)):
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
    shown = {task for task, _ in _list_live_tasks(snapshot)}
    for task, host in placed.items():
        if task not in shown and task in tasks.tasks and host in hosts and hosts[host].ok:
            usage = _usage_from_demand(tasks.tasks[task], hosts[host])
            hosts[host] = _add_task_and_load(
                hosts[host], task, _build_assumed_sample(snapshot, tasks.tasks[task], usage), usage
            )
    return replace(snapshot, hosts=hosts)


def _usage_from_sample(found: TaskSample, task: Task) -> TaskUsage:
    even = {robot: found.used[NETWORK.name] / len(task.robots) for robot in task.robots}
    return TaskUsage(used=found.used, links=found.links if found.links is not None else even)


def _usage_from_demand(task: Task, host: HostSample) -> TaskUsage:
    """The declared demand of the task on ``host``, taken as its usage."""
    demand = task.demand
    rate = demand[NETWORK.name] or ZERO
    return TaskUsage(
        used={name: (demand[name] or ZERO).of(usage.capacity) for name, usage in host.usage.items()},
        links={
            robot: rate.of(host.links[robot].nominal_bytes_per_s)
            for robot in task.robots
            if robot in host.links
        },
    )


def _build_assumed_sample(snapshot: Snapshot, task: Task, usage: TaskUsage) -> TaskSample:
    return TaskSample(
        state=TaskState.READY,
        started_at=snapshot.taken_at,
        links=usage.links,
        used=Usage({**usage.used, NETWORK.name: sum(usage.links.values())}),
        spec_hash=task.spec_hash,
    )


def _remove_task_and_load(host: HostSample, task: str, usage: TaskUsage) -> HostSample:
    return replace(
        _shift_host_load(host, usage, -1.0),
        tasks={name: found for name, found in host.tasks.items() if name != task},
    )


def _add_task_and_load(host: HostSample, task: str, found: TaskSample, usage: TaskUsage) -> HostSample:
    return replace(_shift_host_load(host, usage, 1.0), tasks={**host.tasks, task: found})


def _shift_host_load(host: HostSample, task_usage: TaskUsage, sign: float) -> HostSample:
    """``host`` with ``sign`` times the usage added to its load, at least 0."""
    if not host.measured:
        return host
    return replace(
        host,
        usage={
            name: replace(usage, used=max(0.0, usage.used + sign * task_usage.used.get(name, 0.0)))
            for name, usage in host.usage.items()
        },
        links={
            robot: _shift_link_load(link, sign * task_usage.links.get(robot, 0.0))
            for robot, link in host.links.items()
        },
    )


def _shift_link_load(link: LinkSample, change: float) -> LinkSample:
    return replace(link, used_bytes_per_s=max(0.0, link.used_bytes_per_s + change))


def _record_utilisation(snapshot: Snapshot, counts: _ReplayCounts) -> None:
    """Add the utilisation of each measured edge and link to ``counts``."""
    for host in snapshot.hosts.values():
        if host.ok and host.measured and host.role.value == "edge":
            for name, usage in host.usage.items():
                counts.shares[name].append(usage.share)
            links = (link for link in host.links.values() if link.capacity_bytes_per_s > 0)
            counts.shares[NETWORK.name] += [
                link.used_bytes_per_s / link.capacity_bytes_per_s for link in links
            ]


def _compute_utilisation(values: Sequence[float]) -> Utilisation:
    return Utilisation(mean=fmean(values), peak=max(values)) if values else Utilisation(mean=0.0, peak=0.0)
