"""An agent's document -> a HostSample. Pure and strict: anything odd costs this host its sample, and no other host anything."""

import dataclasses
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field

from edgectl.agent.link import protocol
from edgectl.errors import ReplyError
from edgectl.gateway.reply_fields import (
    ReplyDocument,
    escape_unprintable,
    get_finite,
    get_flag,
    get_int,
    get_lines,
    get_number,
    get_object,
    get_objects,
    get_optional,
    get_positive,
    get_text,
)
from edgectl.model.inventory import Host, Role
from edgectl.model.resource import HOST_RESOURCES, RESOURCES, Resource, Usage
from edgectl.model.snapshot import (
    CapacitySource,
    DeviceSample,
    HostSample,
    HostStatus,
    InterfaceSample,
    LinkSample,
    ResourceUsage,
    TaskSample,
    TaskState,
)

PROTOCOL_VERSION = protocol.VERSION
# Delta_thp where nothing else is known: 54 Mbit/s, the paper's wireless network.
ASSUMED_BYTES_PER_S = 6.75e6
# Of one task, and how they are named: as the agent reads them.
_STATES = {state.value: state for state in TaskState}


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplyContext:
    """What the manager knows beside the document.

    ``answered_at`` (s since 1970, the manager's clock): when the document came.
    ``declared`` and ``measured``: bytes/s by robot of this host's links.
    ``robots``: those asked for. ``blind``: robots that are never contacted and so never count as unreachable.
    ``reopened``: instances whose end, completed or given up, no longer counts.
    """

    host: Host
    answered_at: float
    declared: Mapping[str, float] = field(default_factory=dict)
    measured: Mapping[str, float] = field(default_factory=dict)
    robots: tuple[str, ...] = ()
    blind: frozenset[str] = frozenset()
    reopened: frozenset[str] = frozenset()


def decode_host_sample(document: ReplyDocument, context: ReplyContext) -> HostSample:
    """The sample of one host.

    A slice (declared capacity) has Delta = its capacity and gamma = its base load plus its own task trees; any other host's gamma is
    that of the whole device. Tasks whose ``done_when`` said yes are taken out of gamma: they are about to be stopped.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range, or the document is of another host.
    """
    _check_origin(document, context.host)
    tasks = _decode_tasks(document, context)
    sample = HostSample(
        role=context.host.role,
        status=HostStatus.OK,
        sample_age_s=get_optional(document, "sample_age_s", get_number) or 0.0,
        resident=get_flag(document, "resident", default=False),
        usage=_decode_usages(document, context.host, tasks),
        links=_decode_links(document, context, tasks) if context.host.role is Role.EDGE else {},
        tasks=tasks,
        device=_decode_device(document, context.answered_at),
        generations=_decode_generations(document, tasks),
    )
    return apply_done_tasks(sample, decode_done_tasks(document))


def _check_origin(document: ReplyDocument, host: Host) -> None:
    if document.get("v") != PROTOCOL_VERSION:
        raise ReplyError(
            f"document version {escape_unprintable(repr(document.get('v')))[:80]}, expected {PROTOCOL_VERSION}"
        )
    if document.get("op") != protocol.OP_PROBE or document.get("host") != host.name:
        raise ReplyError(
            f"document of {escape_unprintable(repr(document.get('host')))[:80]}, expected {host.name}"
        )


def decode_done_tasks(document: ReplyDocument) -> frozenset[str]:
    """Tasks whose ``done_when`` check said yes on this host."""
    return frozenset(
        name
        for name, entry in get_objects(document, "checks").items()
        if get_optional(entry, "exit", get_signed_int) == 0
    )


def get_signed_int(document: ReplyDocument, key: str) -> int:
    """Any integer: an exit status, negative for a signal."""
    return get_int(document, key, low=-(2**31))


def _decode_tasks(document: ReplyDocument, context: ReplyContext) -> dict[str, TaskSample]:
    """The tasks of the host, without runs that are over and were reopened."""
    tasks = {
        name: _decode_task(name, entry, context) for name, entry in get_objects(document, "tasks").items()
    }
    return {
        name: task
        for name, task in tasks.items()
        if not (_has_ended(task) and task.instance in context.reopened)
    }


def _decode_generations(document: ReplyDocument, tasks: Mapping[str, TaskSample]) -> dict[str, int]:
    """What the tasks do not tell: a run that no longer counts has used its generation up all the same."""
    stated = get_object(document, "generations")
    found = {escape_unprintable(name): get_int(stated, name) for name in stated}
    for name, entry in get_objects(document, "tasks").items():
        if name not in tasks:
            found[name] = max(found.get(name, 0), get_optional(entry, "generation", get_int) or 0)
    return found


def _has_ended(task: TaskSample) -> bool:
    return task.state is TaskState.COMPLETED or task.given_up


def _decode_task(name: str, entry: ReplyDocument, context: ReplyContext) -> TaskSample:
    state = _STATES.get(get_text(entry, "state"))
    if state is None:
        raise ReplyError(f"tasks.{name}.state is not a state: {get_text(entry, 'state')[:80]}")
    links = {robot: get_number(get_object(entry, "links"), robot) for robot in get_object(entry, "links")}
    ended_s = get_optional(entry, "ended_s", get_number)
    return TaskSample(
        state=state,
        pid=get_optional(entry, "pid", get_int) or 0,
        started_at=context.answered_at - (get_optional(entry, "age_s", get_number) or 0.0),
        used=Usage(
            {
                resource.name: _sum_traffic(entry)
                if resource.per_link
                else get_optional(entry, resource.used_key, get_number) or 0.0
                for resource in RESOURCES
            }
        ),
        links=links or None,
        instance=get_text(entry, "instance"),
        spec_hash=get_text(entry, "spec_hash"),
        generation=get_optional(entry, "generation", get_int) or 0,
        managed=get_flag(entry, "managed", default=True),
        restarts=get_optional(entry, "restarts", get_int) or 0,
        exit_code=get_optional(entry, "exit_code", get_signed_int),
        detail=get_text(entry, "detail"),
        fields={
            key: get_text(get_object(entry, "fields"), key)
            for key in get_object(entry, "fields")
            if key.isidentifier()
        },
        last_exit=get_optional(entry, "last_exit", get_signed_int),
        log_tail=get_lines(entry, "log_tail"),
        limits=get_text(entry, "limits"),
        given_up=get_flag(entry, "given_up", default=False),
        ended_at=None if ended_s is None else context.answered_at - ended_s,
        metrics=_decode_metrics(get_object(entry, "metrics")),
    )


def _decode_metrics(values: ReplyDocument) -> dict[str, float]:
    """What the application says of itself; the agent lets nothing else pass."""
    if len(values) > protocol.MAX_TASK_METRICS:
        raise ReplyError(f"more than {protocol.MAX_TASK_METRICS} metrics of one task")
    for name in values:
        if not protocol.is_metric_name(name):
            raise ReplyError(f"not the name of a metric: {escape_unprintable(name)[:80]}")
    return {name: get_finite(values, name, most=sys.float_info.max) for name in values}


def _select_alive(tasks: Mapping[str, TaskSample]) -> list[TaskSample]:
    return [task for task in tasks.values() if task.state.alive]


def _decode_usages(
    document: ReplyDocument, host: Host, tasks: Mapping[str, TaskSample]
) -> dict[str, ResourceUsage]:
    return {
        resource.name: _decode_usage(document, host, tasks, resource)
        for resource in HOST_RESOURCES
        if not resource.declared_only or _get_declared(host, resource)
    }


def _decode_usage(
    document: ReplyDocument, host: Host, tasks: Mapping[str, TaskSample], resource: Resource
) -> ResourceUsage:
    """Capacity and use of one resource: of the device, of the slice, or of a declared budget that the host may be unable to read."""
    declared, name = _get_declared(host, resource), resource.name
    device = get_object(document, name)
    if resource.declared_only:
        return ResourceUsage(
            capacity=declared, used=get_optional(device, resource.used_key, get_number) or 0.0
        )
    capacity, used = get_positive(device, resource.capacity_key), get_number(device, resource.used_key)
    if host.is_slice:
        own = sum(task.used[name] for task in _select_alive(tasks))
        return ResourceUsage(capacity=declared, used=host.base[name] + own)
    return ResourceUsage(capacity=capacity, used=used)


def _get_declared(host: Host, resource: Resource) -> float:
    return host.capacity[resource.name] if host.capacity is not None else 0.0


def _decode_links(
    document: ReplyDocument, context: ReplyContext, tasks: Mapping[str, TaskSample]
) -> dict[str, LinkSample]:
    interfaces = _decode_interfaces(document)
    found = get_objects(document, "links")
    return {
        robot: _decode_link(robot, found[robot], context, interfaces, tasks)
        for robot in context.robots
        if robot in found
    }


def _decode_link(
    robot: str,
    entry: ReplyDocument,
    context: ReplyContext,
    interfaces: Mapping[str, InterfaceSample],
    tasks: Mapping[str, TaskSample],
) -> LinkSample:
    used = _sum_traffic(entry)
    if context.host.is_slice:
        used = sum((_get_link_usage(task, robot) for task in _select_alive(tasks)), 0.0)
    nic = interfaces.get(get_text(entry, "interface"))
    capacity, source = select_link_capacity(robot, context, nic.speed_bytes_per_s if nic else None)
    if robot not in context.blind and not get_flag(entry, "reachable", default=True):
        capacity = 0.0
    return LinkSample(
        capacity_bytes_per_s=capacity,
        used_bytes_per_s=used,
        rtt_ms=get_optional(entry, "rtt_ms", get_number),
        capacity_source=source,
    )


def _sum_traffic(entry: ReplyDocument) -> float:
    """In plus out, in bytes/s; what the host cannot tell counts as nothing."""
    return (get_optional(entry, "rx_bytes_per_s", get_number) or 0.0) + (
        get_optional(entry, "tx_bytes_per_s", get_number) or 0.0
    )


def _get_link_usage(task: TaskSample, robot: str) -> float:
    return (task.links or {}).get(robot, 0.0)


def select_link_capacity(
    robot: str, context: ReplyContext, speed: float | None
) -> tuple[float, CapacitySource]:
    """Delta_thp of the link to ``robot`` and where it comes from: declared, measured, the interface's speed, or assumed."""
    if robot in context.declared:
        return context.declared[robot], CapacitySource.DECLARED
    if robot in context.measured:
        return context.measured[robot], CapacitySource.MEASURED
    if speed:
        return speed, CapacitySource.NIC
    return ASSUMED_BYTES_PER_S, CapacitySource.ASSUMED


def _decode_interfaces(document: ReplyDocument) -> dict[str, InterfaceSample]:
    return {
        name: InterfaceSample(
            rx_bytes_per_s=get_number(entry, "rx_bytes_per_s"),
            tx_bytes_per_s=get_number(entry, "tx_bytes_per_s"),
            speed_bytes_per_s=get_optional(entry, "speed_bytes_per_s", get_number),
        )
        for name, entry in get_objects(document, "interfaces").items()
    }


def _decode_device(document: ReplyDocument, answered_at: float) -> DeviceSample:
    """Figures that are shown and never used to decide; the host's clock stands here only as a skew."""
    wall = get_optional(document, "wall", get_finite)
    share = get_optional(document, "gpu_share", get_number)
    return DeviceSample(
        load_1m=get_optional(document, "load_1m", get_number),
        temperature_c=get_optional(document, "temperature_c", get_finite),
        gpu_share=None if share is None else min(share, 1.0),
        boot_id=get_text(document, "boot_id"),
        clock_skew_s=None if wall is None else wall - answered_at,
        interfaces=_decode_interfaces(document),
    )


def apply_done_tasks(sample: HostSample, done: frozenset[str]) -> HostSample:
    """``sample`` with the tasks ``done`` COMPLETED, their pid kept and their use taken out of gamma (floor 0)."""
    leaving = {name: task for name, task in sample.tasks.items() if name in done and task.state.alive}
    if not leaving or not sample.measured:
        return sample
    return dataclasses.replace(
        sample,
        usage={
            name: dataclasses.replace(
                usage, used=max(0.0, usage.used - sum(task.used[name] for task in leaving.values()))
            )
            for name, usage in sample.usage.items()
        },
        links={
            robot: dataclasses.replace(
                link,
                used_bytes_per_s=max(
                    0.0,
                    link.used_bytes_per_s - sum(_get_link_usage(task, robot) for task in leaving.values()),
                ),
            )
            for robot, link in sample.links.items()
        },
        tasks={
            name: dataclasses.replace(task, state=TaskState.COMPLETED) if name in leaving else task
            for name, task in sample.tasks.items()
        },
    )
