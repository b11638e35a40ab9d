# SPDX-License-Identifier: Apache-2.0
"""The ROS of a host: what its nodes need in order to find those of other hosts."""

from collections.abc import Mapping
from typing import Annotated

from edgectl.dataclass import dataclass
from edgectl.model.encoding import Bounds, EachAlone
from edgectl.model.reported import Text

# What a host itself fills in where a task starts: the address of this host on its way to the robots, that of
# the task's robot, and the URI of the ROS 1 master.
HOST_ADDRESS, ROBOT_ADDRESS, MASTER = "host_address", "robot_address", "master"
HOST_PLACEHOLDERS = (HOST_ADDRESS, ROBOT_ADDRESS, MASTER)
MASTER_PORT = 11311


@dataclass(frozen=True, slots=True, kw_only=True)
class RosSettings:
    """ROS 1 or ROS 2 on a host. None: not stated, so nothing is derived.

    ``setup``: files that are sourced before each command, in order. ``master``: URI of the ROS 1 master.
    ``domain``, ``rmw`` and ``discovery_server`` are of ROS 2.
    """

    version: int
    setup: tuple[str, ...] = ()
    master: str | None = None
    domain: int | None = None
    rmw: str | None = None
    discovery_server: str | None = None

    def derive_variables(self) -> Mapping[str, str]:
        """The environment that follows; a value may have placeholders, which the host fills in."""
        if self.version == 1:
            master = {} if self.master is None else {"ROS_MASTER_URI": self.master}
            return {**master, "ROS_IP": f"{{{HOST_ADDRESS}}}"}
        stated = {
            "ROS_DOMAIN_ID": self.domain,
            "RMW_IMPLEMENTATION": self.rmw,
            "ROS_DISCOVERY_SERVER": self.discovery_server,
        }
        return {name: str(value) for name, value in stated.items() if value is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class RosTopic:
    """A topic on which a message must come within so many seconds."""

    name: str
    within: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RosCheck:
    """What must hold in the ROS graph; at least one is stated, and all that are must hold.

    ``lifecycle``: the state of the ROS 2 lifecycle of ``node``.
    """

    node: str | None = None
    topic: RosTopic | None = None
    service: str | None = None
    lifecycle: str | None = None

    def describe(self) -> str:
        """The condition in words."""
        parts = (
            f"node {self.node} is {self.lifecycle or 'alive'}" if self.node else "",
            f"a message on {self.topic.name} within {self.topic.within:g} s" if self.topic else "",
            f"service {self.service} answers" if self.service else "",
        )
        return ", ".join(part for part in parts if part)


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphNode:
    """A node of a running graph, as one host sees it; without a name it is the master of ROS 1.

    ``here``: whether it runs on that host, None where that is not known; ``address``: where else. ``pid``: 0
    where its process is not known, for the reason ``fault``. ``task``: FLEET/HOST/TASK of the task to which
    the process belongs. ``words``: what of its command line stays from start to start; ``alike``: how many
    other processes have the same; ``named``: ``detect: {ros_node: ..}`` finds this process and no other.
    """

    name: Text
    address: Text = ""
    here: bool | None = None
    pid: Annotated[int, Bounds(maximum=2.0**31)] = 0
    fault: Text = ""
    task: Text = ""
    words: tuple[Text, ...] = ()
    named: bool = False
    alike: Annotated[int, Bounds(maximum=2.0**31)] = 0
    publishes: tuple[Text, ...] = ()
    subscribes: tuple[Text, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class RosGraph:
    """A running graph as one host sees it; so many nodes are ``left_out`` for which its reply has no room."""

    nodes: Annotated[tuple[GraphNode, ...], EachAlone()]
    left_out: Annotated[int, Bounds(maximum=2.0**31)] = 0
