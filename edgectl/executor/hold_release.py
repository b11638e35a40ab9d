# SPDX-License-Identifier: Apache-2.0
"""Release robots left on hold by an interrupted or failed handoff."""

from collections.abc import Callable
from functools import partial

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.executor import host_requests
from edgectl.executor.action_phases import get_up_time
from edgectl.model.check import Check, CheckLocation
from edgectl.model.inventory import Host, Inventory
from edgectl.model.standby import is_standby_entry
from edgectl.model.task import Task, Tasks
from edgectl.transport.agent_client import ask_host
from edgectl.transport.base import Transport
from edgectl.transport.fleet_lease import FleetLease

_MARGIN_S = 15.0
# How long an instance that is still starting is waited for.
_WAIT_S = 15.0
Warn = Callable[[str], None]
Ask = Callable[[Host, host_requests.Request, float], host_requests.Request]


def release_hold(
    name: str,
    located: str | None,
    inventory: Inventory,
    tasks: Tasks,
    transport: Transport,
    warn: Warn,
    lease: FleetLease | None = None,
) -> bool:
    """Run the release hook of a task if an instance of it is ready on ``located``.

    False where the robot stays on hold; the next apply tries again. A task without a hook has nothing to
    release.
    """
    task = tasks.tasks.get(name)
    rule = task.handoff.release if task else None
    if task is None or rule is None:
        return True
    host = inventory.hosts.get(located or "")
    what = task.robots[0] if task.robots else name
    ask = partial(_ask_host, transport, lease)
    try:
        if host is None or not _is_instance_ready(task, host, inventory, ask):
            warn(
                f"{what} STILL HOLDS: no instance of {name} is ready; "
                "it is released once an apply gets one ready"
            )
            return False
        if _ask_check(task, rule, host, inventory, ask):
            return True
    except HostError as error:
        warn(f"{what} may still hold for {name}: {error.message}")
        return False
    warn(f"{what} may still hold for {name}: its release hook failed")
    return False


def _is_instance_ready(task: Task, host: Host, inventory: Inventory, ask: Ask) -> bool:
    """Whether the task is ready on ``host``; a check on the robot is run again: its result may be lost."""
    entry = _ask_task_entry(task, host, ask)
    instance, state = str(entry.get("instance")), entry.get("state")
    if is_standby_entry(entry):
        return False
    if state == protocol.STARTING or (state == protocol.RUNNING and task.ready is None):
        wait_s = min(_WAIT_S, task.ready.timeout if task.ready else _WAIT_S)
        entry = ask(
            host,
            host_requests.build_wait_request(
                task.name, host, instance=instance, timeout_s=wait_s, up_s=get_up_time(task)
            ),
            wait_s,
        )
        state = entry.get("state")
    if state == protocol.READY:
        return True
    if state != protocol.RUNNING or entry.get("detail") or entry.get("settled") is False:
        return False
    if task.ready is None:
        return True
    if task.ready.on is CheckLocation.HOST or not _ask_check(task, task.ready, host, inventory, ask):
        return False
    ask(host, host_requests.build_mark_ready_request(task.name, host, instance=instance), 0.0)
    return True


def _ask_task_entry(task: Task, host: Host, ask: Ask) -> host_requests.Request:
    """The entry of the task on the host; empty where it does not run."""
    found = ask(host, host_requests.build_status_request(host, task.name), 0.0).get("tasks")
    entry = found.get(task.name) if isinstance(found, dict) else None
    return entry if isinstance(entry, dict) else {}


def _ask_check(task: Task, rule: Check, host: Host, inventory: Inventory, ask: Ask) -> bool:
    where = inventory.hosts[task.robots[0]] if rule.on is CheckLocation.ROBOT and task.robots else host
    return (
        ask(
            where,
            host_requests.build_check_request(task, rule, where, inventory.hosts),
            rule.timeout,
        ).get("exit")
        == 0
    )


def _ask_host(
    transport: Transport,
    lease: FleetLease | None,
    host: Host,
    request: host_requests.Request,
    seconds: float,
) -> host_requests.Request:
    """``seconds``: how long the host may work on it."""
    if lease is not None and request["op"] in protocol.CHANGING_OPS:
        request = {**request, "lease": lease.sign(host.name)}
    return ask_host(transport, host, request, timeout=seconds + _MARGIN_S, connect_timeout=_MARGIN_S)
