# SPDX-License-Identifier: Apache-2.0
"""Replies to the doctor as facts; an invalid reply costs its host the answer."""

import copy
from typing import Any

import pytest

from edgectl.errors import ReplyError
from edgectl.gateway.host_facts import SentRequest, decode_host_facts
from edgectl.gateway.probe_reply import ReplyContext
from edgectl.model.diagnosis import Disk, HostFacts, Logind, ShellEnvironment
from edgectl.model.snapshot import CapacitySource, MachineIdentity
from tests.builders import NOW, an_edge

Document = dict[str, object]
DOCUMENT: Document = {
    "v": 1, "op": "doctor", "host": "edge1", "python": "3.6.15", "psutil": False,
    "logind": {"user": "jetson", "present": True, "lingers": False, "removes_ipc": True, "kills": False},
    "disk": {"path": "/home/jetson/.local/state/edgectl", "free_bytes": 1e9, "total_bytes": 8e9, "files_left": None, "obstacle": ""},
    "memory": {"total_bytes": 8e9, "used_bytes": 3e9},
    "links": {"robot1": {"found": True, "reachable": None, "rtt_ms": None, "interface": "eth0", "speed_bytes_per_s": 125e6}},
    "surroundings": {"status": 1, "timed_out": False, "said": "no\tsuch", "variables": {"ROS_DOMAIN_ID": "7", "RMW_IMPLEMENTATION": ""}},
    "clock": {"began": NOW + 9.0, "ended": NOW + 10.5},
}  # fmt: skip


def read_facts(document: Document, **context: Any) -> HostFacts:
    """Decode a reply to a request sent at NOW and answered 2 s later."""
    asked = SentRequest(began=NOW, addresses={"robot1": "10.0.0.21"})
    return decode_host_facts(
        document, ReplyContext(host=an_edge("edge1"), answered_at=NOW + 2.0, **context), asked
    )


def test_a_whole_answer() -> None:
    found = read_facts(DOCUMENT)
    assert found.login_s == 0.5
    assert found.skew_s == (8.5, 9.0)
    assert found.machine == MachineIdentity()
    told = read_facts({**DOCUMENT, "machine": {"boot_id": "b", "pid_namespace": "pid:[1]"}})
    assert told.machine == MachineIdentity(boot_id="b", pid_namespace="pid:[1]")
    assert found.logind == Logind(user="jetson", present=True, removes_ipc=True)
    assert found.disk == Disk(path="/home/jetson/.local/state/edgectl", free_bytes=1e9, total_bytes=8e9)
    assert found.surroundings == ShellEnvironment(
        variables={"ROS_DOMAIN_ID": "7", "RMW_IMPLEMENTATION": ""}, status=1, last_line="no\\tsuch"
    )
    assert (found.links["robot1"].reachable, found.links["robot1"].capacity_bytes_per_s) == (None, 125e6)


def test_capacity_comes_from_the_same_sources_as_in_a_probe() -> None:
    assert (
        read_facts(DOCUMENT, declared={"robot1": 1e6}).links["robot1"].capacity_source
        is CapacitySource.DECLARED
    )
    assert (
        read_facts(DOCUMENT, measured={"robot1": 2e6}).links["robot1"].capacity_source
        is CapacitySource.MEASURED
    )
    assert read_facts(DOCUMENT).links["robot1"].capacity_source is CapacitySource.NIC
    assert read_facts({**DOCUMENT, "links": {}}).links["robot1"].capacity_source is CapacitySource.ASSUMED


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("v",), 2), (("op",), "probe"), (("host",), "edge2"), (("clock", "began"), "now"), (("clock", "ended"), None),
        (("memory", "total_bytes"), 0), (("memory", "used_bytes"), -1), (("disk", "free_bytes"), True), (("disk", "files_left"), 1.5),
        (("logind", "lingers"), "no"), (("machine",), 7), (("links",), []),
        (("surroundings", "variables"), "x"), (("surroundings", "status"), "1"),
    ],
)  # fmt: skip
def test_what_is_odd_is_refused(path: tuple[str, ...], value: object) -> None:
    document = copy.deepcopy(DOCUMENT)
    place = document
    for key in path[:-1]:
        place = place[key]  # type: ignore[assignment]
    place[path[-1]] = value
    with pytest.raises(ReplyError):
        read_facts(document)


@pytest.mark.parametrize("odd", [1, None, {"reachable": "yes"}])
def test_an_odd_route_counts_as_an_unknown_name_and_an_odd_variable_as_none(odd: object) -> None:
    document = {**DOCUMENT, "links": {"robot1": odd, "x": odd}}
    found = read_facts({**document, "surroundings": {"variables": {"A": odd, "B": "b"}}})
    assert not found.links["robot1"].found
    assert found.surroundings.variables == {"B": "b"}
