# SPDX-License-Identifier: Apache-2.0
"""Requests for ROS graphs, and replies that do not fit."""

from typing import Any

import pytest

from edgectl.agent.link import document_keys, protocol
from edgectl.errors import ReplyError
from edgectl.gateway.fanout import HostReply
from edgectl.gateway.ros_graph import build_graph_request, decode_graph
from edgectl.model.ros import RosGraph, RosSettings
from tests.builders import an_edge

NODE: dict[str, Any] = {
    "name": "/robot1/slam",
    "address": "10.0.0.9",
    "here": True,
    "pid": 4711,
    "fault": "",
    "task": "",
    "words": ["/opt/slam", "__name:=slam"],
    "named": True,
    "alike": 1,
    "publishes": ["/map"],
    "subscribes": ["/scan"],
}
DOCUMENT = {"v": 1, "op": "graph", "host": "edge1", "nodes": [NODE, {"name": "", "pid": 7}], "left_out": 0}


def decode(**changed: object) -> RosGraph:
    document = {**DOCUMENT, **changed}
    return decode_graph(HostReply(host=an_edge("edge1"), document=document, seconds=0.1))


def test_a_graph_is_decoded_and_an_entry_that_does_not_fit_is_left_out() -> None:
    assert [node.pid for node in decode().nodes] == [4711, 7]
    broken = [{**NODE, "pid": "7"}, {**NODE, "words": 3}, {**NODE, "here": "yes"}, "node", NODE]
    assert len(decode(nodes=broken).nodes) == 1
    assert decode(nodes=[{**NODE, "name": "/a\x1b[2J"}]).nodes[0].name == "/a\\x1b[2J"


@pytest.mark.parametrize(
    "changed", [{"host": "edge2"}, {"op": "doctor"}, {"nodes": None}, {"nodes": 3}, {"left_out": -1}]
)
def test_another_document_is_refused(changed: dict[str, object]) -> None:
    with pytest.raises(ReplyError):
        decode(**changed)


def test_the_request_has_the_stated_keys_and_the_environment_of_tasks() -> None:
    edge = an_edge("edge1", ros=RosSettings(version=2, domain=7), env={"ROS_LOCALHOST_ONLY": "1"})
    request = build_graph_request(edge, ["10.0.0.21"], timeout_s=8.0)
    assert set(request) == {"op", "fleet", "host", *document_keys.REQUEST_KEYS[protocol.OP_GRAPH]}
    assert (request["version"], request["env"]) == (
        2,
        {"ROS_DOMAIN_ID": "7", "ROS_LOCALHOST_ONLY": "1", "EDGECTL_HOST": "edge1"},
    )
