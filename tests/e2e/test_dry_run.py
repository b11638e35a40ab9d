# SPDX-License-Identifier: Apache-2.0
"""Requests of apply to real hosts equal those printed by a dry run of the same plan."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import pytest

from edgectl.executor.dry_run import list_dry_run_requests
from edgectl.model.check import Check, CheckLocation
from edgectl.model.inventory import Host
from edgectl.model.plan import Plan
from edgectl.model.task import HandoffContract, HandoffOrder
from edgectl.transport.base import Exchange, Reply, Session, Transport
from edgectl.transport.fake import unpack_request
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from tests.builders import a_robot, an_edge, an_inventory
from tests.e2e.bench import EAGER, QUICK, Bench, a_local, a_mark, a_sleeper, open_bench
from tests.executor.test_dry_run import READY_ON_ROBOT, Sent, mask_request

EDGES = [a_local(an_edge("edge1"), "127.0.0.31"), a_local(an_edge("edge2"), "127.0.0.32")]
ROBOT = a_local(a_robot("robot1"), "127.0.0.41")
LINKS = {("edge1", "robot1"): 10e6, ("edge2", "robot1"): 10e6}


@dataclass
class RecordingTransport:
    """A transport that records every request to the hosts."""

    transport: Transport
    requests: Sent = field(default_factory=list)

    def connect(self, host: Host, *, timeout: float) -> "RecordingSession":
        return RecordingSession(self.transport.connect(host, timeout=timeout), host.name, self.requests)

    def address(self, host: Host) -> str:
        return self.transport.address(host)


@dataclass
class RecordingSession:
    session: Session
    host: str
    requests: Sent

    @property
    def python(self) -> str:
        return self.session.python

    def run(self, command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
        _, request = unpack_request(stdin)
        if not self.requests or self.requests[-1] != (self.host, request):  # sent again with the agent
            self.requests.append((self.host, request))
        return self.session.run(command, stdin, timeout=timeout, limit=limit)

    def stream(self, command: str, stdin: bytes, *, idle_timeout: float) -> Iterator[bytes]:
        yield from self.session.stream(command, stdin, idle_timeout=idle_timeout)

    def exchange(self, command: str, stdin: bytes, *, timeout: float) -> Exchange:
        self.requests.append((self.host, unpack_request(stdin)[1]))
        return self.session.exchange(command, stdin, timeout=timeout)

    def close(self) -> None:
        self.session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


@pytest.fixture
def bench(tmp_path: Path, isolated: Path) -> Iterator[Bench]:
    with open_bench(an_inventory(*EDGES, ROBOT, links=LINKS), tmp_path / "manager", isolated) as running:
        yield running


def apply_and_compare(bench: Bench) -> list[str]:
    """Apply; return the operations sent, after comparing them with a dry run of the same plan."""
    tap = RecordingTransport(bench.fleet.transport)
    printed: list[Any] = []

    def confirm(plan: Plan) -> bool:
        tap.requests.clear()
        entries = list_dry_run_requests(plan, bench.fleet.inventory, bench.fleet.tasks)
        printed.extend(mask_request(str(entry["host"]), entry["stdin"]) for entry in entries)  # type: ignore[arg-type]
        return True

    options = ApplyOptions(probe=QUICK, max_parallel=1)
    applied = plan_and_apply(replace(bench.fleet, transport=tap), EAGER, confirm, options)
    assert applied.results is not None
    assert applied.results.done, applied.results
    sent = [
        mask_request(host, {key: value for key, value in request.items() if key != "lease"})
        for host, request in tap.requests
    ]
    assert sent[: len(printed)] == printed
    assert {request["op"] for _, request in sent[len(printed) :]} <= {"status", "lease"}, (
        "after the plan: one more look, then the fleet is released"
    )
    return [str(request["op"]) for _, request in sent[: len(printed)]]


@pytest.mark.parametrize("order", list(HandoffOrder))
def test_start_move_and_stop_on_real_hosts(bench: Bench, order: HandoffOrder) -> None:
    names = ("safe_when", "hold", "release")
    hooks: dict[str, Any] = {name: Check(command=f": {name}", on=CheckLocation.ROBOT) for name in names}
    contract = HandoffContract(order=order, **hooks)
    ready = replace(READY_ON_ROBOT, command="true")
    task = a_sleeper("slam", a_mark(), robots=("robot1",), ready=ready, handoff=contract)
    start = ["start", "wait", "check", "mark"]
    assert apply_and_compare(bench.using(task)) == ["status", *start]
    elsewhere = replace(task, hosts=replace(task.hosts, never=(bench.where()["slam"],)))
    change = ["stop", *start] if order is HandoffOrder.STOP_FIRST else [*start, "stop"]
    assert apply_and_compare(bench.using(elsewhere)) == ["status", "check", "check", *change, "check"]
    assert apply_and_compare(bench.using()) == ["stop"]
