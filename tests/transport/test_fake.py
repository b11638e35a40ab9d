# SPDX-License-Identifier: Apache-2.0
"""The fake fleet uses the real protocol."""

import pytest

from edgectl.errors import ConnectError, DeadlineError, HostError, RefusedError
from edgectl.model.inventory import Connection, Host, Role
from edgectl.transport.agent_client import call_agent, stream_agent_log
from edgectl.transport.fake import FakeTransport
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.transport.held_call import hold_agent_call


def a_host(name: str = "edge1") -> Host:
    return Host(name=name, role=Role.EDGE, host="10.0.0.1")


def echo_request(request: dict[str, object]) -> dict[str, object]:
    return {"seen": request}


def test_requests_and_replies_travel_in_frames() -> None:
    transport = FakeTransport({"edge1": echo_request})
    request = {"op": "probe", "host": "edge1", "odd": 'quotes " and ümlauts\n'}
    with transport.connect(a_host(), timeout=30) as session:
        assert call_agent(session, request, timeout=30) == {"seen": request}
    assert transport.requests == [("edge1", request)]
    assert transport.address(a_host()) == "10.0.0.1"


def raise_on_request(error: HostError) -> object:
    def handler(_: dict[str, object]) -> dict[str, object]:
        raise error

    return handler


@pytest.mark.parametrize(
    "error", [RefusedError("no", hint="because"), DeadlineError("slow"), ConnectError("gone")]
)
def test_errors_of_a_handler(error: HostError) -> None:
    transport = FakeTransport({"edge1": raise_on_request(error)})  # type: ignore[dict-item]
    with pytest.raises(type(error), match=error.message) as caught:
        call_agent(transport.connect(a_host(), timeout=30), {"op": "status"}, timeout=30)
    assert caught.value.hint == error.hint


def test_hosts_that_cannot_be_reached() -> None:
    transport = FakeTransport({"edge1": DeadlineError("frozen")})
    with pytest.raises(DeadlineError, match="frozen") as caught:
        transport.connect(a_host(), timeout=30)
    assert caught.value.host == "edge1"
    with pytest.raises(ConnectError):
        transport.connect(a_host("edge2"), timeout=30)


def test_only_the_agents_command_line_runs() -> None:
    with pytest.raises(RefusedError):
        FakeTransport({"edge1": echo_request}).connect(a_host(), timeout=30).run("rm -rf /", b"", timeout=30)


def test_logs_are_followed() -> None:
    transport = FakeTransport({"edge1": lambda request: {"text": "one\ntwo\n", "tasks": {}}})
    pieces = stream_agent_log(
        transport.connect(a_host(), timeout=30),
        {"op": "follow", "fleet": "lab", "host": "edge1", "task": "slam", "tail": 5},
        idle_timeout=30,
    )
    assert b"".join(pieces) == b"one\ntwo\n"


def test_a_local_host_needs_no_ssh() -> None:
    import sys

    transports = FleetTransport()
    host = Host(name="here", role=Role.EDGE, host="localhost", connection=Connection.LOCAL)
    loaded = "paramiko" in sys.modules
    with transports.connect(host, timeout=30) as session:
        assert session.run("cat", b"x", timeout=20).stdout == b"x"
    assert transports.address(host) == "localhost"
    assert ("paramiko" in sys.modules) is loaded


HELD = {"op": "activate", "fleet": "lab", "host": "edge1", "task": "slam", "await_go_s": 5.0}


def test_a_held_request_reaches_its_handler_with_go() -> None:
    transport = FakeTransport({"edge1": lambda _request: {"state": "active"}})
    session = transport.connect(a_host(), timeout=30)
    with hold_agent_call(session, HELD, timeout=30) as held:
        assert transport.requests == []
        held.go()
        held.go()
        assert held.wait() == {"state": "active"}
    assert transport.requests == [("edge1", HELD)]


def test_a_held_request_without_go_is_not_asked() -> None:
    transport = FakeTransport({"edge1": lambda _request: {"state": "active"}})
    with hold_agent_call(transport.connect(a_host(), timeout=30), HELD, timeout=30) as held:
        assert held.wait() == {"state": "not-asked"}
    assert transport.requests == []
