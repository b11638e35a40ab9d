# SPDX-License-Identifier: Apache-2.0
"""Held requests over every transport to a host of this machine: prepared, then one line until the effect."""

import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.agent.link import protocol
from edgectl.errors import ConnectError, DeadlineError, HostError, RefusedError
from edgectl.model.inventory import Connection, Host, Role
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Session, Transport
from edgectl.transport.connections import SessionPool
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.transport.held_call import HeldCall, hold_agent_call
from edgectl.transport.ssh_session import SshExchange
from tests.agent.conftest import a_spec
from tests.agent.switching import a_check
from tests.pace import patience
from tests.sshd import Lab

ANSWERS_S = patience(30.0)
MOVES = 10


@pytest.fixture(params=[Connection.SSH, Connection.OPENSSH, Connection.LOCAL])
def held_host(
    request: pytest.FixtureRequest, lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Host:
    if request.param is Connection.LOCAL:
        monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
        return Host(name="edge1", role=Role.EDGE, host="localhost", connection=Connection.LOCAL)
    return lab.host("edge1", connection=request.param)


class Standby:
    """The task ``copy`` on one host, with commands that need nothing but a shell."""

    def __init__(self, host: Host, folder: Path, pool: Transport) -> None:
        self.host, self.pool = host, pool
        self.rule = {
            "activate": a_check(f"echo active >>{folder}/changes"),
            "deactivate": a_check(f"echo standby >>{folder}/changes"),
            "lifecycle": None, "ready": a_check("true"), "up_s": 0.0,
        }  # fmt: skip
        self.spec = a_spec("exec sleep 600", runtime="process", activation=self.rule)

    def connect(self) -> Session:
        return self.pool.connect(self.host, timeout=ANSWERS_S)

    def build(self, op: str, **fields: object) -> dict[str, object]:
        named = {"op": op, "fleet": "lab", "host": self.host.name, "task": "copy", "instance": "i1"}
        return {**named, "generation": 1, "manager": "ana", "spec": self.spec, **fields}

    def ask(self, op: str, **fields: object) -> dict[str, object]:
        with self.connect() as session:
            return call_agent(session, self.build(op, **fields), timeout=ANSWERS_S)

    def hold(self, session: Session, op: str, **fields: object) -> HeldCall:
        return hold_agent_call(session, self.build(op, **{"await_go_s": 60.0, **fields}), timeout=ANSWERS_S)


@pytest.fixture
def standby(held_host: Host, tmp_path: Path) -> Iterator[Standby]:
    with SessionPool(FleetTransport()) as pool:
        found = Standby(held_host, tmp_path, pool)
        found.ask("start", role="standby")
        assert found.ask("wait", timeout_s=ANSWERS_S / 2)["state"] == "ready"
        yield found
        found.ask("stop", instance=None, generation=None, stop=None)


def test_go_takes_one_way_and_the_command(standby: Standby) -> None:
    """Login, imports and shell are over by then: less than a call of the same request, which has them all."""
    waited, asked = [], []
    for number in range(MOVES):
        op = ("activate", "deactivate")[number % 2]
        with standby.connect() as session, standby.hold(session, op) as held:
            began = time.perf_counter()
            held.go()
            assert held.wait()["state"] == {"activate": "active", "deactivate": "standby"}[op]
            waited.append(time.perf_counter() - began)
        began = time.perf_counter()
        assert standby.ask(op, await_go_s=0.0)["state"] in {"active", "standby"}
        asked.append(time.perf_counter() - began)
    assert statistics.median(waited) < statistics.median(asked) / 2


def test_a_held_request_that_is_let_go_of_does_nothing(standby: Standby) -> None:
    with standby.connect() as session:
        with standby.hold(session, "activate"):
            pass
        with standby.hold(session, "activate") as held:
            assert held.wait()["state"] == protocol.NOT_ASKED
        with pytest.raises(RefusedError, match="instance i1 of copy runs here, not i2"):
            standby.hold(session, "activate", instance="i2")
        with standby.hold(session, "activate") as held:
            held.go()
            assert held.wait()["state"] == "active"


def test_several_are_held_over_one_connection(standby: Standby) -> None:
    with standby.connect() as session, standby.connect() as other:
        calls = [standby.hold(each, "activate") for each in (session, other, session)]
        for held in calls:
            held.go()
        assert [held.wait()["state"] for held in calls] == ["active"] * 3
        for held in calls:
            held.close()


def test_an_answer_that_does_not_come(standby: Standby) -> None:
    hanging = {**standby.spec, "activation": {**standby.rule, "activate": a_check("sleep 600", 300.0)}}
    with standby.connect() as session, standby.hold(session, "activate", spec=hanging) as held:
        held._timeout = 1.0
        held.go()
        with pytest.raises(DeadlineError, match="no answer within"):
            held.wait()


def test_error_output_and_status_of_what_has_ended(standby: Standby) -> None:
    with standby.connect() as session:
        exchange = session.exchange("echo no >&2; exit 3", b"", timeout=ANSWERS_S)
        assert exchange.read(timeout=ANSWERS_S) == b""
        said = exchange.build_reply()
        exchange.close()
    assert (said.stderr, said.status) == (b"no\n", 3)


def test_a_connection_that_is_lost_while_a_request_is_held(lab: Lab, tmp_path: Path) -> None:
    """The host ends the request by itself, and nothing was done."""
    with SessionPool(FleetTransport()) as pool:
        standby = Standby(lab.host("edge1", connection=Connection.SSH), tmp_path, pool)
        standby.ask("start", role="standby")
        standby.ask("wait", timeout_s=ANSWERS_S / 2)
        with standby.connect() as session:
            held = standby.hold(session, "activate")
            exchange = held._exchange
            inner = getattr(exchange, "_exchange", exchange)
            assert isinstance(inner, SshExchange)
            inner._session.cut()
            with pytest.raises((ConnectError, HostError)):
                held.wait()
            held.close()
        assert standby.ask("status")["tasks"]["copy"]["role"] == "standby"  # type: ignore[index]
        assert not (tmp_path / "changes").exists()
        standby.ask("stop", instance=None, generation=None, stop=None)
