# SPDX-License-Identifier: Apache-2.0
"""Plans of stop, restart and rollback. Pure."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping

from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.snapshot import HostSample, Snapshot, TaskState
from edgectl.model.standby_plan import StandbyReason, stop_copies
from edgectl.model.task import Tasks
from edgectl.rules.lost_places import build_lost_place_decision, list_lost_tasks


def list_running_instances(snapshot: Snapshot) -> dict[str, dict[str, str]]:
    """The managed tasks that have processes, each with its instances by host, in the order of the hosts."""
    found: dict[str, dict[str, str]] = {}
    for host, sample in snapshot.hosts.items():
        for name, task in sample.tasks.items():
            if task.managed and (task.state.alive or task.pid > 0):
                found.setdefault(name, {})[host] = task.instance
    return found


def list_copies(snapshot: Snapshot) -> dict[str, dict[str, str]]:
    """The tasks that have inactive copies, each with their instances by host, in the order of the hosts."""
    found: dict[str, dict[str, str]] = {}
    for host, sample in snapshot.hosts.items():
        for name, copy in sample.standbys.items():
            if copy.state.alive or copy.pid > 0:
                found.setdefault(name, {})[host] = copy.instance
    return found


def list_unseen_placements(snapshot: Snapshot) -> dict[str, str]:
    """Last known hosts of the tasks whose host does not answer and was not declared powered off, by task."""
    manager = snapshot.manager or ManagerState()
    return {
        task: placement.host
        for task, placement in manager.placements.items()
        if placement.host in snapshot.hosts
        and not snapshot.hosts[placement.host].ok
        and placement.host not in manager.fenced
    }


def build_stop_plan(names: Iterable[str], inventory: Inventory, tasks: Tasks, snapshot: Snapshot) -> Plan:
    """Stop the named tasks wherever they run or may run; those that do not run need no step.

    The step of a task whose last known host does not answer has the reason ``HOST_SILENT``; that of one at a
    lost place, the reason of that place. Inactive copies are stopped with their task.
    """
    places, unseen = list_running_instances(snapshot), list_unseen_placements(snapshot)
    lost, steps, copies = list_lost_tasks(snapshot), list[Step](), list_copies(snapshot)
    for name in names:
        standbys = stop_copies(copies.get(name, {}), StandbyReason.OPERATOR)
        if name in lost:
            decision = build_lost_place_decision(name, lost[name], Verdict.UNPLACED)
            steps.append(Step(decision=decision, action=Action.STOP, standbys=standbys))
        elif name in places or name in unseen:
            decision = Decision(
                task=name,
                verdict=Verdict.UNPLACED,
                reason=Reason.HOST_SILENT if name in unseen else Reason.OPERATOR,
                previous_host=unseen.get(name) or next(iter(places[name])),
                subject=unseen.get(name),
            )
            instances = places.get(name, {})
            steps.append(Step(decision=decision, action=Action.STOP, instances=instances, standbys=standbys))
        elif standbys:
            decision = Decision(task=name, verdict=Verdict.UNPLACED, reason=Reason.OPERATOR)
            steps.append(Step(decision=decision, action=Action.NONE, standbys=standbys))
    return _build_operator_plan(tuple(steps), inventory, tasks, snapshot)


def build_restart_plan(names: Iterable[str], inventory: Inventory, tasks: Tasks, snapshot: Snapshot) -> Plan:
    """Stop running tasks and start each again on its host; further instances elsewhere are stopped.

    Their inactive copies stay as they are.
    """
    running = list_running_instances(snapshot)
    steps = tuple(_build_restart_step(name, running[name], snapshot) for name in names)
    return _build_operator_plan(steps, inventory, tasks, snapshot)


def _build_restart_step(name: str, places: Mapping[str, str], snapshot: Snapshot) -> Step:
    """``places``: its instances by host."""
    known = snapshot.manager.placements.get(name) if snapshot.manager is not None else None
    host = known.host if known is not None and known.host in places else next(iter(places))
    others = [place for place in places if place != host]
    decision = Decision(
        task=name, verdict=Verdict.KEPT, reason=Reason.OPERATOR, host=host, previous_host=host
    )
    return Step(decision=decision, action=Action.RESTART, instances=places, stop=tuple(others))


def drop_given_up_runs(name: str, snapshot: Snapshot, *, completed: bool = False) -> Snapshot:
    """``snapshot`` without the runs of a task that were given up, and ``completed`` ones too where that is
    asked for; their generations stay known.
    """
    return dataclasses.replace(
        snapshot,
        hosts={
            host: _drop_given_up_run(name, sample, completed=completed)
            for host, sample in snapshot.hosts.items()
        },
    )


def _drop_given_up_run(name: str, sample: HostSample, *, completed: bool) -> HostSample:
    run = sample.instances.get(name)
    if run is None or not (run.given_up or (completed and run.state is TaskState.COMPLETED)):
        return sample
    return dataclasses.replace(
        sample,
        tasks={task: other for task, other in sample.tasks.items() if task != name},
        standbys={task: other for task, other in sample.standbys.items() if task != name},
        generations={**sample.generations, name: run.generation},
    )


def _build_operator_plan(
    steps: tuple[Step, ...], inventory: Inventory, tasks: Tasks, snapshot: Snapshot
) -> Plan:
    return Plan(
        created_at=snapshot.taken_at,
        policy=tasks.policy,
        fleet=inventory.fleet,
        inventory_digest=inventory.digest,
        tasks_digest=tasks.digest,
        snapshot=snapshot,
        settled=True,
        steps=steps,
        expected={},
    )


def build_rollback_plan(plan: Plan, wanted: Mapping[str, str], revision: int) -> Plan:
    """``plan``, in which every task of ``wanted`` was held to its old host, without the other tasks.

    Of the others, those that run now are stopped.
    """
    places, copies = list_running_instances(plan.snapshot), list_copies(plan.snapshot)
    steps = (
        made
        for step in plan.steps
        for made in _build_rollback_steps(
            step, wanted, places.get(step.task, {}), copies.get(step.task, {}), revision
        )
    )
    return dataclasses.replace(plan, steps=tuple(steps), tasks_left_alone={})


def _build_rollback_steps(
    step: Step,
    wanted: Mapping[str, str],
    places: Mapping[str, str],
    copies: Mapping[str, str],
    revision: int,
) -> Iterator[Step]:
    decision = step.decision
    if (
        step.task in wanted
        or decision.reason is Reason.UNMANAGED
        or decision.verdict in (Verdict.COMPLETED, Verdict.HELD)
    ):
        asked = step.action in (Action.START, Action.MOVE) and decision.host == wanted.get(step.task)
        reason = (
            dataclasses.replace(decision, reason=Reason.ROLLBACK, amount=float(revision))
            if asked
            else decision
        )
        yield dataclasses.replace(step, decision=reason)
    elif places or copies:
        left = Decision(
            task=step.task,
            verdict=Verdict.UNPLACED,
            reason=Reason.ROLLBACK,
            previous_host=next(iter(places), None),
            amount=float(revision),
        )
        standbys = stop_copies(copies, StandbyReason.OPERATOR)
        action = Action.STOP if places else Action.NONE
        yield Step(decision=left, action=action, instances=places, standbys=standbys)
