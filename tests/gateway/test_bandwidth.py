# SPDX-License-Identifier: Apache-2.0
"""Measuring a link: receive on the robot, send from the edge, one link at a time."""

from edgectl.errors import ConnectError
from edgectl.gateway.bandwidth import measure_bandwidth, probe_idle_links
from edgectl.model.link_reading import LinkSampleResult
from edgectl.transport.fake import FakeTransport
from tests.builders import a_robot, an_edge, an_inventory

SENT: dict[str, object] = {"bytes": 4_000_000, "seconds": 2.0}


def test_each_link_is_measured_in_turn_and_a_failure_costs_only_itself() -> None:
    transport = FakeTransport(
        {
            "edge1": lambda _request: SENT,
            "edge2": ConnectError("switched off"),
            "robot1": lambda _request: {"port": 4000, "token": "secret"},
        }
    )
    inventory = an_inventory(
        an_edge("edge1"), an_edge("edge2"), a_robot("robot1"), a_robot("robot2", probe=False)
    )
    first, second = measure_bandwidth(inventory, transport, seconds=2.0)
    assert (first.edge, first.robot, first.bytes_per_s) == ("edge1", "robot1", 2e6)
    assert (second.bytes_per_s, second.error) == (None, "switched off")
    sink, send = transport.requests[:2]
    assert sink == ("robot1", {"op": "sink", "fleet": "unnamed", "host": "robot1", "seconds": 2.0})
    assert send[1] == {
        "op": "send",
        "fleet": "unnamed",
        "host": "edge1",
        "address": "robot1.lab",
        "port": 4000,
        "token": "secret",
        "seconds": 2.0,
    }


def test_a_sender_that_talks_nonsense_measures_nothing() -> None:
    transport = FakeTransport(
        {
            "edge1": lambda _request: {"bytes": -1, "seconds": 0},
            "robot1": lambda _request: {"port": 1, "token": ""},
        }
    )
    (found,) = measure_bandwidth(an_inventory(an_edge("edge1"), a_robot("robot1")), transport, seconds=1.0)
    assert found.bytes_per_s is None


def test_an_idle_link_is_probed_by_token_and_within_its_bounds() -> None:
    transport = FakeTransport(
        {
            "edge1": lambda _request: {"bytes_per_s": 2e6, "full": True},
            "edge2": lambda _request: {"error": {"kind": "no-path", "message": "refused", "hint": ""}},
            "robot1": lambda _request: {"port": 4000, "token": "secret"},
            "robot2": lambda _request: {"port": 4001, "token": "other"},
        }
    )
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"), a_robot("robot2"))
    found = probe_idle_links(inventory, transport, {("edge1", "robot1"): 125e6, ("edge2", "robot2"): 6.75e6})
    assert found == {
        ("edge1", "robot1"): LinkSampleResult(bytes_per_s=2e6, full=True),
        ("edge2", "robot2"): LinkSampleResult(refused=True),
    }
    (sent,) = [request for name, request in transport.requests if name == "edge1"]
    assert sent == {
        "op": "sample-link",
        "fleet": "unnamed",
        "host": "edge1",
        "address": "robot1.lab",
        "port": 4000,
        "token": "secret",
        "seconds": 0.09,
        "rate_bytes_per_s": 25e6,
    }
