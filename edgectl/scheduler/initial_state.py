# SPDX-License-Identifier: Apache-2.0
"""Initial state of a pass, from snapshot and manager state: running tasks, and the tasks that no pass
decides.
"""

from collections.abc import Iterable, Mapping
from dataclasses import field, replace

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.resource import RESOURCES_BY_NAME
from edgectl.model.snapshot import TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.rules.lost_places import LostPlace, build_lost_place_decision
from edgectl.rules.measured_demand import WARM_UP_S
from edgectl.rules.other_managers import is_up_to_date, list_unlisted_hosts
from edgectl.rules.task_origin import is_left_alone
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.evidence import (
    Evidence,
    FoundInstance,
    collect_instances,
    collect_standbys,
    find_given_up_run,
    find_lost_newest_place,
    find_newest_instance,
    find_unreachable_newest_host,
    find_unreachable_robot,
    get_instance_host,
    is_completed,
    select_counted,
)
from edgectl.scheduler.ledger import Ledger, build_measured_ledger, compute_measured_usage
from edgectl.scheduler.partition import seconds_until_replaced
from edgectl.scheduler.task_usage import TaskUsage

# With more than this share of the edges unreachable the manager's own link is the suspect, and nothing moves.
MAX_UNREACHABLE_SHARE = 0.55


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningTask:
    """A task that occupies ``place`` with ``use``.

    ``since``: when it came there; None: this very plan puts it there. ``counts``: it has run long enough for
    its measured usage to be typical of it. ``sample``: as it was found; None: it runs nowhere yet.
    """

    place: int
    use: TaskUsage
    since: float | None
    counts: bool = True
    sample: TaskSample | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialState:
    """The state that a pass starts from.

    ``ledger``: gamma, without what is about to be stopped. ``running``: tasks that the pass may keep or move.
    ``held``: tasks that run and stay where they are, because their robot does not answer.
    ``located``: the place of every task that counts as a predecessor. ``completed``: predecessors that need
    no place. ``fixed``: decisions that no pass makes. ``replaced``: the silent host of every task that is
    placed anew although it was never seen to end. ``standbys``: the inactive copies of tasks, whose use is no
    part of ``ledger``.
    """

    ledger: Ledger
    running: Mapping[str, RunningTask]
    located: Mapping[str, int]
    completed: frozenset[str]
    fixed: Mapping[str, Decision]
    held: Mapping[str, RunningTask] = field(default_factory=dict)
    replaced: Mapping[str, str] = field(default_factory=dict)
    standbys: Mapping[str, tuple[FoundInstance, ...]] = field(default_factory=dict)
    frozen: bool = False
    unseen: tuple[str, ...] = ()


@dataclass(slots=True, kw_only=True)
class _InitialStateBuilder:
    """Collects the initial state task by task."""

    evidence: Evidence
    ledger: Ledger
    now: float
    frozen: bool
    unsure: tuple[Reason, str] | None
    running: dict[str, RunningTask] = field(default_factory=dict)
    held: dict[str, RunningTask] = field(default_factory=dict)
    located: dict[str, int] = field(default_factory=dict)
    completed: set[str] = field(default_factory=set)
    fixed: dict[str, Decision] = field(default_factory=dict)
    replaced: dict[str, str] = field(default_factory=dict)


def build_initial_state(
    tasks: Tasks, manager: ManagerState, fleet: Capacities, now: float, policy: Policy
) -> InitialState:
    """The initial state from the snapshot (in ``fleet``) and the manager state."""
    seen = collect_instances(fleet)
    builder = _InitialStateBuilder(
        evidence=Evidence(
            fleet=fleet,
            samples={
                host.name: sample
                for host, sample in zip(fleet.places, fleet.samples, strict=True)
                if sample is not None
            },
            manager=manager,
        ),
        ledger=build_measured_ledger(fleet),
        now=now,
        frozen=_is_partition_suspected(fleet, manager),
        unsure=_find_unsure_host(fleet, manager),
    )
    # In the order of the names: sums of floats depend on their order, and the order of a file must not
    # matter.
    for name in sorted(tasks.tasks):
        _add_task(builder, tasks.tasks[name], seen.pop(name, ()))
    for name in sorted(seen):
        ours = [s for s in seen[name] if s.sample.managed]
        if not is_left_alone(name, [s.sample for s in ours], tasks, manager, policy):
            _release_usage(builder, ours, None)
    standbys = collect_standbys(fleet)
    for name in sorted(standbys):
        copies = [each.sample for each in standbys[name]]
        if name in tasks.tasks or not is_left_alone(name, copies, tasks, manager, policy):
            _release_copies(builder, standbys[name], tasks.tasks.get(name))
    silent = [
        host.name
        for place, host in enumerate(fleet.places)
        if (place < fleet.edges or host.onboard) and fleet.is_unreachable(place)
    ]
    return InitialState(
        ledger=builder.ledger,
        running=builder.running,
        held=builder.held,
        located=builder.located,
        completed=frozenset(builder.completed),
        fixed=builder.fixed,
        replaced=builder.replaced,
        standbys={name: copies for name, copies in standbys.items() if name in tasks.tasks},
        frozen=builder.frozen,
        unseen=() if manager.managed else tuple(silent),
    )


def _is_partition_suspected(fleet: Capacities, manager: ManagerState) -> bool:
    """True where so many edges are unreachable that the manager's own link is the suspect.

    Fenced edges do not count.
    """
    asked = [
        place
        for place in range(fleet.edges)
        if not (fleet.is_unreachable(place) and fleet.places[place].name in manager.fenced)
    ]
    return sum(map(fleet.is_unreachable, asked)) > MAX_UNREACHABLE_SHARE * len(asked)


def _find_unsure_host(fleet: Capacities, manager: ManagerState) -> tuple[Reason, str] | None:
    """A host on which another manager may have placed any task: a silent one (ADR 0055), or one that the
    inventory lacks (ADR 0068); None: there is none.

    Where others were granted the fleet after this manager last saw all hosts, its record may be out of date.
    """
    silent = [
        host.name
        for place, host in enumerate(fleet.places)
        if (place < fleet.edges or host.onboard)
        and fleet.is_unreachable(place)
        and host.name not in manager.fenced
    ]
    samples = {
        host.name: sample
        for host, sample in zip(fleet.places, fleet.samples, strict=True)
        if sample is not None
    }
    if is_up_to_date(manager, samples):
        return None
    unlisted = list_unlisted_hosts(samples)
    return (
        (Reason.HOST_UNSURE, silent[0])
        if silent
        else (Reason.HOST_UNLISTED, unlisted[0])
        if unlisted
        else None
    )


def _add_task(builder: _InitialStateBuilder, task: Task, sightings: tuple[FoundInstance, ...]) -> None:
    """One task of the file: completed, not ours, held, running or absent.

    Reports that do not count (`claims`) decide nothing; a copy that they show is stopped.
    """
    manager = builder.evidence.manager
    if not sightings and task.name not in manager.placements and task.name not in manager.done:
        _add_unknown_task(builder, task)  # as most tasks of a plan that starts a fleet
        return
    reported, sightings = sightings, select_counted(builder.evidence, task, sightings)
    _release_usage(builder, (s for s in reported if s not in sightings), task)
    alive = [s for s in sightings if s.sample.state.alive]
    ours = [s for s in alive if s.sample.managed and task.managed]
    current = find_newest_instance(builder.evidence, task, ours or alive)
    if is_completed(builder.evidence, task, sightings, current):
        _release_usage(builder, ours, task)
        lingering = [s for s in sightings if s.sample.state is TaskState.COMPLETED and s.sample.pid > 0]
        current = current or find_newest_instance(builder.evidence, task, lingering)
        builder.completed.add(task.name)
        builder.fixed[task.name] = Decision(
            task=task.name,
            verdict=Verdict.COMPLETED,
            reason=Reason.DONE,
            previous_host=get_instance_host(builder.evidence, current),
        )
        return
    lost = find_lost_newest_place(builder.evidence, task, ours, current)
    if lost is not None and not lost.fenced:
        _release_usage(builder, ours, task)
        _hold_at_lost_place(builder, task, lost)
        return
    away = find_unreachable_newest_host(builder.evidence, task, ours, current)
    left = (
        None
        if away is None or builder.frozen
        else seconds_until_replaced(task, away, builder.evidence.manager, builder.now)
    )
    if away is not None and left != 0.0:
        _release_usage(builder, ours, task)
        _hold_task(builder, task, away, Reason.HOST_SILENT, away, left)
    elif not task.managed or (alive and not ours):
        _keep_unmanaged(builder, task, current)
    elif (robot := find_unreachable_robot(builder.evidence, task)) is not None:
        _hold_task(
            builder, task, get_instance_host(builder.evidence, current) or away, Reason.ROBOT_SILENT, robot
        )
        if current is not None:
            builder.held[task.name] = _build_running_task(builder, task, current)
    elif current is not None:
        _release_usage(builder, (s for s in ours if s is not current), task)
        _add_running_task(builder, task, current)
    elif away is not None or lost is not None:
        builder.replaced[task.name] = away or (lost.host if lost is not None else "")
    else:
        _add_absent_task(builder, task, sightings)


def _add_unknown_task(builder: _InitialStateBuilder, task: Task) -> None:
    """A task of which neither a host nor the record knows anything."""
    if not task.managed:
        _keep_unmanaged(builder, task, None)
    elif (robot := find_unreachable_robot(builder.evidence, task)) is not None:
        _hold_task(builder, task, None, Reason.ROBOT_SILENT, robot)
    else:
        _add_absent_task(builder, task, ())


def _add_absent_task(builder: _InitialStateBuilder, task: Task, sightings: tuple[FoundInstance, ...]) -> None:
    """A task that no host shows alive: given up, held, or to be placed."""
    ended = find_given_up_run(builder.evidence, task, sightings) if sightings else None
    if ended is not None:
        builder.fixed[task.name] = _build_given_up_decision(
            task, ended, get_instance_host(builder.evidence, ended)
        )
    elif builder.unsure is not None:
        reason, host = builder.unsure
        builder.fixed[task.name] = Decision(task=task.name, verdict=Verdict.HELD, reason=reason, subject=host)


def _add_running_task(builder: _InitialStateBuilder, task: Task, current: FoundInstance) -> None:
    builder.running[task.name] = _build_running_task(builder, task, current)
    builder.located[task.name] = current.place


def _build_running_task(builder: _InitialStateBuilder, task: Task, current: FoundInstance) -> RunningTask:
    host, started_at = builder.evidence.fleet.places[current.place].name, current.sample.started_at
    return RunningTask(
        place=current.place,
        use=compute_measured_usage(builder.evidence.fleet, current.sample, task, current.place),
        since=find_arrival(builder.evidence.manager, task.name, host, started_at),
        counts=builder.now - started_at >= WARM_UP_S,
        sample=current.sample,
    )


def find_arrival(manager: ManagerState, task: str, host: str, started_at: float) -> float:
    """When a running task came to ``host``: as recorded for this host, else when it was started."""
    placement = manager.placements.get(task)
    return placement.since if placement is not None and placement.host == host else started_at


def _build_given_up_decision(task: Task, ended: FoundInstance, host: str | None) -> Decision:
    code = ended.sample.exit_code
    amount = None if code is None else float(code)
    return Decision(
        task=task.name, verdict=Verdict.UNPLACED, reason=Reason.GIVEN_UP, subject=host, amount=amount
    )


def _hold_at_lost_place(builder: _InitialStateBuilder, task: Task, lost: LostPlace) -> None:
    builder.fixed[task.name] = build_lost_place_decision(task.name, lost, Verdict.HELD)


def _hold_task(
    builder: _InitialStateBuilder,
    task: Task,
    host: str | None,
    reason: Reason,
    subject: str,
    left: float | None = None,
) -> None:
    if host is not None:
        builder.located[task.name] = builder.evidence.fleet.index[host]
    builder.fixed[task.name] = Decision(
        task=task.name,
        verdict=Verdict.HELD,
        reason=reason,
        host=host,
        previous_host=host,
        subject=subject,
        amount=left,
    )


def _keep_unmanaged(builder: _InitialStateBuilder, task: Task, current: FoundInstance | None) -> None:
    """Load and predecessor where it was found; nothing is ever done about it (ADR 0014)."""
    host = get_instance_host(builder.evidence, current)
    if current is not None:
        builder.located[task.name] = current.place
    builder.fixed[task.name] = Decision(
        task=task.name, verdict=Verdict.KEPT, reason=Reason.UNMANAGED, host=host, previous_host=host
    )


def _release_copies(
    builder: _InitialStateBuilder, copies: Iterable[FoundInstance], task: Task | None
) -> None:
    """Take inactive copies out of gamma; of a declared budget they use nothing."""
    fleet = builder.evidence.fleet
    for copy in copies:
        if copy.sample.state.alive:
            use = compute_measured_usage(fleet, copy.sample, task, copy.place)
            kept = {name: used for name, used in use.used.items() if not RESOURCES_BY_NAME[name].optional}
            builder.ledger.release(copy.place, replace(use, used=kept))


def _release_usage(
    builder: _InitialStateBuilder, sightings: Iterable[FoundInstance], task: Task | None
) -> None:
    """Take out of gamma whatever this plan stops; the gateway has taken out COMPLETED tasks already."""
    for sighting in sightings:
        if sighting.sample.state.alive:
            builder.ledger.release(
                sighting.place,
                compute_measured_usage(builder.evidence.fleet, sighting.sample, task, sighting.place),
            )
