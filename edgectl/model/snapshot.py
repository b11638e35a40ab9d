# SPDX-License-Identifier: Apache-2.0
"""Snapshot: one immutable picture of the fleet at one instant, as the profilers measured it.

Amounts are in the unit of their resource; instants are seconds since 1970 on the manager's clock.
"""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.agent.link import protocol
from edgectl.dataclass import dataclass
from edgectl.model.encoding import Instant, Positive, Share, Signed, SignedInt, in_document
from edgectl.model.inventory import Role
from edgectl.model.latency import LatencySample
from edgectl.model.manager_state import ManagerState
from edgectl.model.reported import Age, Generation, Text
from edgectl.model.resource import MEASURED_HOST_RESOURCES, Usage


class HostStatus(StrEnum):
    """Whether the host answered."""

    OK = "ok"
    UNREACHABLE = "unreachable"


class TaskState(StrEnum):
    """Stage of a task's life on a host."""

    STARTING = protocol.STARTING
    RUNNING = protocol.RUNNING
    READY = protocol.READY
    UNHEALTHY = protocol.UNHEALTHY
    COMPLETED = protocol.COMPLETED
    FAILED = protocol.FAILED
    CRASHLOOP = protocol.CRASHLOOP

    @property
    def alive(self) -> bool:
        """Whether the task occupies its host (starting, running, ready or unhealthy)."""
        return self in protocol.ALIVE_STATES


class CapacitySource(StrEnum):
    """Source of a link's capacity: the nominal ones, best first, then the live ones that lower them."""

    DECLARED = "declared"
    MEASURED = "measured"
    NIC = "nic"
    ASSUMED = "assumed"
    TCP = "tcp"
    PROBE = "probe"
    RADIO = "radio"


class TrafficSource(StrEnum):
    """Source of the traffic of a link: bytes of TCP connections, or counters of all protocols (ADR 104)."""

    TCP = protocol.SOURCE_TCP
    COUNTERS = protocol.SOURCE_COUNTERS


# ``counters`` of a host whose counters are read.
COUNTERS_INSTALLED = protocol.COUNTERS_INSTALLED


@dataclass(frozen=True, slots=True, kw_only=True)
class ResourceUsage:
    """Capacity (> 0, before limits) and use of one resource of a host, in its unit."""

    capacity: Positive
    used: float

    @property
    def share(self) -> float:
        """Use as a share of the capacity; above 1: overload."""
        return self.used / self.capacity


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSample:
    """One edge-robot link: Delta_thp and gamma_thp in bytes/s (in plus out), round-trip time in ms where
    known.

    ``capacity_age_s``: age of a live reading when the snapshot was taken. ``nominal``: the declared, measured
    or assumed capacity in bytes/s, where the capacity is a live one. ``partial``: what ``used_bytes_per_s``
    lacks; empty where nothing (ADR 0096). ``used_source``: where it comes from.
    """

    capacity_bytes_per_s: float
    used_bytes_per_s: float
    rtt_ms: float | None = None
    capacity_source: CapacitySource = field(
        default=CapacitySource.ASSUMED, metadata=in_document(required=True)
    )
    capacity_age_s: float | None = None
    nominal: float | None = field(default=None, metadata=in_document("nominal_bytes_per_s"))
    partial: str = ""
    used_source: TrafficSource = TrafficSource.TCP

    @property
    def nominal_bytes_per_s(self) -> float:
        """The capacity that a share of the throughput is of, whatever the link carries now."""
        return self.capacity_bytes_per_s if self.nominal is None else self.nominal


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskSample:
    """One task found on a host, with the measured use of its whole process tree.

    ``links``: bytes/s by robot where the kernel reports it; otherwise the use of the network is split evenly
    over the task's links. ``instance`` identifies this very start; ``spec_hash`` what was started;
    ``managed`` is false for tasks found by ``detect``. ``fields``: short hash of each field of the spec that
    was started, so that a restart can say what changed. ``last_exit``: exit code before the last restart.
    ``log_tail``: last lines of a task that failed or was given up. ``limits``: "enforced", or "not enforced:
    why"; empty where none are stated. ``given_up``: it ended by itself and is not to be started again by
    itself: a crash loop, or a failure under ``restart: never``. ``ended_at``: when it ended for good, where
    its host knows. ``started_at``: 0 where it is not known any more. ``metrics``: the last value of each
    application metric by name, also after its end. ``file``: the task file that it was started from.
    ``needed``: marks of the runs of its predecessors with ``restart: with`` when it was started.
    ``nodes``: the names and addresses under which its nodes are registered at a ROS 1 master.
    ``partial``: what its traffic lacks, as of a link.
    ``latency``: as its rule states it, where there is a value.
    ``orphaned``: it lives without a supervisor; ``adoptable``: a new one can take it over as it is (ADR
    0041). ``switching``: it is just becoming active or inactive. ``deactivated``: of a copy, the generation
    with which its process was made inactive, so that it has what the task knew then; 0: it never was active.
    ``container``: the name of its container; empty for a command of the host.
    """

    state: TaskState
    pid: int = field(default=0, metadata=in_document(required=True))
    started_at: Instant = field(default=0.0, metadata=in_document(required=True))
    used: Usage = field(default=Usage(), metadata=in_document(by_resource=("used",), required=True))
    links: Mapping[str, float] | None = field(
        default=None, metadata=in_document(value_key="used_bytes_per_s")
    )
    instance: str = ""
    spec_hash: str = ""
    generation: int = 0
    managed: bool = True
    restarts: int = 0
    exit_code: SignedInt | None = None
    detail: str = ""
    fields: Mapping[str, str] = field(default_factory=dict)
    last_exit: SignedInt | None = None
    log_tail: tuple[str, ...] = ()
    limits: str = field(default="", metadata=in_document("enforcement"))
    given_up: bool = False
    metrics: Mapping[str, Signed] = field(default_factory=dict)
    ended_at: Instant | None = None
    file: str = ""
    orphaned: bool = False
    adoptable: bool = False
    needed: str = ""
    nodes: Mapping[str, str] = field(default_factory=dict)
    partial: str = ""
    latency: LatencySample | None = None
    switching: bool = False
    deactivated: Generation = 0
    container: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherTask:
    """A living task on the machine of a host that is filed there under another host name or another fleet.

    ``fleet`` is empty for a task of the first release that no fleet has adopted. ``host``: the name it is
    filed under. ``started_by``: user and machine of its manager, where known. ``age_s``: when the host
    answered.
    """

    fleet: Text = field(metadata=in_document(always=True))
    host: Text
    task: Text
    state: TaskState
    started_by: Text = ""
    age_s: Age = 0.0
    instance: Text = ""
    spec_hash: Text = ""
    generation: Generation = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class InterfaceSample:
    """One network interface: bytes/s in and out, nominal speed in bytes/s where the kernel knows it.

    Of a radio, where its driver states them (ADR 105): level of the signal, repeated frames per second, the
    access point that it has joined, and how long ago; a roaming radio has joined another one just now.
    """

    rx_bytes_per_s: float
    tx_bytes_per_s: float
    speed_bytes_per_s: float | None = None
    level_dbm: Signed | None = None
    retries_per_s: float | None = None
    access_point: str = ""
    joined_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceSample:
    """Readings of the device profiler besides the resources, where the host shows them.

    ``pid_namespace``: which processes of that boot its login sees; those of a container are fewer.
    """

    load_1m: float | None = None
    temperature_c: Signed | None = None
    gpu_share: float | None = None
    power_w: float | None = None
    boot_id: str = ""
    pid_namespace: str = ""
    clock_skew_s: Signed | None = None
    interfaces: Mapping[str, InterfaceSample] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineIdentity:
    """What tells machines apart: the ids of the boot and of the installation, and the PID namespace of the
    login. Each is empty where it is not known.
    """

    boot_id: str = ""
    machine_id: str = ""
    pid_namespace: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class UsageTotals:
    """Counters of a host since its boot (ADR 0132): CPU seconds, bytes in and out over its interfaces.

    None for a host with a declared capacity, which shares them with others. ``tasks``: CPU seconds of each
    instance since its start, of those that have ended too.
    """

    cpu_s: float | None = None
    network_bytes: float | None = None
    tasks: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class HostSample:
    """One host's part of the snapshot. An unreachable host has only its role, status and error.

    ``error`` is the cause, ``error_kind`` its stable name (``HostError.kind``), ``hint`` the remedy.
    ``sample_age_s``: age of the readings when the snapshot was taken. ``resident``: a profiler that stays on
    the host took them, so rates are smoothed already. ``generations``: by task, the highest generation the
    host was ever given, where ``tasks`` does not tell. ``other_tasks``: tasks of this fleet that the machine
    has under another host name, unless that host reports them itself. ``foreign_tasks``: tasks of other
    fleets; they are load, and nothing else is done with them. ``address``: as the inventory states it.
    ``machine``: machine id, user and state directories of the login, as ``ID/UID/HASH``; "" where there is no
    machine id. ``standbys``: the inactive copies of tasks that wait on the host; an active instance is in
    ``tasks``, and so is one that is just becoming active or inactive. ``grant``: how often the host has
    granted the fleet to a manager. ``foreign_grant``: number of the last grant to another manager than the
    one that took the snapshot. ``foreign_hosts``: hosts that the inventory lacks and on which other managers
    of the fleet may place tasks. ``counters``: "" where none are
    installed for this fleet, "installed", or why they cannot be read. ``totals``: where they were asked for.
    ``engines``: container engines that its user may use; None: no task has an image, so it was not asked.
    """

    role: Role
    status: HostStatus
    error: str = ""
    error_kind: str = ""
    hint: str = ""
    sample_age_s: float = field(default=0.0, metadata=in_document(always=True))
    resident: bool = False
    usage: Mapping[str, ResourceUsage] = field(
        default_factory=dict,
        metadata=in_document(
            by_resource=("capacity", "used"), host_only=True, needed_when=("status", HostStatus.OK)
        ),
    )
    links: Mapping[str, LinkSample] = field(default_factory=dict, metadata=in_document(always=True))
    tasks: Mapping[str, TaskSample] = field(default_factory=dict, metadata=in_document(always=True))
    standbys: Mapping[str, TaskSample] = field(default_factory=dict)
    device: DeviceSample = DeviceSample()
    generations: Mapping[str, int] = field(default_factory=dict)
    other_tasks: tuple[OtherTask, ...] = ()
    foreign_tasks: tuple[OtherTask, ...] = ()
    address: str = ""
    machine: str = ""
    grant: int = 0
    foreign_grant: int = 0
    foreign_hosts: tuple[str, ...] = ()
    counters: str = ""
    totals: UsageTotals | None = None
    engines: tuple[str, ...] | None = None

    @property
    def ok(self) -> bool:
        """Whether the host answered."""
        return self.status is HostStatus.OK

    @property
    def instances(self) -> dict[str, TaskSample]:
        """Every instance on the host, active or inactive, by task."""
        return {**self.standbys, **self.tasks}

    @property
    def measured(self) -> bool:
        """Whether every resource that a host measures is known."""
        return all(resource.name in self.usage for resource in MEASURED_HOST_RESOURCES)


@dataclass(frozen=True, slots=True, kw_only=True)
class TermRatings:
    """What a plugin says of hosts: by task, each host in 0..1. ``package``: its distribution and version."""

    package: Text
    tasks: Mapping[str, Mapping[str, Share]] = field(metadata=in_document("rated"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """The fleet at ``taken_at``.

    ``manager``, where present, makes the snapshot enough to repeat a decision; so do ``ratings``, by plugin,
    where the policy weighs them (ADR 149).
    """

    taken_at: Instant
    hosts: Mapping[str, HostSample]
    manager: ManagerState | None = None
    ratings: Mapping[str, TermRatings] = field(default_factory=dict)

    @property
    def silent_hosts(self) -> tuple[str, ...]:
        """Hosts that did not answer, without those that the operator declared powered off."""
        fenced = self.manager.fenced if self.manager else frozenset()
        return tuple(name for name, host in self.hosts.items() if not host.ok and name not in fenced)


def find_doubled_tasks(snapshot: Snapshot) -> dict[str, tuple[str, ...]]:
    """Managed tasks of which more than one instance is alive, with their hosts."""
    places: dict[str, list[str]] = {}
    for name, host in snapshot.hosts.items():
        for task, sample in host.tasks.items() if host.ok else ():
            if sample.managed and sample.state.alive:
                places.setdefault(task, []).append(name)
    return {task: tuple(hosts) for task, hosts in places.items() if len(hosts) > 1}


@dataclass(frozen=True, slots=True, kw_only=True)
class BandwidthMeasurement:
    """Measured rate of one link in bytes/s; None with the ``error`` where it could not be measured."""

    edge: str
    robot: str
    bytes_per_s: float | None
    error: str = ""
