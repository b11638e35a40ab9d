"""What a handoff that was cut off, or that ended with no ready instance, leaves behind besides processes: a robot that still holds."""

from collections.abc import Callable

from edgectl.errors import HostError
from edgectl.executor import requests
from edgectl.model.inventory import Host, Inventory
from edgectl.model.task import Check, Task, Tasks, Where
from edgectl.transport.base import Transport
from edgectl.transport.call import call

_MARGIN_S = 15.0
# How long an instance that is still starting is waited for.
_WAIT_S = 15.0
Warn = Callable[[str], None]


def release(name: str, located: str | None, inventory: Inventory, tasks: Tasks, transport: Transport, warn: Warn) -> bool:
    """Run the release hook of a task, if an instance of it is ready on ``located``. False where it holds on; the next apply tries again.

    A task without such a hook (any more) has nothing to release.
    """
    task = tasks.tasks.get(name)
    rule = task.handoff.release if task else None
    if task is None or rule is None:
        return True
    host = inventory.hosts.get(located or "")
    what = task.robots[0] if task.robots else name
    try:
        if host is None or not _steers(task, host, inventory, transport):
            warn(f"{what} STILL HOLDS: no instance of {name} is ready; it is released once an apply gets one ready")
            return False
        if _says_yes(task, rule, host, inventory, transport):
            return True
    except HostError as error:
        warn(f"{what} may still hold for {name}: {error.message}")
        return False
    warn(f"{what} may still hold for {name}: its release hook failed")
    return False


def _steers(task: Task, host: Host, inventory: Inventory, transport: Transport) -> bool:
    """Whether the task is ready on ``host``. A ready check on the robot is asked again: nobody may have waited for its answer."""
    entry = _entry(task, host, transport)
    instance, state = str(entry.get("instance")), entry.get("state")
    if state == "starting":
        wait_s = min(_WAIT_S, task.ready.timeout if task.ready else _WAIT_S)
        entry = _ask(transport, host, requests.wait(task.name, host, instance=instance, timeout_s=wait_s), wait_s)
        state = entry.get("state")
    if state == "ready":
        return True
    if state != "running" or entry.get("detail"):
        return False
    if task.ready is None:
        return True
    if task.ready.on is Where.HOST or not _says_yes(task, task.ready, host, inventory, transport):
        return False
    _ask(transport, host, requests.mark_ready(task.name, host, instance=instance), 0.0)
    return True


def _entry(task: Task, host: Host, transport: Transport) -> requests.Request:
    """What the host knows of the task; nothing where it does not run."""
    found = _ask(transport, host, requests.status(host, task.name), 0.0).get("tasks")
    entry = found.get(task.name) if isinstance(found, dict) else None
    return entry if isinstance(entry, dict) else {}


def _says_yes(task: Task, rule: Check, host: Host, inventory: Inventory, transport: Transport) -> bool:
    where = inventory.hosts[task.robots[0]] if rule.on is Where.ROBOT and task.robots else host
    return _ask(transport, where, requests.check(task, rule, where, inventory.hosts), rule.timeout).get("exit") == 0


def _ask(transport: Transport, host: Host, request: requests.Request, seconds: float) -> requests.Request:
    with transport.connect(host, timeout=_MARGIN_S) as session:
        return call(session, request, timeout=seconds + _MARGIN_S)
