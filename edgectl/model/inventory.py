"""Who is in the fleet: edges, robots and the links between them, as the inventory file states them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Role(StrEnum):
    """What a host is in the paper's system: an edge (epsilon) or a robot (R)."""

    EDGE = "edge"
    ROBOT = "robot"


class Connection(StrEnum):
    """How a host is reached."""

    SSH = "ssh"
    OPENSSH = "openssh"
    LOCAL = "local"


class Runtime(StrEnum):
    """What stands around the supervisor of a task on the host."""

    AUTO = "auto"
    SYSTEMD = "systemd"
    PROCESS = "process"


@dataclass(frozen=True, slots=True, kw_only=True)
class Capacity:
    """Declared capacity of a slice: cores and bytes, both > 0."""

    cpu: float
    memory: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Usable share of the measured or declared capacity; above 1 is stated overcommit."""

    cpu: float = 1.0
    memory: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseLoad:
    """Declared load of a slice besides its tasks: cores and bytes."""

    cpu: float = 0.0
    memory: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """One edge or robot.

    ``host`` is an address or an ssh_config alias. ``capacity`` makes the host a slice: its load is ``base`` plus its own task trees.
    ``onboard`` (robots) makes the robot a candidate for its own tasks; ``probe: false`` means that it is never contacted.
    ``password_command`` is an argument vector whose first line of output is the password; ``env_command`` one that prints secrets
    for the environment as lines NAME=value.
    """

    name: str
    role: Role
    host: str
    connection: Connection = Connection.SSH
    port: int | None = None
    user: str | None = None
    identity_file: str | None = None
    proxy_jump: str | None = None
    password_command: tuple[str, ...] = ()
    labels: Mapping[str, str] = field(default_factory=dict)
    limits: Limits = Limits()
    capacity: Capacity | None = None
    base: BaseLoad = BaseLoad()
    env: Mapping[str, str] = field(default_factory=dict)
    env_command: tuple[str, ...] = ()
    prelude: str = ""
    runtime: Runtime = Runtime.AUTO
    onboard: bool = False
    probe: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Inventory:
    """The fleet. ``hosts`` in natural order of names; ``links`` holds declared throughput in bytes/s by (edge, robot)."""

    hosts: Mapping[str, Host]
    links: Mapping[tuple[str, str], float] = field(default_factory=dict)
    digest: str = ""

    @property
    def edges(self) -> tuple[Host, ...]:
        """The edges, in order."""
        return tuple(host for host in self.hosts.values() if host.role is Role.EDGE)

    @property
    def robots(self) -> tuple[Host, ...]:
        """The robots, in order."""
        return tuple(host for host in self.hosts.values() if host.role is Role.ROBOT)
