# SPDX-License-Identifier: Apache-2.0
"""State of the fleet for a node of ROS, measured again and again."""

import time
from collections.abc import Callable, Mapping

from edgectl.errors import EdgectlError, UsageError
from edgectl.export.ros_gateway import RosNode
from edgectl.formats.document import Document
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.inventory import Host
from edgectl.model.ros import RosSettings
from edgectl.model.snapshot import Snapshot
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.probe import probe_fleet


def choose_ros_settings(hosts: Mapping[str, Host], host: str | None) -> RosSettings | None:
    """``ros`` of ``host``, else the one that the hosts have in common; None where none states it.

    Raises:
        UsageError: the hosts differ, so that there is more than one graph.
    """
    if host is not None:
        return hosts[host].ros
    stated = [(name, each.ros) for name, each in hosts.items() if each.ros is not None]
    for name, settings in stated[1:]:
        if settings.derive_variables() != stated[0][1].derive_variables():
            raise UsageError(
                f"{stated[0][0]} and {name} are in different graphs of ROS",
                hint=f"choose one: --host {stated[0][0]}",
            )
    return stated[0][1] if stated else None


def publish_fleet(
    fleet: Fleet,
    node: RosNode,
    encode: Callable[[Snapshot], Document],
    *,
    options: ProbeOptions,
    every: float,
) -> None:
    """Measure the fleet each ``every`` seconds and have ``node`` publish it, until it fails.

    Raises:
        EdgectlError: the node failed; a probe that failed is a warning, and what was published grows stale.
    """
    said = ""
    while True:
        due = time.monotonic() + every
        try:
            document = encode(probe_fleet(fleet, options))
        except EdgectlError as error:
            if error.message != said:
                fleet.warn(error.message)
            said = error.message
        else:
            said = ""
            node.send(document)
        node.wait(due - time.monotonic())
