# SPDX-License-Identifier: Apache-2.0
"""Builders of facts with the defaults of a healthy host."""

from dataclasses import replace

from edgectl.model.diagnosis import Disk, HostFacts, LinkFacts, Logind, ManagerFacts, ShellEnvironment
from edgectl.model.snapshot import CapacitySource

GI = 2.0**30
DISK = Disk(
    path="/home/jetson/.local/state/edgectl", free_bytes=10 * GI, total_bytes=28 * GI, files_left=1_000_000
)
LOGIND = Logind(user="jetson", present=True, lingers=True, removes_ipc=True)
LINK = LinkFacts(
    address="10.0.0.21", found=True, reachable=True, interface="eth0", rtt_ms=1.25,
    capacity_bytes_per_s=12.5e6, capacity_source=CapacitySource.NIC,
)  # fmt: skip
FACTS = HostFacts(
    login_s=0.09, python="3.8.10", psutil=True, skew_s=(-0.02, 0.03), logind=LOGIND, disk=DISK,
    total_bytes=8 * GI, used_bytes=2 * GI, links={"robot1": LINK},
)  # fmt: skip
MANAGER = ManagerFacts(
    state=replace(DISK, path="/home/ana/.local/state/edgectl"), known_hosts={"/home/ana/.ssh/known_hosts": ""}
)


def ros_facts(**variables: str) -> HostFacts:
    """Return the facts of a host whose tasks see these ROS variables."""
    return replace(FACTS, links={}, surroundings=ShellEnvironment(variables=variables))
