"""Changes of the fleet since a saved plan was made. Pure."""

from collections.abc import Iterator, Mapping

from edgectl.model.assignment import Reason
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample
from edgectl.names import natural_key
from edgectl.units import format_rate

# A load that moved by more than this share of the capacity makes another plan likely.
LOAD_TOLERANCE = 0.10
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
    if before.done != now.done:
        yield "the tasks marked done changed"


def _list_contact_drift(plan: Plan, now: ManagerState) -> Iterator[str]:
    """Hosts whose tasks the plan replaces although they answered since: those tasks may run."""
    before = plan.snapshot.manager or ManagerState()
    replaced = {step.decision.subject or "" for step in plan.steps if step.decision.reason is Reason.REPLACED}
    for host in sorted(replaced, key=natural_key):
        later = now.contact.get(host, 0.0) > before.contact.get(host, 0.0) + CONTACT_TOLERANCE_S
        if later or (host in before.fenced and host not in now.fenced):
            yield f"{host} was in touch since, or is no longer fenced"


def _list_host_drift(name: str, before: HostSample, now: HostSample) -> Iterator[str]:
    if before.ok != now.ok:
        yield f"{name} answers again" if now.ok else f"{name} no longer answers"
        return
    yield from _list_task_drift(name, before.tasks, now.tasks)
    for resource in HOST_RESOURCES:
        if resource.name not in before.usage or resource.name not in now.usage:
            continue
        was, found = before.usage[resource.name], now.usage[resource.name]
        if _is_beyond_tolerance(was.used, found.used, found.capacity):
            show = resource.unit.format
            yield f"{resource} of {name} went from {show(was.used)} to {show(found.used)}{resource.unit.word}"
    for robot, link in now.links.items():
        old = before.links.get(robot)
        if old is not None and _is_beyond_tolerance(
            old.used_bytes_per_s, link.used_bytes_per_s, link.capacity_bytes_per_s
        ):
            change = f"{format_rate(old.used_bytes_per_s)} to {format_rate(link.used_bytes_per_s)}"
            yield f"load of the link {name}-{robot} went from {change}"


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


def _is_beyond_tolerance(before: float, now: float, capacity: float) -> bool:
    return abs(now - before) > LOAD_TOLERANCE * capacity
