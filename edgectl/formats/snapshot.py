"""Snapshot to and from JSON. Instants keep milliseconds; keys that a reader does not know are ignored."""

from edgectl.formats import manager_state as memory_format
from edgectl.formats.document import FORMAT_VERSION, Document, encode_number, encode_optional, without_none
from edgectl.formats.document_reader import DocumentReader, check_no_faults, open_document
from edgectl.model.inventory import Role
from edgectl.model.resource import HOST_RESOURCES, RESOURCES, Resource, Usage
from edgectl.model.snapshot import (
    CapacitySource,
    DeviceSample,
    HostSample,
    HostStatus,
    InterfaceSample,
    LinkSample,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.units import format_instant


def encode(snapshot: Snapshot) -> Document:
    """The JSON form; keys that are marked ``?`` in the format are absent where there is nothing to say."""
    document: Document = {"format_version": FORMAT_VERSION, "taken_at": format_instant(snapshot.taken_at)}
    if snapshot.manager is not None:
        document["memory"] = memory_format.encode(snapshot.manager)
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
        sample_age_s=encode_number(host.sample_age_s) if host.ok or host.sample_age_s else None,
        resident=True if host.resident else None,
    )
    for resource in HOST_RESOURCES:
        if resource.name in host.usage:
            usage = host.usage[resource.name]
            document[resource.name] = {
                resource.capacity_key: encode_number(usage.capacity),
                resource.used_key: encode_number(usage.used),
            }
    if host.ok or host.links:
        document["links"] = {robot: encode_link(link) for robot, link in host.links.items()}
    if host.ok or host.tasks:
        document["tasks"] = {name: encode_task(task) for name, task in host.tasks.items()}
    if host.generations:
        document["generations"] = dict(host.generations)
    device = _encode_device(host.device)
    return document | {"device": device} if device else document


def encode_link(link: LinkSample) -> Document:
    """One link's part of a snapshot."""
    return without_none(
        capacity_bytes_per_s=encode_number(link.capacity_bytes_per_s),
        used_bytes_per_s=encode_number(link.used_bytes_per_s),
        rtt_ms=encode_optional(link.rtt_ms),
        capacity_source=link.capacity_source.value,
    )


def encode_task(task: TaskSample) -> Document:
    """One task's part of a snapshot."""
    return without_none(
        state=task.state.value,
        pid=task.pid,
        started_at=format_instant(task.started_at),
        **{
            resource.used_key: encode_number(task.used[resource.name])
            for resource in RESOURCES
            if task.used[resource.name] or not resource.declared_only
        },
        links=None
        if task.links is None
        else {robot: encode_number(rate) for robot, rate in task.links.items()},
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
        metrics={name: encode_number(value) for name, value in task.metrics.items()} or None,
    )


def _encode_device(device: DeviceSample) -> Document:
    return without_none(
        load_1m=encode_optional(device.load_1m),
        temperature_c=encode_optional(device.temperature_c),
        gpu_share=encode_optional(device.gpu_share),
        boot_id=device.boot_id or None,
        clock_skew_s=encode_optional(device.clock_skew_s),
        interfaces={name: _encode_interface(sample) for name, sample in device.interfaces.items()} or None,
    )


def _encode_interface(sample: InterfaceSample) -> Document:
    return without_none(
        rx_bytes_per_s=encode_number(sample.rx_bytes_per_s),
        tx_bytes_per_s=encode_number(sample.tx_bytes_per_s),
        speed_bytes_per_s=encode_optional(sample.speed_bytes_per_s),
    )


def decode(raw: object) -> Snapshot:
    """The snapshot in a JSON document.

    Raises:
        FormatErrors: everything that is wrong with it.
    """
    reader = open_document(raw, "snapshot")
    snapshot = decode_nested(reader)
    check_no_faults(reader, "snapshot")
    return snapshot


def decode_nested(reader: DocumentReader) -> Snapshot:
    """The snapshot in an object of a larger document; mistakes go to the reader."""
    inner = reader.maybe_child("memory")
    reader.require("hosts")
    return Snapshot(
        taken_at=reader.instant("taken_at"),
        manager=None if inner is None else memory_format.decode_nested(inner),
        hosts={name: _decode_host(host) for name, host in reader.children("hosts")},
    )


def _decode_host(reader: DocumentReader) -> HostSample:
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
        usage={
            resource.name: _decode_usage(reader.child(resource.name), resource)
            for resource in HOST_RESOURCES
            if (measured and not resource.declared_only) or reader.has(resource.name)
        },
        links={robot: _decode_link(link) for robot, link in reader.children("links")},
        tasks={name: _decode_task(task) for name, task in reader.children("tasks")},
        device=DeviceSample() if device is None else _decode_device(device),
        generations=reader.mapping("generations", DocumentReader.integer),
    )


def _decode_amount(reader: DocumentReader, resource: Resource) -> float:
    """What a document says is in use; of a budget that it does not know, nothing."""
    if resource.declared_only and not reader.has(resource.used_key):
        return 0.0
    return reader.number(resource.used_key)


def _decode_usage(reader: DocumentReader, resource: Resource) -> ResourceUsage:
    return ResourceUsage(
        capacity=reader.number(resource.capacity_key, positive=True), used=reader.number(resource.used_key)
    )


def _decode_link(reader: DocumentReader) -> LinkSample:
    return LinkSample(
        capacity_bytes_per_s=reader.number("capacity_bytes_per_s"),
        used_bytes_per_s=reader.number("used_bytes_per_s"),
        rtt_ms=reader.maybe_number("rtt_ms"),
        capacity_source=reader.choice("capacity_source", CapacitySource),
    )


def _decode_task(reader: DocumentReader) -> TaskSample:
    return TaskSample(
        state=reader.choice("state", TaskState),
        pid=reader.integer("pid"),
        started_at=reader.instant("started_at"),
        used=Usage({resource.name: _decode_amount(reader, resource) for resource in RESOURCES}),
        links=reader.mapping("links", DocumentReader.number) if reader.has("links") else None,
        instance=reader.text("instance", ""),
        spec_hash=reader.text("spec_hash", ""),
        generation=reader.integer("generation", 0),
        managed=reader.flag("managed", default=True),
        restarts=reader.integer("restarts", 0),
        exit_code=reader.maybe_integer("exit_code"),
        detail=reader.text("detail", ""),
        fields=reader.mapping("fields", DocumentReader.text),
        last_exit=reader.maybe_integer("last_exit"),
        log_tail=reader.texts("log_tail"),
        limits=reader.text("limits", ""),
        given_up=reader.flag("given_up", default=False),
        ended_at=reader.instant("ended_at") if reader.has("ended_at") else None,
        metrics=reader.mapping("metrics", _decode_signed_number),
    )


def _decode_signed_number(reader: DocumentReader, key: str) -> float:
    return reader.number(key, minimum=None)


def _decode_device(reader: DocumentReader) -> DeviceSample:
    return DeviceSample(
        load_1m=reader.maybe_number("load_1m"),
        temperature_c=reader.maybe_number("temperature_c", minimum=None),
        gpu_share=reader.maybe_number("gpu_share"),
        boot_id=reader.text("boot_id", ""),
        clock_skew_s=reader.maybe_number("clock_skew_s", minimum=None),
        interfaces={name: _decode_interface(inner) for name, inner in reader.children("interfaces")},
    )


def _decode_interface(reader: DocumentReader) -> InterfaceSample:
    return InterfaceSample(
        rx_bytes_per_s=reader.number("rx_bytes_per_s"),
        tx_bytes_per_s=reader.number("tx_bytes_per_s"),
        speed_bytes_per_s=reader.maybe_number("speed_bytes_per_s"),
    )
