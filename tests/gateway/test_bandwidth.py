"""Measuring a link: receive on the robot, send from the edge, one link at a time."""

from edgectl.errors import ConnectError
from edgectl.gateway.bandwidth import measure_bandwidth
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
