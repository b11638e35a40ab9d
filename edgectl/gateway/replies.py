# SPDX-License-Identifier: Apache-2.0
"""Replies of agents as dataclasses, decoded by the codec: a reply that does not fit costs its host, never the
run.

Text of a host is bounded and printable, so that no host can drive a terminal. A key that is absent or null
has its default. In collections of tasks, links and the like, an entry that does not fit is left out.
"""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, TypeVar

from edgectl.dataclass import dataclass
from edgectl.errors import ReplyError
from edgectl.formats.codec import decode, decode_again
from edgectl.formats.document import Faults
from edgectl.model.encoding import Bounds, Converted, EachAlone, in_document
from edgectl.model.profiler import ProfilerState
from edgectl.model.reported import Age, Generation, Text
from edgectl.model.resource import HOST_RESOURCES, MEASURED_HOST_RESOURCES
from edgectl.model.snapshot import OtherTask, TaskState, TrafficSource
from edgectl.model.text import escape_unprintable

ReplyDocument = Mapping[str, object]
Reply = TypeVar("Reply")
# Amounts that stay finite, and integers that stay exact, in whatever is computed and stored of them.
_MAX_NUMBER, _MAX_COUNT, _MAX_INT32 = 2.0**63, 2.0**53, 2.0**32
# Below a thousandth of a core, or of a byte, quotients overflow.
_MIN_CAPACITY = 1e-3
_MAX_CLOCK_S = 2.0**36
_MAX_LINE, _MAX_LINES, _MAX_MESSAGE = 500, 20, 200


def _clean_lines(lines: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(escape_unprintable(line[:_MAX_LINE]) for line in lines[-_MAX_LINES:])


def _clean_last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return escape_unprintable(lines[-1][:_MAX_LINE]) if lines else ""


LastLine = Annotated[str, Converted(convert=_clean_last_line)]
Lines = Annotated[tuple[str, ...], Converted(convert=_clean_lines)]
ALONE = EachAlone()
Amount = Annotated[float, Bounds(maximum=_MAX_NUMBER)]
Capacity = Annotated[float, Bounds(minimum=_MIN_CAPACITY, maximum=_MAX_NUMBER)]
Reading = Annotated[float, Bounds(minimum=-_MAX_NUMBER, maximum=_MAX_NUMBER)]
Clock = Annotated[float, Bounds(minimum=-_MAX_CLOCK_S, maximum=_MAX_CLOCK_S)]
Count = Annotated[int, Bounds(maximum=_MAX_COUNT)]
ExitStatus = Annotated[int, Bounds(minimum=-_MAX_INT32, maximum=_MAX_INT32)]


def decode_reply(
    kind: type[Reply],
    document: object,
    where: str = "",
    known: tuple[ReplyDocument, Reply] | None = None,
) -> Reply:
    """The reply of type ``kind``; ``where`` it stands in a larger one, for the message.

    ``known``: the document and the reply of the same kind of which this one repeats parts.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range.
    """
    faults: Faults = []
    if known is not None and isinstance(document, dict):
        reply = decode_again(kind, document, faults, *known)
    else:
        reply = decode(kind, document, faults)
    if faults:
        message = f"{where}.{faults[0]}" if where else str(faults[0])
        raise ReplyError(escape_unprintable(message[:_MAX_MESSAGE]))
    return reply


def _make_usage(name: str, kinds: Mapping[str, object], default: float | None = None) -> type[Any]:
    """A dataclass with a field of each kind by name, all with the ``default``, if any."""
    values = {} if default is None else dict.fromkeys(kinds, default)
    made = type(name, (), {"__module__": __name__, "__annotations__": kinds, **values})
    return dataclass(frozen=True, slots=True, kw_only=True)(made)


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckReply:
    """Result of a ``done_when`` check; ``exit``: its status, None where it did not end."""

    exit: ExitStatus | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class InterfaceReply:
    """One network interface, as ``model.snapshot.InterfaceSample``."""

    rx_bytes_per_s: Amount
    tx_bytes_per_s: Amount
    speed_bytes_per_s: Amount | None = None
    level_dbm: Reading | None = None
    retries_per_s: Amount | None = None
    access_point: Text = ""
    joined_s: Age | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkReply:
    """One link of a probe: traffic in bytes/s, round-trip time in ms, ``reachable`` None where nothing came
    back within the window, ``partial`` and ``source`` (of the traffic) as
    ``model.snapshot.LinkSample``; ``other_bytes_per_s``: the part of a counted traffic that is not TCP; the
    others as ``model.link_reading.LinkObservation``.
    """

    rx_bytes_per_s: Amount = 0.0
    tx_bytes_per_s: Amount = 0.0
    rtt_ms: Amount | None = None
    interface: Text = ""
    reachable: bool | None = None
    carries_bytes_per_s: Amount | None = None
    radio_bytes_per_s: Amount | None = None
    partial: Text = ""
    other_bytes_per_s: Amount = 0.0
    source: TrafficSource = TrafficSource.TCP


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerReply:
    """What a robot knows of its link to an edge, in bytes/s: as ``model.link_reading.LinkObservation``."""

    carries_bytes_per_s: Amount | None = None
    radio_bytes_per_s: Amount | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskReply:
    """One task on a host; ages in s before the reply. Its usage by resource is a ``TASK_USAGE``."""

    state: TaskState
    pid: Count = 0
    age_s: Age = 0.0
    rx_bytes_per_s: Amount = 0.0
    tx_bytes_per_s: Amount = 0.0
    links: Mapping[Text, Amount] = field(default_factory=dict)
    instance: Text = ""
    spec_hash: Text = ""
    generation: Generation = 0
    managed: bool = True
    restarts: Count = 0
    exit_code: ExitStatus | None = None
    detail: Text = ""
    fields: Mapping[Text, Text] = field(default_factory=dict)
    last_exit: ExitStatus | None = None
    log_tail: Lines = ()
    limits: Text = ""
    given_up: bool = False
    ended_s: Age | None = None
    metrics: Mapping[str, object] = field(default_factory=dict)
    file: Text = ""
    orphaned: bool = False
    adoptable: bool = False
    needed: Text = ""
    nodes: Mapping[Text, Text] = field(default_factory=dict)
    partial: Text = ""
    role: Text = ""
    switching: bool = False
    deactivated: Generation = 0
    engine: Text = ""
    container: Text = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class GrantsReply:
    """Holder and number of the last grant of a host, and the number of the last one to another manager;
    ``hosts``: those of other managers; ``names``: those of this host there.
    """

    holder: Text = ""
    epoch: Count = 0
    other_epoch: Count = 0
    hosts: Annotated[tuple[Text, ...], ALONE] = ()
    names: Annotated[tuple[Text, ...], ALONE] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TotalsReply:
    """Counters of a host since boot, and of the instances of its tasks since their start."""

    cpu_s: Amount
    network_bytes: Amount
    tasks: Annotated[Mapping[Text, Amount], ALONE] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeReply:
    """Reply to a probe.

    Tasks, generations and devices are decoded later: a bad task may still run, and which keys a device has is
    a matter of the table of resources.
    """

    sample_age_s: Age = 0.0
    resident: bool = False
    boot_id: Text = ""
    pid_namespace: Text = ""
    machine: Text = ""
    wall: Clock | None = None
    load_1m: Amount | None = None
    temperature_c: Reading | None = None
    gpu_share: Amount | None = None
    interfaces: Annotated[Mapping[Text, InterfaceReply], ALONE] = field(default_factory=dict)
    links: Annotated[Mapping[Text, LinkReply], ALONE] = field(default_factory=dict)
    peers: Annotated[Mapping[Text, PeerReply], ALONE] = field(default_factory=dict)
    tasks: Annotated[Mapping[Text, object], ALONE] = field(default_factory=dict)
    checks: Annotated[Mapping[Text, CheckReply], ALONE] = field(default_factory=dict)
    grants: GrantsReply = GrantsReply()
    generations: Annotated[Mapping[Text, object], ALONE] = field(default_factory=dict)
    other_tasks: Annotated[tuple[OtherTask, ...], ALONE] = ()
    counters: Text = ""
    unowned: Annotated[tuple[Text, ...], ALONE] = ()
    former: Annotated[tuple[Text, ...], ALONE] = ()
    totals: TotalsReply | None = None
    engines: Annotated[tuple[Text, ...], ALONE] | None = None


# Usage of a task and of a profiler, capacity and usage of each resource of a device, under the keys of the
# table.
TASK_USAGE = _make_usage("TaskUsage", {resource.used_key: Amount for resource in HOST_RESOURCES}, default=0.0)
PROFILER_USAGE = _make_usage(
    "ProfilerUsage", {resource.used_key: Amount for resource in MEASURED_HOST_RESOURCES}
)
DEVICE_USAGE = {
    resource.name: _make_usage("DeviceUsage", {resource.used_key: Amount}, default=0.0)
    if resource.budget
    else _make_usage("DeviceUsage", {resource.capacity_key: Capacity, resource.used_key: Amount})
    for resource in HOST_RESOURCES
}


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusReply:
    """Reply to a request for the status of tasks, each decoded later as a `TaskReply`."""

    tasks: Annotated[Mapping[Text, object], ALONE] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockReply:
    """Clock of a host before and after its work, in s since 1970."""

    began: Clock
    ended: Clock


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryReply:
    """Memory of a host."""

    total_bytes: Capacity
    used_bytes: Amount


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineReply:
    """What tells machines apart, as ``model.snapshot.MachineIdentity``."""

    boot_id: Text = ""
    machine_id: Text = ""
    pid_namespace: Text = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LogindReply:
    """Settings of systemd-logind, as ``model.diagnosis.Logind``."""

    user: Text = ""
    present: bool = False
    lingers: bool = False
    removes_ipc: bool = False
    kills: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskReply:
    """File system of the state directory, as ``model.diagnosis.Disk``."""

    path: Text = ""
    free_bytes: Amount
    total_bytes: Amount
    files_left: Count | None = None
    obstacle: Text = ""
    in_shared_memory: bool = field(default=False, metadata=in_document("spare"))
    skipped: Annotated[tuple[Text, ...], ALONE] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ShellReply:
    """Environment of a command, as ``model.diagnosis.ShellEnvironment``."""

    variables: Annotated[Mapping[Text, Text], ALONE] = field(default_factory=dict)
    status: Count | None = None
    timed_out: bool = False
    last_line: Text = field(default="", metadata=in_document("said"))


@dataclass(frozen=True, slots=True, kw_only=True)
class RosReply:
    """What a host has of ROS, as ``model.diagnosis.RosFacts``."""

    missing_files: Annotated[tuple[Text, ...], ALONE] = ()
    missing_packages: Annotated[tuple[Text, ...], ALONE] = ()
    addresses: Annotated[Mapping[Text, Text], ALONE] = field(default_factory=dict)
    interfaces: Annotated[tuple[Text, ...], ALONE] = ()
    no_multicast: Annotated[tuple[Text, ...], ALONE] = ()
    receive_bytes: Amount | None = None
    fragment_bytes: Amount | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareReply:
    """What a host has that few have, as ``model.diagnosis.HardwareFacts``."""

    gpus: Amount = 0.0
    gpu_total_bytes: Amount = 0.0
    used_watts: Amount | None = None
    used_charge: Amount | None = None
    temperature_c: Reading | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RouteReply:
    """The way to a robot, as ``model.diagnosis.LinkFacts``."""

    found: bool = False
    reachable: bool | None = None
    interface: Text = ""
    rtt_ms: Amount | None = None
    speed_bytes_per_s: Amount | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EngineReply:
    """A container engine of a host."""

    version: Text = ""
    error: Text = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class DoctorReply:
    """Reply to a diagnosis."""

    clock: ClockReply
    memory: MemoryReply
    disk: DiskReply
    python: Text = ""
    psutil: bool = False
    machine: MachineReply = MachineReply()
    logind: LogindReply = LogindReply()
    surroundings: ShellReply = ShellReply()
    ros: RosReply = RosReply()
    hardware: HardwareReply = HardwareReply()
    links: Annotated[Mapping[Text, RouteReply], ALONE] = field(default_factory=dict)
    engines: Annotated[Mapping[Text, EngineReply], ALONE] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfilerReply:
    """State of a resident profiler."""

    state: ProfilerState
    pid: Count = 0
    detail: Text = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveProfilerReply:
    """Figures of a profiler that lives, as ``model.profiler.Profiler``. Its usage is a ``PROFILER_USAGE``."""

    age: Age = field(metadata=in_document("age_s"))
    every: Age = field(metadata=in_document("every_s"))
    period: Age = field(metadata=in_document("period_s"))
    samples: Count
    sample_age: Age | None = field(default=None, metadata=in_document("sample_age_s"))
    ttl: Age = field(metadata=in_document("ttl_s"))
    ttl_left: Clock = field(metadata=in_document("ttl_left_s"))
    current: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramReply:
    """Result of a program; ``exit``: None where it did not end in time. ``output``: its last line."""

    exit: ExitStatus | None = None
    timed_out: bool = False
    output: LastLine = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class PieceReply:
    """One piece of a file in base 64; ``mark`` changes with the file."""

    size: Count
    mark: Text = ""
    data: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SinkReply:
    """Address of a receiver that measures a link."""

    port: Annotated[int, Bounds(minimum=1, maximum=65535)]
    token: Text = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleReply:
    """Rate of an idle link, as ``model.link_reading.LinkSampleResult``."""

    bytes_per_s: Amount | None = None
    full: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SendReply:
    """Amount sent over a link, and the time it took."""

    bytes: Capacity
    seconds: Capacity
