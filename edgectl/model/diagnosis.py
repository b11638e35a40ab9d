# SPDX-License-Identifier: Apache-2.0
"""Facts that ``edgectl doctor`` collects, and findings that it draws from them.

Quantities are bytes, seconds and bytes per second; clocks are seconds since 1970.
"""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.agent.link import protocol
from edgectl.dataclass import dataclass
from edgectl.model.snapshot import CapacitySource, MachineIdentity


class Severity(StrEnum):
    """Severity of a finding, least first."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One check: on ``host`` (None: this machine), what was found, and the command or edit that corrects it
    (empty where all is well).
    """

    host: str | None
    check: str
    level: Severity
    message: str
    remedy: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Logind:
    """Behaviour of systemd-logind when the last login of ``user`` ends.

    ``present`` is false where no logind runs. ``removes_ipc``: it removes the user's shared memory (never
    that of root and system users). ``kills``: it kills what is left running.
    """

    user: str
    present: bool = False
    lingers: bool = False
    removes_ipc: bool = False
    kills: bool = False


# The obstacle where something else stands in the place of a state directory.
NOT_A_DIRECTORY = protocol.NO_DIRECTORY


@dataclass(frozen=True, slots=True, kw_only=True)
class Disk:
    """The file system of a state directory at ``path``; ``files_left`` is None where it does not count files.

    ``obstacle`` says why the directory cannot be used; empty where it can. ``in_shared_memory``: shared
    memory takes its place until a reboot. ``skipped``: directories in its place, or in that of shared memory,
    that belong to another user.
    """

    path: str
    free_bytes: float
    total_bytes: float
    files_left: int | None = None
    obstacle: str = ""
    in_shared_memory: bool = False
    skipped: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ShellEnvironment:
    """Environment of a task's command on a host, after its prelude: ROS variables by name, empty where they
    are not set.

    ``status`` is that of the prelude's last command; None where the prelude ended the shell, or did not end
    in time (``timed_out``). ``said`` is the last line that it printed.
    """

    variables: Mapping[str, str] = field(default_factory=dict)
    status: int | None = 0
    timed_out: bool = False
    last_line: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkFacts:
    """The way from an edge to a robot.

    ``address`` is where the robot is looked for; ``found`` whether that name means anything there.
    ``reachable``: None where nothing came back. ``interface``: None where there is no route.
    ``capacity_bytes_per_s`` and its source as in a probe.
    """

    address: str
    found: bool
    reachable: bool | None
    interface: str | None
    rtt_ms: float | None
    capacity_bytes_per_s: float
    capacity_source: CapacitySource


@dataclass(frozen=True, slots=True, kw_only=True)
class RosFacts:
    """What a host with ``ros`` has of it.

    ``missing_files``: set-up files that cannot be read; ``missing_packages``: those of the tasks that are not
    found. ``addresses``: the host's own address on its way to each robot. ``interfaces``: those that are up,
    without the loopback one; ``no_multicast``: those of them that have none. The others are limits of the
    kernel in bytes, None where it has none.
    """

    missing_files: tuple[str, ...] = ()
    missing_packages: tuple[str, ...] = ()
    addresses: Mapping[str, str] = field(default_factory=dict)
    interfaces: tuple[str, ...] = ()
    no_multicast: tuple[str, ...] = ()
    receive_bytes: float | None = None
    fragment_bytes: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareFacts:
    """What a host has that few have: GPUs and their memory, draw in watts, what is gone of its battery (0..1)
    and its temperature. None: it cannot be read.
    """

    gpus: float = 0.0
    gpu_total_bytes: float = 0.0
    used_watts: float | None = None
    used_charge: float | None = None
    temperature_c: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EngineFacts:
    """A container engine of a host: its version, or the ``error`` for which it runs nothing."""

    version: str = ""
    error: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostFacts:
    """Facts of one host that answered.

    ``login_s``: from the first packet to the agent's first step, and back. ``skew_s``: the least and the most
    by which its clock may be ahead of ours (below 0: behind). ``engines``: its container engines by name,
    where a task has an image; else None.
    """

    login_s: float
    python: str
    psutil: bool
    skew_s: tuple[float, float]
    logind: Logind
    disk: Disk
    total_bytes: float
    used_bytes: float
    machine: MachineIdentity = MachineIdentity()
    surroundings: ShellEnvironment = ShellEnvironment()
    ros: RosFacts = RosFacts()
    hardware: HardwareFacts = HardwareFacts()
    links: Mapping[str, LinkFacts] = field(default_factory=dict)
    engines: Mapping[str, EngineFacts] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class UnreachableHost:
    """Error of a host that could not be asked: ``kind`` as ``HostError.kind``, and the remedy where one is
    known.
    """

    kind: str
    error: str
    hint: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class EtcdEndpoint:
    """One endpoint of an etcd: its version, or the ``error`` for which it serves no request."""

    address: str
    version: str = ""
    error: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ManagerFacts:
    """The machine on which edgectl runs.

    ``known_hosts``: files that hold host keys, each with why it cannot be read (empty: it can). ``ssh``:
    whether there is an ssh program. ``etcd``: the endpoints of ``coordination``.
    """

    state: Disk
    known_hosts: Mapping[str, str] = field(default_factory=dict)
    ssh: bool = True
    etcd: tuple[EtcdEndpoint, ...] = ()


FactsByHost = Mapping[str, HostFacts | UnreachableHost]


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """All findings: this machine's first, then host by host in the order of the inventory."""

    findings: tuple[Finding, ...]

    @property
    def worst(self) -> Severity:
        """The level of the worst finding."""
        levels = {finding.level for finding in self.findings}
        return next((level for level in (Severity.FAILED, Severity.WARNING) if level in levels), Severity.OK)

    @property
    def counts(self) -> dict[Severity, int]:
        """Count of findings by level."""
        return {level: sum(finding.level is level for finding in self.findings) for level in Severity}
