"""Initial state of a pass, from snapshot and manager state: running tasks, and the tasks that no pass
decides.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy
from edgectl.model.snapshot import HostSample, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.rules.lost_places import LostPlace, build_lost_place_decision, find_lost_place
from edgectl.rules.measured_demand import WARM_UP_S
from edgectl.rules.other_managers import is_up_to_date, list_unlisted_hosts
from edgectl.rules.task_origin import is_left_alone
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.claims import Standing, find_record, judge_report
from edgectl.scheduler.ledger import Ledger, build_measured_ledger, compute_measured_usage
from edgectl.scheduler.partition import seconds_until_replaced
from edgectl.scheduler.task_usage import TaskUsage

# With more than this share of the edges unreachable the manager's own link is the suspect, and nothing moves.
MAX_UNREACHABLE_SHARE = 0.55


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningTask:
    """A task that occupies ``place`` with ``use``.

    ``since``: when it came there; None: this very plan puts it there. ``counts``: it has run long enough for
    its measured usage to be typical of it.
    """

    place: int
    use: TaskUsage
    since: float | None
    counts: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialState:
    """The state that a pass starts from.

    ``ledger``: gamma, without what is about to be stopped. ``running``: tasks that the pass may keep or move.
    ``held``: tasks that run and stay where they are, because their robot does not answer.
    ``located``: the place of every task that counts as a predecessor. ``completed``: predecessors that need
    no place. ``fixed``: decisions that no pass makes. ``replaced``: the silent host of every task that is
    placed anew although it was never seen to end.
    """

    ledger: Ledger
    running: Mapping[str, RunningTask]
    located: Mapping[str, int]
    completed: frozenset[str]
    fixed: Mapping[str, Decision]
    held: Mapping[str, RunningTask] = field(default_factory=dict)
    replaced: Mapping[str, str] = field(default_factory=dict)
    frozen: bool = False
    unseen: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundInstance:
    """One task found at one place."""

    place: int
    sample: TaskSample


@dataclass(slots=True, kw_only=True)
class _InitialStateBuilder:
    """Collects the initial state task by task. ``samples``: of the hosts that have one, by name."""

    fleet: Capacities
    samples: Mapping[str, HostSample]
    ledger: Ledger
    manager: ManagerState
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
    seen = _collect_instances(fleet)
    builder = _InitialStateBuilder(
        fleet=fleet,
        samples={
            host.name: sample
            for host, sample in zip(fleet.places, fleet.samples, strict=True)
            if sample is not None
        },
        ledger=build_measured_ledger(fleet),
        manager=manager,
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


def _collect_instances(fleet: Capacities) -> dict[str, tuple[FoundInstance, ...]]:
    found: dict[str, tuple[FoundInstance, ...]] = {}
    for place, sample in enumerate(fleet.samples):
        for name, task in sample.tasks.items() if sample and sample.ok else ():
            found[name] = (*found.get(name, ()), FoundInstance(place=place, sample=task))
    return found


def _add_task(builder: _InitialStateBuilder, task: Task, sightings: tuple[FoundInstance, ...]) -> None:
    """One task of the file: completed, not ours, held, running or absent.

    Reports that do not count (`claims`) decide nothing; a copy that they show is stopped.
    """
    reported, sightings = sightings, _select_counted(builder, task, sightings)
    _release_usage(builder, (s for s in reported if s not in sightings), task)
    alive = [s for s in sightings if s.sample.state.alive]
    ours = [s for s in alive if s.sample.managed and task.managed]
    current = _find_newest_instance(builder, task, ours or alive)
    if _is_completed(builder.manager, task, sightings, current):
        _release_usage(builder, ours, task)
        lingering = [s for s in sightings if s.sample.state is TaskState.COMPLETED and s.sample.pid > 0]
        current = current or _find_newest_instance(builder, task, lingering)
        builder.completed.add(task.name)
        builder.fixed[task.name] = Decision(
            task=task.name,
            verdict=Verdict.COMPLETED,
            reason=Reason.DONE,
            previous_host=_get_instance_host(builder, current),
        )
        return
    lost = _find_lost_newest_place(builder, task, ours, current)
    if lost is not None and not lost.fenced:
        _release_usage(builder, ours, task)
        _hold_at_lost_place(builder, task, lost)
        return
    away = _find_unreachable_newest_host(builder, task, ours, current)
    left = (
        None
        if away is None or builder.frozen
        else seconds_until_replaced(task, away, builder.manager, builder.now)
    )
    if away is not None and left != 0.0:
        _release_usage(builder, ours, task)
        _hold_task(builder, task, away, Reason.HOST_SILENT, away, left)
    elif not task.managed or (alive and not ours):
        _keep_unmanaged(builder, task, current)
    elif (robot := _find_unreachable_robot(builder, task)) is not None:
        _hold_task(builder, task, _get_instance_host(builder, current) or away, Reason.ROBOT_SILENT, robot)
        if current is not None:
            builder.held[task.name] = _build_running_task(builder, task, current)
    elif current is not None:
        _release_usage(builder, (s for s in ours if s is not current), task)
        _add_running_task(builder, task, current)
    elif away is not None or lost is not None:
        builder.replaced[task.name] = away or (lost.host if lost is not None else "")
    else:
        _add_absent_task(builder, task, sightings)


def _add_absent_task(builder: _InitialStateBuilder, task: Task, sightings: tuple[FoundInstance, ...]) -> None:
    """A task that no host shows alive: given up, held, or to be placed."""
    if (ended := _find_given_up_run(builder, task, sightings)) is not None:
        builder.fixed[task.name] = _build_given_up_decision(task, ended, _get_instance_host(builder, ended))
    elif builder.unsure is not None:
        reason, host = builder.unsure
        builder.fixed[task.name] = Decision(task=task.name, verdict=Verdict.HELD, reason=reason, subject=host)


def _select_counted(
    builder: _InitialStateBuilder, task: Task, sightings: tuple[FoundInstance, ...]
) -> tuple[FoundInstance, ...]:
    if not sightings:
        return ()
    record = find_record(task.name, builder.manager, builder.fleet.index, builder.samples)
    return tuple(
        s
        for s in sightings
        if not (task.managed and s.sample.managed)
        or judge_report(task, builder.fleet.places[s.place], s.sample, record) is not Standing.REFUSED
    )


def _add_running_task(builder: _InitialStateBuilder, task: Task, current: FoundInstance) -> None:
    builder.running[task.name] = _build_running_task(builder, task, current)
    builder.located[task.name] = current.place


def _build_running_task(builder: _InitialStateBuilder, task: Task, current: FoundInstance) -> RunningTask:
    placement = builder.manager.placements.get(task.name)
    remembered = placement is not None and placement.host == builder.fleet.places[current.place].name
    return RunningTask(
        place=current.place,
        use=compute_measured_usage(builder.fleet, current.sample, task, current.place),
        since=placement.since if placement is not None and remembered else current.sample.started_at,
        counts=builder.now - current.sample.started_at >= WARM_UP_S,
    )


def _find_newest_instance(
    builder: _InitialStateBuilder, task: Task, sightings: Iterable[FoundInstance]
) -> FoundInstance | None:
    """Of several copies that count the newer assignment wins: generation, then the remembered place, then the
    later start.
    """
    placement = builder.manager.placements.get(task.name)
    remembered = builder.fleet.index.get(placement.host) if placement else None
    return max(
        sightings,
        key=lambda s: (
            s.sample.generation,
            s.place == remembered,
            s.sample.started_at,
            -builder.fleet.order[s.place],
        ),
        default=None,
    )


def _is_completed(
    manager: ManagerState, task: Task, sightings: Iterable[FoundInstance], current: FoundInstance | None
) -> bool:
    """Marked done, or reported completed by a host whose report counts, with the present specification. A
    newer instance that is alive overrules it.
    """
    if manager.done.get(task.name) == task.spec_hash:
        return True
    finished = [
        s.sample
        for s in sightings
        if s.sample.state is TaskState.COMPLETED and s.sample.spec_hash == task.spec_hash
    ]
    newest = max((sample.generation for sample in finished), default=None)
    return newest is not None and (current is None or current.sample.generation <= newest)


def _find_given_up_run(
    builder: _InitialStateBuilder, task: Task, sightings: Iterable[FoundInstance]
) -> FoundInstance | None:
    """The last run of ``task``, if it ended by itself and must not be started again unasked (ADR 0022): the
    same would only happen again.

    A changed specification may do better; so may a run whose host has received a newer generation since, if
    only to stop it.
    """
    ended = [
        s
        for s in sightings
        if s.sample.managed and s.sample.given_up and s.sample.spec_hash in ("", task.spec_hash)
    ]
    last = _find_newest_instance(builder, task, ended)
    if last is None:
        return None
    placement = builder.manager.placements.get(task.name)
    told = [sample.generations.get(task.name, 0) for sample in builder.samples.values()]
    known = max(
        [s.sample.generation for s in sightings]
        + told
        + [placement.generation if placement is not None else 0],
        default=0,
    )
    return last if last.sample.generation >= known else None


def _build_given_up_decision(task: Task, ended: FoundInstance, host: str | None) -> Decision:
    code = ended.sample.exit_code
    amount = None if code is None else float(code)
    return Decision(
        task=task.name, verdict=Verdict.UNPLACED, reason=Reason.GIVEN_UP, subject=host, amount=amount
    )


def _find_unreachable_newest_host(
    builder: _InitialStateBuilder, task: Task, ours: Iterable[FoundInstance], current: FoundInstance | None
) -> str | None:
    """The silent host that has the newest copy of ``task``, as far as is known.

    A copy that is seen may be older: left behind by a host that went silent, was replaced, and came back
    after its replacement fell silent.
    """
    placement = builder.manager.placements.get(task.name)
    place = builder.fleet.index.get(placement.host) if placement else None
    if placement is None or place is None or not builder.fleet.is_unreachable(place):
        return None
    return placement.host if _is_older(current, ours, placement) else None


def _is_older(current: FoundInstance | None, ours: Iterable[FoundInstance], placement: Placement) -> bool:
    """Whether what is seen of a task, if anything, is older than its last known placement."""
    return current is None or (current in ours and current.sample.generation < placement.generation)


def _find_lost_newest_place(
    builder: _InitialStateBuilder, task: Task, ours: Iterable[FoundInstance], current: FoundInstance | None
) -> LostPlace | None:
    """The place of the newest copy of ``task`` where the inventory no longer reaches it (ADR 0040)."""
    placement = builder.manager.placements.get(task.name)
    if placement is None or not task.managed or not _is_older(current, ours, placement):
        return None
    if placement.host not in builder.samples and placement.host in builder.fleet.index:
        return None
    return find_lost_place(task.name, placement, builder.samples, builder.manager)


def _hold_at_lost_place(builder: _InitialStateBuilder, task: Task, lost: LostPlace) -> None:
    builder.fixed[task.name] = build_lost_place_decision(task.name, lost, Verdict.HELD)


def _find_unreachable_robot(builder: _InitialStateBuilder, task: Task) -> str | None:
    places = ((robot, builder.fleet.index.get(robot)) for robot in task.robots)
    return next(
        (robot for robot, place in places if place is not None and builder.fleet.is_unreachable(place)), None
    )


def _hold_task(
    builder: _InitialStateBuilder,
    task: Task,
    host: str | None,
    reason: Reason,
    subject: str,
    left: float | None = None,
) -> None:
    if host is not None:
        builder.located[task.name] = builder.fleet.index[host]
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
    host = _get_instance_host(builder, current)
    if current is not None:
        builder.located[task.name] = current.place
    builder.fixed[task.name] = Decision(
        task=task.name, verdict=Verdict.KEPT, reason=Reason.UNMANAGED, host=host, previous_host=host
    )


def _release_usage(
    builder: _InitialStateBuilder, sightings: Iterable[FoundInstance], task: Task | None
) -> None:
    """Take out of gamma whatever this plan stops; the gateway has taken out COMPLETED tasks already."""
    for sighting in sightings:
        if sighting.sample.state.alive:
            builder.ledger.release(
                sighting.place, compute_measured_usage(builder.fleet, sighting.sample, task, sighting.place)
            )


def _get_instance_host(builder: _InitialStateBuilder, sighting: FoundInstance | None) -> str | None:
    return None if sighting is None else builder.fleet.places[sighting.place].name
