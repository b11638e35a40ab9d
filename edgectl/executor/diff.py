"""Algorithm 2 up to the point where something happens: an assignment against what runs -> the steps of a plan. Pure."""

from collections.abc import Collection, Mapping
from dataclasses import replace

from edgectl.model.assignment import Assignment, Decision, Reason, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.memory import Memory
from edgectl.model.order import natural_key
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.task import Tasks

Found = Mapping[str, TaskSample]  # the samples of one task, by host


def plan_of(inventory: Inventory, tasks: Tasks, snapshot: Snapshot, memory: Memory, assignment: Assignment) -> Plan:
    """The plan of an assignment, with the snapshot and the memory that it was made from, so that it can be repeated from itself."""
    return Plan(
        created_at=snapshot.taken_at,
        policy=assignment.policy,
        inventory_digest=inventory.digest,
        tasks_digest=tasks.digest,
        snapshot=replace(snapshot, memory=memory),
        settled=assignment.settled,
        steps=diff(assignment, tasks, snapshot, memory),
        expected=assignment.expected,
        uneven=assignment.uneven,
        frozen=assignment.frozen,
        unseen=assignment.unseen,
    )


def diff(assignment: Assignment, tasks: Tasks, snapshot: Snapshot, memory: Memory) -> tuple[Step, ...]:
    """One step per decision, in sequence order, then a stop for each task of ours that runs but left the file.

    What is already as decided is kept and never started again (handoff latency avoidance). Nothing unmanaged is ever stopped.
    """
    found = _found(snapshot)
    steps = [_step(decision, tasks, found.get(decision.task, {}) if _ours(decision, tasks) else {}) for decision in assignment.decisions]
    left = sorted(found.keys() - tasks.tasks.keys(), key=natural_key)
    return (*steps, *(_left_file(name, found[name], memory) for name in left))


def select(plan: Plan, targets: Collection[str]) -> Plan:
    """The plan with action on ``targets`` alone: the decisions of the others are shown, and nothing is done about them."""
    return replace(plan, steps=tuple(step if step.task in targets else _inert(step) for step in plan.steps))


def _inert(step: Step) -> Step:
    return replace(step, action=Action.NONE if step.action.changes else step.action, stop=(), instances={}, changed=())


def _found(snapshot: Snapshot) -> dict[str, dict[str, TaskSample]]:
    """Every task of ours that has a process on a reachable host, by task and host in natural order."""
    found: dict[str, dict[str, TaskSample]] = {}
    for host in sorted(snapshot.hosts, key=natural_key):
        sample = snapshot.hosts[host]
        for name, task in sample.tasks.items() if sample.ok else ():
            if task.managed and (task.state.alive or (task.pid > 0 and task.state is not TaskState.FAILED)):
                found.setdefault(name, {})[host] = task
    return found


def _step(decision: Decision, tasks: Tasks, found: Found) -> Step:
    """The action that makes one decision true, and where copies of the task must go."""
    if decision.reason is Reason.UNMANAGED:
        return Step(decision=decision, action=Action.KEEP if decision.host is not None else Action.NONE)
    action = _action(decision, found)
    changed = _spec_changed(decision, tasks, found) if action is Action.KEEP else ()
    if changed:
        decision, action = replace(decision, reason=Reason.SPEC_CHANGED), Action.RESTART
    stop = _surplus(decision, action, found)
    concerned = found if action is not Action.KEEP else {host: found[host] for host in stop}
    return Step(
        decision=decision, action=action, instances={host: sample.instance for host, sample in concerned.items()}, stop=stop,
        changed=changed,
    )  # fmt: skip


def _ours(decision: Decision, tasks: Tasks) -> bool:
    task = tasks.tasks.get(decision.task)
    return decision.reason is not Reason.UNMANAGED and (task is None or task.managed)


def _action(decision: Decision, found: Found) -> Action:
    match decision.verdict:
        case Verdict.PLACED:
            return _arrival(decision, found)
        case Verdict.KEPT:
            return Action.KEEP
        case Verdict.HELD:
            return Action.HOLD
        case Verdict.COMPLETED:
            return Action.COMPLETE if found else Action.NONE
        case Verdict.UNPLACED:
            return Action.UNPLACED


def _arrival(decision: Decision, found: Found) -> Action:
    """A move from where it runs; a restart where an instance that is done with lingers on the very host; else a start."""
    if decision.previous_host in found and decision.previous_host != decision.host:
        return Action.MOVE
    lingering = found.get(decision.host or "")
    return Action.RESTART if lingering is not None and lingering.state is TaskState.COMPLETED else Action.START


def _spec_changed(decision: Decision, tasks: Tasks, found: Found) -> tuple[str, ...]:
    """The fields in which what runs was started from another specification: ``("spec",)`` where the host does not say which."""
    sample, task = found.get(decision.host or ""), tasks.tasks.get(decision.task)
    if sample is None or task is None or sample.spec_hash in ("", task.spec_hash):
        return ()
    before, now = sample.fields, task.spec_fields
    names = (*now, *sorted(before.keys() - now.keys())) if before else ()
    return tuple(name for name in names if before.get(name) != now.get(name)) or ("spec",)


def _surplus(decision: Decision, action: Action, found: Found) -> tuple[str, ...]:
    """Hosts with a copy that should not be there, besides the one that a move or a complete takes away."""
    if action is Action.COMPLETE:
        keep = {decision.previous_host or next(iter(found))}
    elif decision.host is None:
        keep = set(found)
    else:
        keep = {decision.host, decision.previous_host or ""} if action is Action.MOVE else {decision.host}
    return tuple(host for host in found if host not in keep)


def _left_file(name: str, found: Found, memory: Memory) -> Step:
    """Stop what we started and nobody asks for any more."""
    known = memory.placements.get(name)
    host = known.host if known is not None and known.host in found else next(iter(found))
    decision = Decision(task=name, verdict=Verdict.UNPLACED, reason=Reason.LEFT_FILE, previous_host=host)
    return Step(
        decision=decision, action=Action.STOP, instances={host: sample.instance for host, sample in found.items()},
        stop=tuple(other for other in found if other != host),
    )  # fmt: skip
