# SPDX-License-Identifier: Apache-2.0
"""The fleet as the inventory file states it: edges, robots and the links between them."""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum
from typing import TYPE_CHECKING

from edgectl.dataclass import dataclass
from edgectl.model.resource import HOST_RESOURCES, MEASURED_HOST_RESOURCES, ResourceMap
from edgectl.model.ros import RosSettings

if TYPE_CHECKING:  # few inventories have any
    from edgectl.model.event import EventHook

# Fleet of hosts that no inventory file states.
UNNAMED_FLEET = "unnamed"


class Role(StrEnum):
    """Role of a host in the paper's system: an edge (epsilon) or a robot (R)."""

    EDGE = "edge"
    ROBOT = "robot"


class Connection(StrEnum):
    """Transport to a host."""

    SSH = "ssh"
    OPENSSH = "openssh"
    LOCAL = "local"


class Runtime(StrEnum):
    """Process manager that holds the supervisor of a task on the host."""

    AUTO = "auto"
    SYSTEMD = "systemd"
    PROCESS = "process"


_HOST_RESOURCE_NAMES = tuple(resource.name for resource in HOST_RESOURCES)


class Capacity(ResourceMap[float]):
    """Declared capacity of a host by resource, in its unit; 0: none is declared."""

    __slots__ = ()
    DEFAULTS = dict.fromkeys(_HOST_RESOURCE_NAMES, 0.0)


class Limits(ResourceMap[float]):
    """Usable share of the measured or declared capacity by resource; above 1 is stated overcommit."""

    __slots__ = ()
    DEFAULTS = dict.fromkeys(_HOST_RESOURCE_NAMES, 1.0)


class BaseLoad(ResourceMap[float]):
    """Declared load of a slice besides its tasks by resource, in its unit."""

    __slots__ = ()
    DEFAULTS = dict.fromkeys(_HOST_RESOURCE_NAMES, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """One edge or robot.

    ``fleet`` is the owner of what this inventory runs there: requests carry it, and the host keeps the tasks
    of different fleets apart. ``ros``: what its nodes need to find others; None where nothing is known of it.
    ``max_temperature`` (degrees Celsius): near it the host has fewer usable cores. ``swarm``: contexts of
    docker on the host by which it reaches managers of its swarm.

    ``host`` is an address or an ssh_config alias. A declared ``capacity`` of what is measured otherwise makes
    the host a slice: its load is ``base`` plus its own process trees. ``onboard`` (robots) makes the robot a
    candidate for its own tasks; ``probe: false`` means that it is never contacted. ``password_command`` is an
    argument vector whose first line of output is the password; ``env_command`` one that prints secrets for
    the environment as lines NAME=value. ``transport`` names a plugin that connects, instead of
    ``connection``.
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
    max_temperature: float | None = None
    capacity: Capacity | None = None
    base: BaseLoad = BaseLoad()
    env: Mapping[str, str] = field(default_factory=dict)
    env_command: tuple[str, ...] = ()
    prelude: str = ""
    runtime: Runtime = Runtime.AUTO
    onboard: bool = False
    probe: bool = True
    ros: RosSettings | None = None
    swarm: tuple[str, ...] = ()
    fleet: str = UNNAMED_FLEET
    transport: str = ""

    @property
    def address(self) -> str:
        """The place that the inventory names: login, address and port, as far as they are stated."""
        if self.connection is Connection.LOCAL:
            return "local"
        login = f"{self.user}@" if self.user else ""
        return f"{login}{self.host}" + (f":{self.port}" if self.port else "")

    @property
    def shares_machine(self) -> bool:
        """Whether other hosts of the fleet may be on the same machine: slices, and hosts of this machine."""
        return self.is_slice or self.connection is Connection.LOCAL

    @property
    def is_slice(self) -> bool:
        """Whether capacity and load are the declared ones instead of those of the whole machine."""
        return self.capacity is not None and all(
            self.capacity[resource.name] > 0 for resource in MEASURED_HOST_RESOURCES
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Coordination:
    """The etcd that grants the fleet to one manager and keeps the manager's state (ADR 0080).

    ``endpoints``: (host, port), tried in turn. ``tls``: connect by TLS, with the PEM files ``ca``, ``cert``
    and ``key`` where they are stated. ``password_command``: an argument vector whose first line of output is
    the password of ``user``.
    """

    endpoints: tuple[tuple[str, int], ...]
    tls: bool = False
    ca: str = ""
    cert: str = ""
    key: str = ""
    user: str = ""
    password_command: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Inventory:
    """The fleet.

    ``hosts`` in natural order of names; ``links`` holds declared throughput in bytes/s by (edge, robot).
    ``fleet`` is the stated name, else one derived from the path of the file (``is_fleet_named`` tells which).
    ``probe_links``: idle links may be probed by sending for a moment (ADR 0077). ``coordination``: None where
    the hosts alone grant the fleet. ``on_event``: programs that are told of events.
    """

    hosts: Mapping[str, Host]
    links: Mapping[tuple[str, str], float] = field(default_factory=dict)
    digest: str = ""
    fleet: str = UNNAMED_FLEET
    is_fleet_named: bool = False
    probe_links: bool = True
    coordination: Coordination | None = None
    on_event: "tuple[EventHook, ...]" = ()

    @property
    def edges(self) -> tuple[Host, ...]:
        """The edges, in order."""
        return tuple(host for host in self.hosts.values() if host.role is Role.EDGE)

    @property
    def robots(self) -> tuple[Host, ...]:
        """The robots, in order."""
        return tuple(host for host in self.hosts.values() if host.role is Role.ROBOT)
