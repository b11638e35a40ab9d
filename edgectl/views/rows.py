# SPDX-License-Identifier: Apache-2.0
"""Rows of hosts, links and runs of tasks, as every document has them."""

from edgectl.formats.document import Document, without_none
from edgectl.model.inventory import Host, Inventory
from edgectl.model.manager_state import ManagerState, Pin
from edgectl.model.resource import HOST_RESOURCES, RESOURCES, SPARE_TERMS, TASK_RESOURCES
from edgectl.model.snapshot import DeviceSample, HostSample, LinkSample, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.units import format_instant
from edgectl.views.latency import encode_latency
from edgectl.views.other_tasks import encode_other_tasks
from edgectl.views.state import format_operator_mark, resolve_absent_task
from edgectl.views.usage import Amounts, compute_task_demand, subtract_demand


def encode_host_row(name: str, value: Snapshot, stated: Host | None = None) -> Document:
    """One host: the declarations of the inventory (without its environment) and the measurements."""
    declared = {} if stated is None else _encode_declarations(stated)
    mark = {"mark": format_operator_mark(name, value.manager) or None}
    sample = value.hosts.get(name)
    measured = {"status": "not probed"} if sample is None else _encode_measurements(sample)
    taken_at = {"taken_at": format_instant(value.taken_at)}
    return without_none(**({"host": name} | declared | taken_at | measured | mark))


def _encode_declarations(stated: Host) -> Document:
    return {
        "role": stated.role.value,
        "address": stated.host,
        "connection": stated.connection.value,
        "labels": dict(stated.labels),
        "limits": {
            name: limit for name, limit in stated.limits.items() if limit != 1 or name not in SPARE_TERMS
        },
        "max_temperature_c": stated.max_temperature,
        "onboard": stated.onboard if stated.role.value == "robot" else None,
    }


def _encode_measurements(sample: HostSample) -> Document:
    return {
        "role": sample.role.value,
        "status": sample.status.value,
        "error": sample.error or None,
        "hint": sample.hint or None,
        "sample_age_s": sample.sample_age_s if sample.ok else None,
        "resident": sample.resident or None,
        "counters": sample.counters or None,
        **encode_host_usage(sample),
        "links": {robot: encode_link_sample(link) for robot, link in sample.links.items()} or None,
        "task_names": [name for name, task in sample.tasks.items() if task.state.alive],
        "other_tasks": encode_other_tasks(sample.other_tasks),
        "foreign_tasks": encode_other_tasks(sample.foreign_tasks),
        "device": _encode_device(sample.device) or None,
    }


def encode_host_usage(sample: HostSample) -> Document:
    """Usage and capacity of each resource of a host."""
    return {
        resource.name: {
            f"used_{resource.unit.name}": found.used,
            f"capacity_{resource.unit.name}": found.capacity,
        }
        for resource in HOST_RESOURCES
        if (found := sample.usage.get(resource.name)) is not None
    }


def encode_link_sample(link: LinkSample) -> Document:
    """Capacity and traffic of one link."""
    return without_none(
        capacity_bytes_per_s=link.capacity_bytes_per_s,
        used_bytes_per_s=link.used_bytes_per_s,
        rtt_ms=link.rtt_ms,
        capacity_source=link.capacity_source.value,
        capacity_age_s=link.capacity_age_s,
        nominal_bytes_per_s=link.nominal,
        used_source=link.used_source.value,
        partial=link.partial or None,
    )


def _encode_device(device: DeviceSample) -> Document:
    interfaces = {
        name: without_none(
            rx_bytes_per_s=each.rx_bytes_per_s,
            tx_bytes_per_s=each.tx_bytes_per_s,
            speed_bytes_per_s=each.speed_bytes_per_s,
            level_dbm=each.level_dbm,
            retries_per_s=each.retries_per_s,
            access_point=each.access_point or None,
            joined_s=each.joined_s,
        )
        for name, each in device.interfaces.items()
    }
    return without_none(
        load_1m=device.load_1m,
        temperature_c=device.temperature_c,
        gpu_share=device.gpu_share,
        power_w=device.power_w,
        boot_id=device.boot_id or None,
        clock_skew_s=device.clock_skew_s,
        interfaces=interfaces or None,
    )


def list_task_runs(value: Snapshot) -> list[tuple[str, str, TaskSample]]:
    """(task, host, sample) of every task that any host reports, by task, then host."""
    runs = [(name, host, sample) for host, each in value.hosts.items() for name, sample in each.tasks.items()]
    return sorted(runs, key=lambda run: run[:2])


def find_task_demand(name: str, host: str, value: Snapshot, inventory: Inventory, tasks: Tasks) -> Amounts:
    """The demand of a task on its host; empty for a task that no file names."""
    task = tasks.tasks.get(name)
    if task is None:
        return {}
    return compute_task_demand(task, inventory.hosts.get(host), value.hosts[host], value.manager)


def compute_task_age(sample: TaskSample, value: Snapshot) -> float | None:
    """Seconds since this start, or since the end of what has ended; None where that is not known."""
    since = sample.started_at if sample.state.alive else sample.ended_at
    return max(0.0, value.taken_at - since) if since else None


def encode_pin(pin: Pin | None, now: float) -> Document | None:
    """The pin of an operator on a task; None: there is none, or it has ended."""
    if pin is None or not pin.is_active(now):
        return None
    until = None if pin.until is None else format_instant(pin.until)
    return {"pinned_to": pin.host, "pinned_at": format_instant(pin.since), "pinned_until": until}


def encode_run_row(name: str, host: str, sample: TaskSample, demand: Amounts, value: Snapshot) -> Document:
    """One task on one host: its state, its usage and its demand; of what has ended, no usage."""
    alive = sample.state.alive
    excess = subtract_demand(sample, demand) if alive else {}
    usage = {
        resource.name: without_none(
            **{
                f"used_{resource.unit.name}": sample.used[resource.name]
                if alive and resource in TASK_RESOURCES
                else None,
                f"demand_{resource.unit.name}": demand.get(resource.name),
                f"excess_{resource.unit.name}": excess.get(resource.name),
            }
        )
        for resource in RESOURCES
    }
    ended_at = None if sample.ended_at is None else format_instant(sample.ended_at)
    return without_none(
        task=name,
        host=host,
        taken_at=format_instant(value.taken_at),
        state=sample.state.value,
        detail=sample.detail or None,
        age_s=compute_task_age(sample, value),
        started_at=format_instant(sample.started_at) if sample.started_at else None,
        ended_at=ended_at,
        **{resource: amounts or None for resource, amounts in usage.items()},
        restarts=sample.restarts,
        pid=sample.pid or None,
        instance=sample.instance or None,
        generation=sample.generation or None,
        managed=sample.managed,
        given_up=sample.given_up or None,
        exit_code=sample.exit_code,
        last_exit=sample.last_exit,
        enforcement=sample.limits or None,
        partial=sample.partial or None,
        log_tail=list(sample.log_tail) or None,
        metrics=dict(sample.metrics) or None,
        latency=encode_latency(sample.latency),
        pin=_find_pin(name, value),
    )


def encode_absent_row(task: Task, value: Snapshot) -> Document:
    """A task that no host reports: its state, and where and when it was last known."""
    known = resolve_absent_task(task, value)
    return without_none(
        task=task.name,
        host=known.host,
        taken_at=format_instant(value.taken_at),
        state=known.state,
        contacted_at=None if known.contact is None else format_instant(known.contact),
        managed=task.managed,
        pin=_find_pin(task.name, value),
    )


def _find_pin(task: str, value: Snapshot) -> Document | None:
    return encode_pin((value.manager or ManagerState()).pins.get(task), value.taken_at)
