"""Changes of the fleet since a saved plan was made. Pure."""

from collections.abc import Iterator, Mapping

from edgectl.model.assignment import Reason
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample
from edgectl.names import natural_key

# Contacts are kept by uptime; converted to the wall clock, one instant may differ by so many seconds.
CONTACT_TOLERANCE_S = 1.0


def list_drift(plan: Plan, snapshot: Snapshot, manager: ManagerState) -> tuple[str, ...]:
    """The changes of the fleet since ``plan`` was made, one line each; empty where it still holds."""
    changes = [
        *_list_mark_drift(plan.snapshot.manager or ManagerState(), manager),
        *_list_contact_drift(plan, manager),
    ]
    for name, host in snapshot.hosts.items():
        before = plan.snapshot.hosts.get(name)
        if before is not None:
            changes += _list_host_drift(name, before, host)
    return tuple(changes)


def _list_mark_drift(before: ManagerState, now: ManagerState) -> Iterator[str]:
    if (before.cordons, before.draining) != (now.cordons, now.draining):
        yield "the cordoned hosts changed"
    if before.pins != now.pins:
        yield "the pinned tasks changed"
    if before.done != now.done:
        yield "the tasks marked done changed"


def _list_contact_drift(plan: Plan, now: ManagerState) -> Iterator[str]:
    """Hosts whose tasks the plan replaces although they answered since: those tasks may run."""
    before = plan.snapshot.manager or ManagerState()
    replaced = {step.decision.subject or "" for step in plan.steps if step.decision.reason is Reason.REPLACED}
    for host in sorted(replaced, key=natural_key):
        later = now.contact.get(host, 0.0) > before.contact.get(host, 0.0) + CONTACT_TOLERANCE_S
        if later or (host in before.fenced and host not in now.fenced):
            yield f"{host} answered since, or is no longer fenced"


def _list_host_drift(name: str, before: HostSample, now: HostSample) -> Iterator[str]:
    if before.ok != now.ok:
        yield f"{name} answers again" if now.ok else f"{name} no longer answers"
        return
    yield from _list_task_drift(name, before.tasks, now.tasks)
    yield from _list_copy_drift(name, before.standbys, now.standbys)


def _list_task_drift(
    name: str, before: Mapping[str, TaskSample], now: Mapping[str, TaskSample]
) -> Iterator[str]:
    old = {task: sample.instance for task, sample in before.items() if sample.state.alive}
    new = {task: sample.instance for task, sample in now.items() if sample.state.alive}
    for task in sorted(old.keys() | new.keys()):
        if task not in new:
            yield f"{task} no longer runs on {name}"
        elif task not in old:
            yield f"{task} runs on {name} now"
        elif old[task] != new[task]:
            yield f"{task} was restarted on {name}"


def _list_copy_drift(
    name: str, before: Mapping[str, TaskSample], now: Mapping[str, TaskSample]
) -> Iterator[str]:
    old = {task: copy.instance for task, copy in before.items() if copy.state.alive}
    new = {task: copy.instance for task, copy in now.items() if copy.state.alive}
    for task in sorted(task for task in old.keys() | new.keys() if old.get(task) != new.get(task)):
        yield f"the standby of {task} on {name} changed"
