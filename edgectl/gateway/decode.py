"""An agent's document -> a HostSample. Pure and strict: anything odd costs this host its sample, and no other host anything."""

import dataclasses
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field

from edgectl.errors import ReplyError
from edgectl.gateway.fields import Document, entries, finite, flag, lines, number, optional, positive, printable, table, text, whole
from edgectl.model.inventory import Host, Role
from edgectl.model.snapshot import (
    CapacitySource,
    Cpu,
    Device,
    HostSample,
    HostStatus,
    InterfaceSample,
    LinkSample,
    MemoryUse,
    TaskSample,
    TaskState,
)

VERSION = 1
# Delta_thp where nothing else is known: 54 Mbit/s, the paper's wireless network.
ASSUMED_BYTES_PER_S = 6.75e6
# Of one task, and how they are named: as the agent reads them.
MOST_METRICS = 32
METRIC_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.:/-]{0,62}")
_STATES = {state.value: state for state in TaskState}


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
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


def decode(document: Document, context: Context) -> HostSample:
    """The sample of one host.

    A slice (declared capacity) has Delta = its capacity and gamma = its base load plus its own task trees; any other host's gamma is
    that of the whole device. Tasks whose ``done_when`` said yes are taken out of gamma: they are about to be stopped.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range, or the document is of another host.
    """
    _check_origin(document, context.host)
    tasks = _tasks(document, context)
    sample = HostSample(
        role=context.host.role,
        status=HostStatus.OK,
        sample_age_s=optional(document, "sample_age_s", number) or 0.0,
        resident=flag(document, "resident", default=False),
        cpu=_cpu(document, context.host, tasks),
        memory=_memory(document, context.host, tasks),
        links=_links(document, context, tasks) if context.host.role is Role.EDGE else {},
        tasks=tasks,
        device=_device(document, context.answered_at),
        generations=_generations(document, tasks),
    )
    return with_done(sample, checked_done(document))


def _check_origin(document: Document, host: Host) -> None:
    if document.get("v") != VERSION:
        raise ReplyError(f"document version {printable(repr(document.get('v')))[:80]}, expected {VERSION}")
    if document.get("op") != "probe" or document.get("host") != host.name:
        raise ReplyError(f"document of {printable(repr(document.get('host')))[:80]}, expected {host.name}")


def checked_done(document: Document) -> frozenset[str]:
    """Tasks whose ``done_when`` check said yes on this host."""
    return frozenset(name for name, entry in entries(document, "checks").items() if optional(entry, "exit", whole_any) == 0)


def whole_any(document: Document, key: str) -> int:
    """Any integer: an exit status, negative for a signal."""
    return whole(document, key, low=-(2**31))


def _tasks(document: Document, context: Context) -> dict[str, TaskSample]:
    """The tasks of the host, without runs that are over and were reopened."""
    tasks = {name: _task(name, entry, context) for name, entry in entries(document, "tasks").items()}
    return {name: task for name, task in tasks.items() if not (_over(task) and task.instance in context.reopened)}


def _generations(document: Document, tasks: Mapping[str, TaskSample]) -> dict[str, int]:
    """What the tasks do not tell: a run that no longer counts has used its generation up all the same."""
    stated = table(document, "generations")
    found = {printable(name): whole(stated, name) for name in stated}
    for name, entry in entries(document, "tasks").items():
        if name not in tasks:
            found[name] = max(found.get(name, 0), optional(entry, "generation", whole) or 0)
    return found


def _over(task: TaskSample) -> bool:
    return task.state is TaskState.COMPLETED or task.given_up


def _task(name: str, entry: Document, context: Context) -> TaskSample:
    state = _STATES.get(text(entry, "state"))
    if state is None:
        raise ReplyError(f"tasks.{name}.state is not a state: {text(entry, 'state')[:80]}")
    links = {robot: number(table(entry, "links"), robot) for robot in table(entry, "links")}
    ended_s = optional(entry, "ended_s", number)
    return TaskSample(
        state=state,
        pid=optional(entry, "pid", whole) or 0,
        started_at=context.answered_at - (optional(entry, "age_s", number) or 0.0),
        used_cores=optional(entry, "used_cores", number) or 0.0,
        used_bytes=optional(entry, "used_bytes", number) or 0.0,
        used_bytes_per_s=_rate(entry),
        links=links or None,
        instance=text(entry, "instance"),
        spec_hash=text(entry, "spec_hash"),
        generation=optional(entry, "generation", whole) or 0,
        managed=flag(entry, "managed", default=True),
        restarts=optional(entry, "restarts", whole) or 0,
        exit_code=optional(entry, "exit_code", whole_any),
        detail=text(entry, "detail"),
        fields={key: text(table(entry, "fields"), key) for key in table(entry, "fields") if key.isidentifier()},
        last_exit=optional(entry, "last_exit", whole_any),
        log_tail=lines(entry, "log_tail"),
        limits=text(entry, "limits"),
        given_up=flag(entry, "given_up", default=False),
        ended_at=None if ended_s is None else context.answered_at - ended_s,
        metrics=_metrics(table(entry, "metrics")),
    )


def _metrics(values: Document) -> dict[str, float]:
    """What the application says of itself; the agent lets nothing else pass."""
    if len(values) > MOST_METRICS:
        raise ReplyError(f"more than {MOST_METRICS} metrics of one task")
    for name in values:
        if not METRIC_NAME.fullmatch(name):
            raise ReplyError(f"not the name of a metric: {printable(name)[:80]}")
    return {name: finite(values, name, most=sys.float_info.max) for name in values}


def _alive(tasks: Mapping[str, TaskSample]) -> list[TaskSample]:
    return [task for task in tasks.values() if task.state.alive]


def _cpu(document: Document, host: Host, tasks: Mapping[str, TaskSample]) -> Cpu:
    device = table(document, "cpu")
    cores, used = positive(device, "cores"), number(device, "used_cores")
    if host.capacity is not None:
        return Cpu(cores=host.capacity.cpu, used_cores=host.base.cpu + sum(task.used_cores for task in _alive(tasks)))
    return Cpu(cores=cores, used_cores=used)


def _memory(document: Document, host: Host, tasks: Mapping[str, TaskSample]) -> MemoryUse:
    device = table(document, "memory")
    total, used = positive(device, "total_bytes"), number(device, "used_bytes")
    if host.capacity is not None:
        return MemoryUse(total_bytes=host.capacity.memory, used_bytes=host.base.memory + sum(task.used_bytes for task in _alive(tasks)))
    return MemoryUse(total_bytes=total, used_bytes=used)


def _links(document: Document, context: Context, tasks: Mapping[str, TaskSample]) -> dict[str, LinkSample]:
    interfaces = _interfaces(document)
    found = entries(document, "links")
    return {robot: _link(robot, found[robot], context, interfaces, tasks) for robot in context.robots if robot in found}


def _link(
    robot: str, entry: Document, context: Context, interfaces: Mapping[str, InterfaceSample], tasks: Mapping[str, TaskSample]
) -> LinkSample:
    used = _rate(entry)
    if context.host.capacity is not None:
        used = sum((_on_link(task, robot) for task in _alive(tasks)), 0.0)
    nic = interfaces.get(text(entry, "interface"))
    capacity, source = link_capacity(robot, context, nic.speed_bytes_per_s if nic else None)
    if robot not in context.blind and not flag(entry, "reachable", default=True):
        capacity = 0.0
    return LinkSample(
        capacity_bytes_per_s=capacity, used_bytes_per_s=used, rtt_ms=optional(entry, "rtt_ms", number), capacity_source=source
    )


def _rate(entry: Document) -> float:
    """In plus out, in bytes/s; what the host cannot tell counts as nothing."""
    return (optional(entry, "rx_bytes_per_s", number) or 0.0) + (optional(entry, "tx_bytes_per_s", number) or 0.0)


def _on_link(task: TaskSample, robot: str) -> float:
    return (task.links or {}).get(robot, 0.0)


def link_capacity(robot: str, context: Context, speed: float | None) -> tuple[float, CapacitySource]:
    """Delta_thp of the link to ``robot`` and where it comes from: declared, measured, the interface's speed, or assumed."""
    if robot in context.declared:
        return context.declared[robot], CapacitySource.DECLARED
    if robot in context.measured:
        return context.measured[robot], CapacitySource.MEASURED
    if speed:
        return speed, CapacitySource.NIC
    return ASSUMED_BYTES_PER_S, CapacitySource.ASSUMED


def _interfaces(document: Document) -> dict[str, InterfaceSample]:
    return {
        name: InterfaceSample(
            rx_bytes_per_s=number(entry, "rx_bytes_per_s"),
            tx_bytes_per_s=number(entry, "tx_bytes_per_s"),
            speed_bytes_per_s=optional(entry, "speed_bytes_per_s", number),
        )
        for name, entry in entries(document, "interfaces").items()
    }


def _device(document: Document, answered_at: float) -> Device:
    """Figures that are shown and never used to decide; the host's clock stands here only as a skew."""
    wall = optional(document, "wall", finite)
    share = optional(document, "gpu_share", number)
    return Device(
        load_1m=optional(document, "load_1m", number),
        temperature_c=optional(document, "temperature_c", finite),
        gpu_share=None if share is None else min(share, 1.0),
        boot_id=text(document, "boot_id"),
        clock_skew_s=None if wall is None else wall - answered_at,
        interfaces=_interfaces(document),
    )


def with_done(sample: HostSample, done: frozenset[str]) -> HostSample:
    """``sample`` with the tasks ``done`` COMPLETED, their pid kept and their use taken out of gamma (floor 0)."""
    leaving = {name: task for name, task in sample.tasks.items() if name in done and task.state.alive}
    if not leaving or sample.cpu is None or sample.memory is None:
        return sample
    cpu, memory = sample.cpu, sample.memory
    return dataclasses.replace(
        sample,
        cpu=dataclasses.replace(cpu, used_cores=max(0.0, cpu.used_cores - sum(task.used_cores for task in leaving.values()))),
        memory=dataclasses.replace(memory, used_bytes=max(0.0, memory.used_bytes - sum(task.used_bytes for task in leaving.values()))),
        links={
            robot: dataclasses.replace(
                link, used_bytes_per_s=max(0.0, link.used_bytes_per_s - sum(_on_link(task, robot) for task in leaving.values()))
            )
            for robot, link in sample.links.items()
        },
        tasks={
            name: dataclasses.replace(task, state=TaskState.COMPLETED) if name in leaving else task for name, task in sample.tasks.items()
        },
    )
