"""Manager state after an apply, and the generations of its starts. Pure."""

import dataclasses
from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.executor.dependencies import is_replacement
from edgectl.model.assignment import Reason, Verdict
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import ActionResult, Outcome, Phase, Results
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.rules.other_managers import is_up_to_date, list_unlisted_hosts

# Generations follow a manager's clock. One that a host reports is believed up to ten years ahead of this
# clock, or of 2050 where this clock is behind: no host makes the others unusable by its word.
_MAX_LEAD_S, _YEAR_2050 = 10 * 366 * 86_400, 2_524_608_000
# Measurements kept of each kind: enough for a median and a mean that follow a change of the task.
_MAX_MEASUREMENTS = 20
# Reasons for a decision on a task of which no instance was seen: the record stays as it is.
_UNSEEN_REASONS = frozenset(
    {Reason.HOST_LEFT, Reason.HOST_READDRESSED, Reason.HOST_UNSURE, Reason.HOST_UNLISTED}
)


def compute_next_generations(
    manager: ManagerState,
    snapshot: Snapshot,
    steps: tuple[Step, ...],
    now: float,
    journalled: Mapping[str, int] | None = None,
) -> dict[str, int]:
    """The generation of each task's next start: above all known ones, and at least the clock's seconds.

    A generation out of all proportion is ignored: its host alone refuses starts then. The clock as a floor
    lets a manager that lost its state, or that another one overtook, start tasks again. Only hosts that the
    step concerns count, and at `protocol.MAX_GENERATION` it stays: hosts accept an equal one.
    """
    own = dict(journalled or {})
    for name, placement in manager.placements.items():
        own[name] = max(own.get(name, 0), placement.generation)
    return {step.task: _compute_next_generation(step, own.get(step.task, 0), snapshot, now) for step in steps}


def _compute_next_generation(step: Step, own: int, snapshot: Snapshot, now: float) -> int:
    task = step.task
    copies = {copy.host for copy in step.standbys}
    concerned = {step.decision.host, step.decision.previous_host, *step.stop, *step.instances, *copies}
    hosts = [host for name, host in snapshot.hosts.items() if name in concerned]
    reported = [host.instances[task].generation for host in hosts if task in host.instances]
    reported += [host.generations.get(task, 0) for host in hosts]
    following = 1 + max([own, *(_limit_generation(each, own, now) for each in reported)])
    return min(protocol.MAX_GENERATION, max(int(now), following))


def _limit_generation(reported: int, own: int, now: float) -> int:
    """A generation that a host reports, or 0 where it is out of all proportion."""
    return reported if reported <= max(own, int(now), _YEAR_2050) + _MAX_LEAD_S else 0


def update_manager_state(
    manager: ManagerState, plan: Plan, tasks: Tasks, results: Results, used: Mapping[str, int], now: float
) -> ManagerState:
    """``manager`` after ``plan`` ended with ``results``; ``used``: the generations of its starts."""
    ended = {result.task: result for result in results.actions}
    placements, done = dict(manager.placements), dict(manager.done)
    for step in plan.steps:
        if step.decision.reason in _UNSEEN_REASONS:
            continue
        result, task = ended.get(step.task), tasks.tasks.get(step.task)
        located = result.located if result is not None else _find_running_host(plan.snapshot, step)
        if located is not None and task is not None and _is_newly_started(result):
            since = _get_placed_since(manager.placements.get(step.task), step, now)
            placements[step.task] = Placement(
                host=located,
                since=since,
                spec_hash=task.spec_hash,
                generation=used.get(step.task, 0),
                instance=result.instance if result is not None else "",
                file=task.file,
                address=_get_sample_text(plan.snapshot, located, "address"),
                machine=_get_sample_text(plan.snapshot, located, "machine"),
            )
        elif located is not None:
            least = used.get(step.task, 0) + 1 if _is_restored(result) else 0
            kept = _keep_placement(manager, plan.snapshot, step.task, located, now, least)
            placements[step.task] = kept if task is None else dataclasses.replace(kept, file=task.file)
        elif _is_task_gone(plan.snapshot, step, result, placements.get(step.task)):
            placements.pop(step.task, None)
        if task is not None and _is_step_completed(step, result):
            done[step.task] = task.spec_hash
    first = {
        **{name: placement.host for name, placement in placements.items()},
        **manager.first,
        **_collect_replacement_hosts(plan, results),
    }
    return dataclasses.replace(
        manager,
        managed=True,
        placements=placements,
        first=first,
        done=done,
        downtimes=_collect_downtimes(manager, results),
        stays=_collect_stays(manager, results, now),
        deferred=_collect_deferrals(manager, plan, results),
        synced=_compute_synced_grants(manager, plan.snapshot, placements, tasks),
        pins={name: pin for name, pin in manager.pins.items() if pin.is_active(now)},
    )


def _compute_synced_grants(
    manager: ManagerState, snapshot: Snapshot, placements: Mapping[str, Placement], tasks: Tasks
) -> Mapping[str, int]:
    """The grants of all hosts, where all answered, no other manager has more of them, and ``placements`` has
    every task that lives there.

    They stay as they are until another manager has acted: a watch writes nothing while nothing changes.
    """
    if is_up_to_date(manager, snapshot.hosts):
        return manager.synced
    hosts = snapshot.hosts.values()
    alive = {
        name: run for host in hosts for name, run in host.tasks.items() if run.managed and run.state.alive
    }
    noted = all(
        name in placements and placements[name].generation >= run.generation
        for name, run in alive.items()
        if name in tasks.tasks or name in manager.placements
    )
    if list_unlisted_hosts(snapshot.hosts) or not (noted and all(host.ok for host in hosts)):
        return manager.synced
    return {name: host.grant for name, host in snapshot.hosts.items() if host.grant}


def _find_running_host(snapshot: Snapshot, step: Step) -> str | None:
    """The host on which the snapshot shows an untouched task, its decided host first."""
    for name in (step.decision.host, step.decision.previous_host, *snapshot.hosts):
        host = snapshot.hosts.get(name or "")
        if host is not None and step.task in host.tasks and host.tasks[step.task].state.alive:
            return name
    return None


def _collect_replacement_hosts(plan: Plan, results: Results) -> dict[str, str]:
    """The new host of each replaced task: its first host from now on (policy static)."""
    started = {
        result.task: result.host
        for result in results.actions
        if result.host is not None and _is_newly_started(result)
    }
    return {
        step.task: started[step.task] for step in plan.steps if is_replacement(step) and step.task in started
    }


def _is_task_gone(
    snapshot: Snapshot, step: Step, result: ActionResult | None, placement: Placement | None
) -> bool:
    """Whether the placement is dropped: kept for an unreachable host, and for a task given up on its host."""
    if result is not None:
        return True
    host = snapshot.hosts.get(placement.host) if placement else None
    return host is not None and host.ok and step.decision.reason is not Reason.GIVEN_UP


def _get_sample_text(snapshot: Snapshot, host: str, name: str) -> str:
    sample = snapshot.hosts.get(host)
    return str(getattr(sample, name)) if sample is not None else ""


def _is_step_completed(step: Step, result: ActionResult | None) -> bool:
    """Whether the task has completed: stopped because it was done, or ended by itself."""
    if step.decision.verdict is not Verdict.COMPLETED:
        return False
    return step.action is Action.NONE if result is None else result.outcome is Outcome.DONE


def _is_newly_started(result: ActionResult | None) -> bool:
    return (
        result is not None
        and result.outcome is not Outcome.DEFERRED
        and result.action in (Action.START, Action.MOVE, Action.RESTART)
        and result.located == result.host
    )


def _get_placed_since(old: Placement | None, step: Step, now: float) -> float:
    """The time at which the task came to its host; a restart in place does not renew its dwell."""
    return old.since if old is not None and step.action is Action.RESTART else now


def _is_restored(result: ActionResult | None) -> bool:
    """Whether the old instance was started again, which takes a generation of its own."""
    return result is not None and any(phase.phase is Phase.RESTORE for phase in result.phases)


def _keep_placement(
    manager: ManagerState, snapshot: Snapshot, task: str, located: str, now: float, least: int
) -> Placement:
    """The placement of an untouched task: the remembered one, else as its host shows it.

    ``least``: the lowest generation that it may have. While the remembered host is silent, a copy elsewhere
    does not replace what is remembered: once that host answers again, it counts.
    """
    host = snapshot.hosts.get(located)
    sample = host.tasks.get(task) if host else None
    old = manager.placements.get(task)
    if old is not None and old.host != located and not least and _is_silent(snapshot, old.host):
        return old
    seen = sample is not None and sample.state.alive
    known = max(least, old.generation if old is not None else 0)
    shown = _limit_generation(sample.generation, known, now) if sample is not None else 0
    if old is not None and old.host == located:
        newer = seen and shown >= old.generation
        return dataclasses.replace(
            old,
            generation=max(known, shown),
            instance=sample.instance if sample is not None and newer else old.instance,
            address=host.address if host is not None and seen else old.address,
            machine=host.machine if host is not None and seen else old.machine,
            nodes=sample.nodes if sample is not None and newer else old.nodes,
        )
    if sample is None:
        return Placement(host=located, since=now, generation=least)
    return Placement(
        host=located,
        since=sample.started_at,
        spec_hash=sample.spec_hash,
        generation=max(least, shown),
        instance=sample.instance,
        file=sample.file,
        address=host.address if host is not None else "",
        machine=host.machine if host is not None else "",
        nodes=sample.nodes,
    )


def _is_silent(snapshot: Snapshot, host: str) -> bool:
    sample = snapshot.hosts.get(host)
    return sample is not None and not sample.ok


def _collect_downtimes(manager: ManagerState, results: Results) -> dict[tuple[str, str], tuple[float, ...]]:
    """The gaps as robots heard them, else the measured downtimes; without those of restored tasks, which
    include a failed attempt.
    """
    downtimes = dict(manager.downtimes)
    for result in results.actions:
        gap = result.felt_gap_s
        if gap is not None and result.located is not None and result.located == result.host:
            key = (result.task, result.located)
            downtimes[key] = (*downtimes.get(key, ()), gap)[-_MAX_MEASUREMENTS:]
    return downtimes


def _collect_deferrals(manager: ManagerState, plan: Plan, results: Results) -> dict[str, str]:
    """The reasons of deferred actions, kept until a later plan of the task is not deferred."""
    planned = {step.task for step in plan.steps}
    others = {task: why for task, why in manager.deferred.items() if task not in planned}
    return others | {
        result.task: result.error for result in results.actions if result.outcome is Outcome.DEFERRED
    }


def _collect_stays(manager: ManagerState, results: Results, now: float) -> dict[str, tuple[float, ...]]:
    """The time that each moved task had spent on the host it left."""
    stays = dict(manager.stays)
    for result in results.actions:
        old = manager.placements.get(result.task)
        moved = result.action is Action.MOVE and result.located == result.host
        if moved and old is not None and old.host == result.previous_host:
            stays[result.task] = (*stays.get(result.task, ()), max(0.0, now - old.since))[-_MAX_MEASUREMENTS:]
    return stays
