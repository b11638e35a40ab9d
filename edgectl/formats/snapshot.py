"""Snapshot to and from JSON (DESIGN section 4). Instants keep milliseconds; keys that a reader does not know are ignored."""

from edgectl.formats import memory as memory_format
from edgectl.formats.base import FORMAT_VERSION, Document, number, optional, without_none
from edgectl.formats.reader import Reader, close_document, open_document
from edgectl.model.inventory import Role
from edgectl.model.snapshot import (
    CapacitySource,
    Cpu,
    Device,
    HostSample,
    HostStatus,
    InterfaceSample,
    LinkSample,
    MemoryUse,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.units import format_instant


def encode(snapshot: Snapshot) -> Document:
    """The JSON form; keys that are marked ``?`` in the format are absent where there is nothing to say."""
    document: Document = {"format_version": FORMAT_VERSION, "taken_at": format_instant(snapshot.taken_at)}
    if snapshot.memory is not None:
        document["memory"] = memory_format.encode(snapshot.memory)
    document["hosts"] = {name: encode_host(host) for name, host in snapshot.hosts.items()}
    return document


def encode_host(host: HostSample) -> Document:
    """One host's part of a snapshot."""
    document = without_none(
        role=host.role.value,
        status=host.status.value,
        error=host.error or None,
        error_kind=host.error_kind or None,
        hint=host.hint or None,
        sample_age_s=number(host.sample_age_s) if host.ok or host.sample_age_s else None,
        resident=True if host.resident else None,
    )
    if host.cpu is not None:
        document["cpu"] = {"cores": number(host.cpu.cores), "used_cores": number(host.cpu.used_cores)}
    if host.memory is not None:
        document["memory"] = {"total_bytes": number(host.memory.total_bytes), "used_bytes": number(host.memory.used_bytes)}
    if host.ok or host.links:
        document["links"] = {robot: encode_link(link) for robot, link in host.links.items()}
    if host.ok or host.tasks:
        document["tasks"] = {name: encode_task(task) for name, task in host.tasks.items()}
    if host.generations:
        document["generations"] = dict(host.generations)
    device = _device(host.device)
    return document | {"device": device} if device else document


def encode_link(link: LinkSample) -> Document:
    """One link's part of a snapshot."""
    return without_none(
        capacity_bytes_per_s=number(link.capacity_bytes_per_s),
        used_bytes_per_s=number(link.used_bytes_per_s),
        rtt_ms=optional(link.rtt_ms),
        capacity_source=link.capacity_source.value,
    )


def encode_task(task: TaskSample) -> Document:
    """One task's part of a snapshot."""
    return without_none(
        state=task.state.value,
        pid=task.pid,
        started_at=format_instant(task.started_at),
        used_cores=number(task.used_cores),
        used_bytes=number(task.used_bytes),
        used_bytes_per_s=number(task.used_bytes_per_s),
        links=None if task.links is None else {robot: number(rate) for robot, rate in task.links.items()},
        instance=task.instance or None,
        spec_hash=task.spec_hash or None,
        generation=task.generation or None,
        managed=None if task.managed else False,
        restarts=task.restarts or None,
        exit_code=task.exit_code,
        detail=task.detail or None,
        fields=dict(task.fields) or None,
        last_exit=task.last_exit,
        log_tail=list(task.log_tail) or None,
        limits=task.limits or None,
        given_up=task.given_up or None,
        ended_at=None if task.ended_at is None else format_instant(task.ended_at),
        metrics={name: number(value) for name, value in task.metrics.items()} or None,
    )


def _device(device: Device) -> Document:
    return without_none(
        load_1m=optional(device.load_1m),
        temperature_c=optional(device.temperature_c),
        gpu_share=optional(device.gpu_share),
        boot_id=device.boot_id or None,
        clock_skew_s=optional(device.clock_skew_s),
        interfaces={name: _interface(sample) for name, sample in device.interfaces.items()} or None,
    )


def _interface(sample: InterfaceSample) -> Document:
    return without_none(
        rx_bytes_per_s=number(sample.rx_bytes_per_s),
        tx_bytes_per_s=number(sample.tx_bytes_per_s),
        speed_bytes_per_s=optional(sample.speed_bytes_per_s),
    )


def decode(raw: object) -> Snapshot:
    """The snapshot in a JSON document.

    Raises:
        FormatErrors: everything that is wrong with it.
    """
    reader = open_document(raw, "snapshot")
    snapshot = read(reader)
    close_document(reader, "snapshot")
    return snapshot


def read(reader: Reader) -> Snapshot:
    """The snapshot in an object of a larger document; mistakes go to the reader."""
    inner = reader.maybe_child("memory")
    reader.require("hosts")
    return Snapshot(
        taken_at=reader.instant("taken_at"),
        memory=None if inner is None else memory_format.read(inner),
        hosts={name: _read_host(host) for name, host in reader.children("hosts")},
    )


def _read_host(reader: Reader) -> HostSample:
    status = reader.choice("status", HostStatus)
    measured = status is HostStatus.OK
    device = reader.maybe_child("device")
    return HostSample(
        role=reader.choice("role", Role),
        status=status,
        error=reader.text("error", ""),
        error_kind=reader.text("error_kind", ""),
        hint=reader.text("hint", ""),
        sample_age_s=reader.maybe_number("sample_age_s") or 0.0,
        resident=reader.flag("resident", default=False),
        cpu=_read_cpu(reader.child("cpu")) if measured or reader.has("cpu") else None,
        memory=_read_memory(reader.child("memory")) if measured or reader.has("memory") else None,
        links={robot: _read_link(link) for robot, link in reader.children("links")},
        tasks={name: _read_task(task) for name, task in reader.children("tasks")},
        device=Device() if device is None else _read_device(device),
        generations=reader.mapping("generations", Reader.integer),
    )


def _read_cpu(reader: Reader) -> Cpu:
    return Cpu(cores=reader.number("cores", positive=True), used_cores=reader.number("used_cores"))


def _read_memory(reader: Reader) -> MemoryUse:
    return MemoryUse(total_bytes=reader.number("total_bytes", positive=True), used_bytes=reader.number("used_bytes"))


def _read_link(reader: Reader) -> LinkSample:
    return LinkSample(
        capacity_bytes_per_s=reader.number("capacity_bytes_per_s"),
        used_bytes_per_s=reader.number("used_bytes_per_s"),
        rtt_ms=reader.maybe_number("rtt_ms"),
        capacity_source=reader.choice("capacity_source", CapacitySource),
    )


def _read_task(reader: Reader) -> TaskSample:
    return TaskSample(
        state=reader.choice("state", TaskState),
        pid=reader.integer("pid"),
        started_at=reader.instant("started_at"),
        used_cores=reader.number("used_cores"),
        used_bytes=reader.number("used_bytes"),
        used_bytes_per_s=reader.number("used_bytes_per_s"),
        links=reader.mapping("links", Reader.number) if reader.has("links") else None,
        instance=reader.text("instance", ""),
        spec_hash=reader.text("spec_hash", ""),
        generation=reader.integer("generation", 0),
        managed=reader.flag("managed", default=True),
        restarts=reader.integer("restarts", 0),
        exit_code=reader.maybe_integer("exit_code"),
        detail=reader.text("detail", ""),
        fields=reader.mapping("fields", Reader.text),
        last_exit=reader.maybe_integer("last_exit"),
        log_tail=reader.texts("log_tail"),
        limits=reader.text("limits", ""),
        given_up=reader.flag("given_up", default=False),
        ended_at=reader.instant("ended_at") if reader.has("ended_at") else None,
        metrics=reader.mapping("metrics", _any_number),
    )


def _any_number(reader: Reader, key: str) -> float:
    return reader.number(key, minimum=None)


def _read_device(reader: Reader) -> Device:
    return Device(
        load_1m=reader.maybe_number("load_1m"),
        temperature_c=reader.maybe_number("temperature_c", minimum=None),
        gpu_share=reader.maybe_number("gpu_share"),
        boot_id=reader.text("boot_id", ""),
        clock_skew_s=reader.maybe_number("clock_skew_s", minimum=None),
        interfaces={name: _read_interface(inner) for name, inner in reader.children("interfaces")},
    )


def _read_interface(reader: Reader) -> InterfaceSample:
    return InterfaceSample(
        rx_bytes_per_s=reader.number("rx_bytes_per_s"),
        tx_bytes_per_s=reader.number("tx_bytes_per_s"),
        speed_bytes_per_s=reader.maybe_number("speed_bytes_per_s"),
    )
