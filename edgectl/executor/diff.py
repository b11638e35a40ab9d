# SPDX-License-Identifier: Apache-2.0
"""First half of Algorithm 2: an assignment against the running tasks -> the steps of a plan. Pure."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from edgectl.model.assignment import Assignment, Decision, Reason, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.standby_plan import StandbyReason, stop_copies
from edgectl.model.task import Tasks
from edgectl.names import natural_key
from edgectl.rules.need_runs import find_restarted_need, list_followed_needs, mark_run
from edgectl.rules.overuse import find_overuses
from edgectl.rules.task_origin import find_task_file, is_left_alone

SamplesByHost = Mapping[str, TaskSample]  # the samples of one task, by host


def plan_from_assignment(
    inventory: Inventory, tasks: Tasks, snapshot: Snapshot, manager: ManagerState, assignment: Assignment
) -> Plan:
    """The plan of an assignment; it contains its snapshot and manager state, so it can be made again."""
    return Plan(
        created_at=snapshot.taken_at,
        policy=assignment.policy,
        fleet=inventory.fleet,
        inventory_digest=inventory.digest,
        tasks_digest=tasks.digest,
        snapshot=replace(snapshot, manager=manager),
        settled=assignment.settled,
        steps=diff_assignment(assignment, tasks, snapshot, manager),
        expected=assignment.expected,
        demand_spreads=assignment.demand_spreads,
        overuses=find_overuses(inventory, tasks, snapshot),
        shortages=assignment.shortages,
        certificate=assignment.certificate,
        frozen=assignment.frozen,
        unseen=assignment.unseen,
        tasks_left_alone=_list_tasks_left_alone(assignment.policy, tasks, snapshot, manager),
    )


def diff_assignment(
    assignment: Assignment, tasks: Tasks, snapshot: Snapshot, manager: ManagerState
) -> tuple[Step, ...]:
    """One step per decision, in sequence order, then a stop for each managed task that left its file.

    A task that already is as decided is kept and never started again (handoff latency avoidance).
    No unmanaged task is ever stopped.
    """
    found = _collect_managed_tasks(snapshot)
    steps = _follow_needs(
        [
            _build_step(
                decision, tasks, found.get(decision.task, {}) if _is_managed_decision(decision, tasks) else {}
            )
            for decision in assignment.decisions
        ],
        tasks,
        found,
    )
    if assignment.standbys:
        steps = tuple(replace(step, standbys=assignment.standbys.get(step.task, ())) for step in steps)
    copies = _collect_standbys(snapshot)
    if found.keys() <= tasks.tasks.keys() and copies.keys() <= tasks.tasks.keys():
        return steps
    others = _list_tasks_left_alone(assignment.policy, tasks, snapshot, manager)
    left = sorted((found.keys() | copies.keys()) - tasks.tasks.keys() - others.keys(), key=natural_key)
    return (
        *steps,
        *(
            _build_removal_step(name, found.get(name, {}), copies.get(name, {}), tasks, manager)
            for name in left
        ),
    )


def _follow_needs(
    steps: Sequence[Step], tasks: Tasks, found: Mapping[str, SamplesByHost]
) -> tuple[Step, ...]:
    """``steps``, in sequence order, with a restart for each kept task whose predecessor is restarted here,
    or was since the task was started (``restart: with``).
    """
    if not any(need.restart is not None for task in tasks.tasks.values() for need in task.needs):
        return tuple(steps)
    marks, followed = _mark_runs(steps, found), dict[str, Step]()
    for step in steps:
        task = tasks.tasks.get(step.task)
        needs = list_followed_needs(task) if task is not None and step.action is Action.KEEP else ()
        sample = found.get(step.task, {}).get(step.decision.host or "")
        cause = None
        if needs and task is not None and sample is not None:
            begun = (need.task for need in needs if need.task in followed and _starts(followed[need.task]))
            cause = next(begun, None) or find_restarted_need(task, sample.needed, marks)
        followed[step.task] = step if cause is None else _restart_with(step, cause, found[step.task])
    return tuple(followed.values())


def _starts(step: Step) -> bool:
    return step.action in (Action.START, Action.MOVE, Action.RESTART)


def _mark_runs(steps: Sequence[Step], found: Mapping[str, SamplesByHost]) -> dict[str, str]:
    """The mark of the run of each task that lives where it is decided to be."""
    samples = {step.task: found.get(step.task, {}).get(step.decision.host or "") for step in steps}
    return {
        name: mark_run(sample.instance, sample.restarts)
        for name, sample in samples.items()
        if sample is not None and sample.state.alive
    }


def _restart_with(step: Step, cause: str, found: SamplesByHost) -> Step:
    decision = replace(step.decision, reason=Reason.NEED_RESTARTED, subject=cause)
    instances = {host: sample.instance for host, sample in found.items()}
    return replace(step, decision=decision, action=Action.RESTART, instances=instances)


def _list_tasks_left_alone(
    policy: Policy, tasks: Tasks, snapshot: Snapshot, manager: ManagerState
) -> dict[str, str]:
    """The running tasks of task files that were not given, by name with their file."""
    found, copies = _collect_managed_tasks(snapshot), _collect_standbys(snapshot)
    seen = {
        name: [*found.get(name, {}).values(), *copies.get(name, {}).values()]
        for name in sorted((found.keys() | copies.keys()) - tasks.tasks.keys(), key=natural_key)
    }
    return {
        name: find_task_file(name, samples, manager)
        for name, samples in seen.items()
        if is_left_alone(name, samples, tasks, manager, policy)
    }


def select_targets(plan: Plan, targets: Collection[str]) -> Plan:
    """The plan with actions on ``targets`` alone; the decisions of the others are shown only."""
    return replace(
        plan, steps=tuple(step if step.task in targets else _disable_step(step) for step in plan.steps)
    )


def _disable_step(step: Step) -> Step:
    return replace(
        step,
        action=Action.NONE if step.action.changes else step.action,
        stop=(),
        instances={},
        changed=(),
        standbys=(),
    )


def _collect_managed_tasks(snapshot: Snapshot) -> dict[str, dict[str, TaskSample]]:
    """Every managed task with a process on a reachable host, by task and host in natural order."""
    found: dict[str, dict[str, TaskSample]] = {}
    for host in sorted(snapshot.hosts, key=natural_key):
        sample = snapshot.hosts[host]
        for name, task in sample.tasks.items() if sample.ok else ():
            if task.managed and (task.state.alive or (task.pid > 0 and task.state is not TaskState.FAILED)):
                found.setdefault(name, {})[host] = task
    return found


def _collect_standbys(snapshot: Snapshot) -> dict[str, dict[str, TaskSample]]:
    """Every living copy on a reachable host, by task and host in natural order."""
    found: dict[str, dict[str, TaskSample]] = {}
    if not any(sample.standbys for sample in snapshot.hosts.values()):
        return found
    for host in sorted(snapshot.hosts, key=natural_key):
        sample = snapshot.hosts[host]
        for name, copy in sample.standbys.items() if sample.ok else ():
            if copy.state.alive:
                found.setdefault(name, {})[host] = copy
    return found


def _build_step(decision: Decision, tasks: Tasks, found: SamplesByHost) -> Step:
    """The action that carries out one decision, and the hosts on which copies of the task are stopped."""
    if decision.reason is Reason.UNMANAGED:
        return Step(decision=decision, action=Action.KEEP if decision.host is not None else Action.NONE)
    action = _choose_action(decision, found)
    changed = _list_changed_fields(decision, tasks, found) if action is Action.KEEP else ()
    if changed:
        decision, action = replace(decision, reason=Reason.SPEC_CHANGED), Action.RESTART
    elif action is Action.KEEP and (orphan := _find_orphan(decision, found)) is not None:
        action = Action.ADOPT if orphan.adoptable else Action.RESTART
        decision = replace(decision, reason=Reason.ORPHANED)
    stop = _list_surplus_hosts(decision, action, found)
    concerned = found if action is not Action.KEEP else {host: found[host] for host in stop}
    instances = {host: sample.instance for host, sample in concerned.items()}
    return Step(decision=decision, action=action, instances=instances, stop=stop, changed=changed)


def _find_orphan(decision: Decision, found: SamplesByHost) -> TaskSample | None:
    """The kept instance, where it lives without a supervisor."""
    sample = found.get(decision.host or "")
    return sample if sample is not None and sample.orphaned else None


def _is_managed_decision(decision: Decision, tasks: Tasks) -> bool:
    task = tasks.tasks.get(decision.task)
    return decision.reason is not Reason.UNMANAGED and (task is None or task.managed)


def _choose_action(decision: Decision, found: SamplesByHost) -> Action:
    match decision.verdict:
        case Verdict.PLACED:
            return _choose_start_action(decision, found)
        case Verdict.KEPT:
            return Action.KEEP
        case Verdict.HELD:
            return Action.HOLD
        case Verdict.COMPLETED:
            return Action.COMPLETE if found else Action.NONE
        case Verdict.UNPLACED:
            return Action.STOP if found and decision.reason is Reason.PREEMPTED else Action.UNPLACED


def _choose_start_action(decision: Decision, found: SamplesByHost) -> Action:
    """A move from another host; a restart where another instance is on the host; else a start."""
    if decision.previous_host in found and decision.previous_host != decision.host:
        return Action.MOVE
    other = found.get(decision.host or "")
    replaces = other is not None and (other.state.alive or other.state is TaskState.COMPLETED)
    return Action.RESTART if replaces else Action.START


def _list_changed_fields(decision: Decision, tasks: Tasks, found: SamplesByHost) -> tuple[str, ...]:
    """The fields in which the running instance differs; ``("spec",)`` where the host does not know which."""
    sample, task = found.get(decision.host or ""), tasks.tasks.get(decision.task)
    if sample is None or task is None or sample.spec_hash in ("", task.spec_hash):
        return ()
    before, now = sample.fields, task.spec_fields
    names = (*now, *sorted(before.keys() - now.keys())) if before else ()
    return tuple(name for name in names if before.get(name) != now.get(name)) or ("spec",)


def _list_surplus_hosts(decision: Decision, action: Action, found: SamplesByHost) -> tuple[str, ...]:
    """Hosts with a surplus copy, besides the one that a move or a complete stops.

    A copy where a move goes to is surplus too: nothing starts beside it.
    """
    if action is Action.COMPLETE:
        keep = {decision.previous_host or next(iter(found))}
    elif decision.host is None:
        keep = set(found)
    else:
        keep = {decision.previous_host or "" if action is Action.MOVE else decision.host}
    return tuple(host for host in found if host not in keep)


def _build_removal_step(
    name: str, found: SamplesByHost, copies: SamplesByHost, tasks: Tasks, manager: ManagerState
) -> Step:
    """Stop a managed task that its file no longer lists, or that is pruned; perhaps only its copies are
    left.
    """
    given = tasks.is_given(find_task_file(name, [*found.values(), *copies.values()], manager))
    reason = Reason.LEFT_FILE if given else Reason.PRUNED
    known = manager.placements.get(name)
    host = known.host if known is not None and known.host in found else next(iter(found), None)
    decision = Decision(task=name, verdict=Verdict.UNPLACED, reason=reason, previous_host=host)
    return Step(
        decision=decision,
        action=Action.STOP if found else Action.NONE,
        instances={host: sample.instance for host, sample in found.items()},
        stop=tuple(other for other in found if other != host),
        standbys=stop_copies(
            {place: copy.instance for place, copy in copies.items()}, StandbyReason.LEFT_FILE
        ),
    )
