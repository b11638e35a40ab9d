# SPDX-License-Identifier: Apache-2.0
"""An agent's document -> a HostSample.

Pure and strict: anything odd costs this host its sample, and no other host anything.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import field

from edgectl.agent.link import protocol
from edgectl.dataclass import dataclass
from edgectl.errors import ReplyError
from edgectl.gateway.counted_traffic import attribute_counted_traffic
from edgectl.gateway.replies import (
    DEVICE_USAGE,
    GrantsReply,
    InterfaceReply,
    LinkReply,
    ProbeReply,
    ReplyDocument,
    TotalsReply,
    decode_reply,
)
from edgectl.gateway.task_reply import build_generations, build_task_samples, separate_standbys
from edgectl.model.inventory import Host, Role
from edgectl.model.resource import HOST_RESOURCES, POWER, Resource
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
    TrafficSource,
    UsageTotals,
)
from edgectl.model.text import escape_unprintable

PROTOCOL_VERSION = protocol.VERSION
# Delta_thp where nothing else is known: 54 Mbit/s, the paper's wireless network.
ASSUMED_BYTES_PER_S = 6.75e6
# Kernels report 0 and less where they know no speed.
_MIN_LINK_BYTES_PER_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplyContext:
    """What the manager knows beside the document.

    ``answered_at`` (s since 1970, the manager's clock): when the document came. ``declared`` and
    ``measured``: bytes/s by robot of this host's links. ``manager_id``: the name by which hosts know this
    manager; "" before it has changed anything. ``robots``: those asked for. ``blind``: robots that are never
    contacted and so never count as unreachable. ``reopened``: instances whose end, completed or given up, no
    longer counts. ``checked``: tasks whose ``done_when`` was to be checked there; ``detected``: tasks that
    were to be found by their rule. Other checks and detections were not requested, and do not count.
    ``robots_of``: the robots of each task of the files.
    """

    host: Host
    answered_at: float
    manager_id: str = ""
    declared: Mapping[str, float] = field(default_factory=dict)
    measured: Mapping[str, float] = field(default_factory=dict)
    robots: tuple[str, ...] = ()
    blind: frozenset[str] = frozenset()
    reopened: frozenset[str] = frozenset()
    checked: frozenset[str] = frozenset()
    detected: frozenset[str] = frozenset()
    robots_of: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


# The document and the reply before, and the sample that was made of them.
KnownSample = tuple[ReplyDocument, ProbeReply, HostSample]


def decode_host_sample(document: ReplyDocument, context: ReplyContext) -> HostSample:
    """The sample of one host.

    A slice (declared capacity) has Delta = its capacity and gamma = its base load plus its own task trees;
    any other host's gamma is that of the whole device. Tasks whose ``done_when`` succeeded are taken out of
    gamma: they are about to be stopped.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range, or the document is of another host.
    """
    return build_host_sample(decode_probe(document, context.host), document, context)


def decode_probe(
    document: ReplyDocument, host: Host, known: tuple[ReplyDocument, ProbeReply] | None = None
) -> ProbeReply:
    """The reply of ``host`` to a probe; ``known``: the one before, of which it repeats parts.

    Raises:
        ReplyError: as `decode_host_sample`.
    """
    _check_origin(document, host)
    return decode_reply(ProbeReply, document, known=known)


def build_host_sample(
    reply: ProbeReply, document: ReplyDocument, context: ReplyContext, known: KnownSample | None = None
) -> HostSample:
    """As `decode_host_sample`, of a ``document`` that is decoded; ``known``: the sample before, in the same
    context, of which usages, links and interfaces may be as they were.

    Raises:
        ReplyError: as `decode_host_sample`.
    """
    tasks = build_task_samples(
        reply, context.answered_at, detected=context.detected, reopened=context.reopened
    )
    if not context.host.is_slice:
        tasks = attribute_counted_traffic(reply, tasks, context.robots_of)
    active, standbys = separate_standbys(reply, tasks)
    sample = HostSample(
        role=context.host.role,
        status=HostStatus.OK,
        sample_age_s=reply.sample_age_s,
        resident=reply.resident,
        usage=_decode_usages(document, context.host, tasks, known),
        counters=reply.counters,
        engines=reply.engines,
        links=_build_links(reply, context, tasks, known) if context.host.role is Role.EDGE else {},
        tasks=active,
        standbys=standbys,
        device=_build_device(reply, document, context.answered_at, known),
        generations=build_generations(reply, active),
        grant=reply.grants.epoch,
        foreign_grant=_find_foreign_grant(reply.grants, context.manager_id),
        foreign_hosts=reply.grants.hosts,
        address=context.host.address,
        machine="" if reply.machine.startswith("/") else reply.machine,
        other_tasks=tuple(each for each in reply.other_tasks if each.fleet == context.host.fleet),
        foreign_tasks=tuple(each for each in reply.other_tasks if each.fleet != context.host.fleet),
        totals=_build_totals(reply.totals, context.host),
    )
    return apply_done_tasks(sample, list_done_tasks(reply) & context.checked)


def _build_totals(reply: TotalsReply | None, host: Host) -> UsageTotals | None:
    if reply is None:
        return None
    if host.is_slice:
        return UsageTotals(tasks=reply.tasks)
    return UsageTotals(cpu_s=reply.cpu_s, network_bytes=reply.network_bytes, tasks=reply.tasks)


def _check_origin(document: ReplyDocument, host: Host) -> None:
    if document.get("v") != PROTOCOL_VERSION:
        version = escape_unprintable(repr(document.get("v")))[:80]
        raise ReplyError(f"document version {version}, expected {PROTOCOL_VERSION}")
    if document.get("op") != protocol.OP_PROBE or document.get("host") != host.name:
        raise ReplyError(
            f"document of {escape_unprintable(repr(document.get('host')))[:80]}, expected {host.name}"
        )


def list_done_tasks(reply: ProbeReply) -> frozenset[str]:
    """Tasks whose ``done_when`` check succeeded on this host, whoever asked for it."""
    return frozenset(name for name, check in reply.checks.items() if check.exit == 0)


def _find_foreign_grant(grants: GrantsReply, manager_id: str) -> int:
    last = grants.other_epoch if grants.holder == manager_id else grants.epoch
    return min(last, grants.epoch)


def _select_alive(tasks: Mapping[str, TaskSample]) -> list[TaskSample]:
    return [task for task in tasks.values() if task.state.alive]


def _decode_usages(
    document: ReplyDocument, host: Host, tasks: Mapping[str, TaskSample], known: KnownSample | None
) -> dict[str, ResourceUsage]:
    same = {} if known is None else _select_same_usages(document, host, tasks, known)
    return {
        resource.name: same[resource.name]
        if resource.name in same
        else _decode_usage(document, host, tasks, resource)
        for resource in HOST_RESOURCES
        if not resource.optional or _is_known(document, host, resource)
    }


def _select_same_usages(
    document: ReplyDocument, host: Host, tasks: Mapping[str, TaskSample], known: KnownSample
) -> Mapping[str, ResourceUsage]:
    """The usages of the sample before of which nothing is said anew, if no task had a part in them."""
    before, reply, sample = known
    if reply.checks or (host.is_slice and (_select_alive(tasks) or _select_alive(sample.instances))):
        return {}
    return {
        name: usage
        for name, usage in sample.usage.items()
        if (found := document.get(name)) is not None and found is before.get(name)
    }


def _decode_usage(
    document: ReplyDocument, host: Host, tasks: Mapping[str, TaskSample], resource: Resource
) -> ResourceUsage:
    """Capacity and use of one resource: of the device, of the slice, or of a declared budget that the host
    may be unable to read.
    """
    declared, name = _get_declared(host, resource), resource.name
    found = document.get(name)
    device = decode_reply(DEVICE_USAGE[name], {} if found is None else found, name)
    used = getattr(device, resource.used_key)
    if resource.optional:
        own = declared if resource.budget else getattr(device, resource.capacity_key)
        return ResourceUsage(capacity=declared or own, used=host.base[name] if host.is_slice else used)
    if host.is_slice:
        own = sum(task.used[name] for task in _select_alive(tasks))
        return ResourceUsage(capacity=declared, used=host.base[name] + own)
    return ResourceUsage(capacity=getattr(device, resource.capacity_key), used=used)


def _is_known(document: ReplyDocument, host: Host, resource: Resource) -> bool:
    """Whether the host has a resource that few have: declared, or measured where it is no slice."""
    measured = not (resource.budget or host.is_slice) and document.get(resource.name) is not None
    return measured or _get_declared(host, resource) > 0


def _get_declared(host: Host, resource: Resource) -> float:
    return host.capacity[resource.name] if host.capacity is not None else 0.0


def _build_links(
    reply: ProbeReply,
    context: ReplyContext,
    tasks: Mapping[str, TaskSample],
    known: KnownSample | None,
) -> Mapping[str, LinkSample]:
    same = {} if known is None else _select_same_links(reply, context, tasks, known)
    if known is not None and same is known[2].links:
        return same
    return {
        robot: same[robot]
        if robot in same
        else _build_link(robot, reply.links[robot], context, _get_speed(reply, reply.links[robot]), tasks)
        for robot in context.robots
        if robot in reply.links
    }


def _select_same_links(
    reply: ProbeReply, context: ReplyContext, tasks: Mapping[str, TaskSample], known: KnownSample
) -> Mapping[str, LinkSample]:
    """The links of the sample before of which nothing is said anew, if no task had a part in them; where
    those are all, the very same mapping.
    """
    _, before, sample = known
    shared = (*_select_alive(tasks), *_select_alive(sample.instances))
    if before.checks or any(context.host.is_slice or task.partial for task in shared):
        return {}
    if reply.links is before.links and reply.interfaces is before.interfaces:
        return sample.links
    return {
        robot: link
        for robot, link in sample.links.items()
        if (found := reply.links.get(robot)) is not None
        and found is before.links[robot]
        and _get_speed(reply, found) == _get_speed(before, found)
    }


def _get_speed(reply: ProbeReply, link: LinkReply) -> float | None:
    """Bytes/s of the interface of a link, where they are known."""
    nic = reply.interfaces.get(link.interface)
    return nic.speed_bytes_per_s if nic else None


def _build_link(
    robot: str,
    reply: LinkReply,
    context: ReplyContext,
    speed: float | None,
    tasks: Mapping[str, TaskSample],
) -> LinkSample:
    used = reply.rx_bytes_per_s + reply.tx_bytes_per_s
    if context.host.is_slice:
        used = sum((_get_link_usage(task, robot) for task in _select_alive(tasks)), 0.0)
    capacity, source = select_link_capacity(robot, context, speed)
    if robot not in context.blind and reply.reachable is False:
        capacity = 0.0
    counted = reply.source is TrafficSource.COUNTERS and not context.host.is_slice
    return LinkSample(
        capacity_bytes_per_s=capacity,
        used_bytes_per_s=used,
        rtt_ms=reply.rtt_ms,
        capacity_source=source,
        partial="" if counted else reply.partial or _find_gap(robot, context, tasks),
        used_source=reply.source,
    )


def _find_gap(robot: str, context: ReplyContext, tasks: Mapping[str, TaskSample]) -> str:
    """What the traffic of a task of ``robot`` lacks: an open UDP socket does not tell whom it sends to."""
    found = (
        task.partial
        for name, task in tasks.items()
        if task.state.alive and task.partial and robot in context.robots_of.get(name, ())
    )
    return next(found, "")


def _get_link_usage(task: TaskSample, robot: str) -> float:
    return (task.links or {}).get(robot, 0.0)


def select_link_capacity(
    robot: str, context: ReplyContext, speed: float | None
) -> tuple[float, CapacitySource]:
    """Delta_thp of the link to ``robot`` and where it comes from: declared, measured, the interface's speed,
    or assumed.
    """
    if robot in context.declared:
        return context.declared[robot], CapacitySource.DECLARED
    if robot in context.measured:
        return context.measured[robot], CapacitySource.MEASURED
    if speed is not None and speed >= _MIN_LINK_BYTES_PER_S:
        return speed, CapacitySource.NIC
    return ASSUMED_BYTES_PER_S, CapacitySource.ASSUMED


def _build_device(
    reply: ProbeReply, document: ReplyDocument, answered_at: float, known: KnownSample | None
) -> DeviceSample:
    """Figures that are shown; of them only the temperature decides, where a limit of it is stated."""
    power = document.get(POWER.name)
    drawn = decode_reply(DEVICE_USAGE[POWER.name], power, POWER.name) if power else None
    return DeviceSample(
        load_1m=reply.load_1m,
        temperature_c=reply.temperature_c,
        gpu_share=None if reply.gpu_share is None else min(reply.gpu_share, 1.0),
        power_w=None if drawn is None else getattr(drawn, POWER.used_key),
        boot_id=reply.boot_id,
        pid_namespace=reply.pid_namespace,
        clock_skew_s=None if reply.wall is None else reply.wall - answered_at,
        interfaces=known[2].device.interfaces
        if known is not None and known[1].interfaces is reply.interfaces
        else {name: _build_interface(each) for name, each in reply.interfaces.items()},
    )


def _build_interface(reply: InterfaceReply) -> InterfaceSample:
    return InterfaceSample(
        rx_bytes_per_s=reply.rx_bytes_per_s,
        tx_bytes_per_s=reply.tx_bytes_per_s,
        speed_bytes_per_s=reply.speed_bytes_per_s,
        level_dbm=reply.level_dbm,
        retries_per_s=reply.retries_per_s,
        access_point=reply.access_point,
        joined_s=reply.joined_s,
    )


def apply_done_tasks(sample: HostSample, done: frozenset[str]) -> HostSample:
    """``sample`` with the tasks ``done`` COMPLETED, their pid kept and their use taken out of gamma (floor
    0).
    """
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
