# SPDX-License-Identifier: Apache-2.0
"""A host of the fleet that lies: what it reports decides nothing about tasks that were placed elsewhere."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edgectl.gateway.task_lookup import find_doubled_instances, find_task_host
from edgectl.model.check import Check
from edgectl.model.policy import Policy
from edgectl.model.result import Outcome
from edgectl.model.task import HostRules
from edgectl.transport.fake import FakeTransport
from edgectl.transport.fleet_lease import FleetLease
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.fleet_lease import _get_patience_s
from edgectl.usecases.stop import restart_tasks, stop_tasks
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet, Request

POLICY = Policy()
Lie = Callable[[dict[str, Any]], None]


class Site:
    """Two honest edges and a liar: ``lie`` changes what ``evil`` and ``robot1`` answer to a probe."""

    def __init__(self, state: Path) -> None:
        self.hosts = FakeFleet.of(["a", "b", "evil", "robot1"])
        self.said: list[str] = []
        self.now = NOW
        self.lie: Lie = lambda _reply: None
        evil, robot = self.hosts["evil"], self.hosts["robot1"]

        def answer(host: Any) -> Callable[[Request], Request]:
            def reply(request: Request) -> Request:
                honest = host(request)
                if request["op"] == "probe":
                    self.lie(honest)
                return dict(honest)

            return reply

        self.fleet = Fleet(
            inventory=an_inventory(an_edge("a"), an_edge("b"), an_edge("evil"), a_robot("robot1")),
            tasks=some_tasks(
                a_task("t1", cpu=1.0, never=["evil"]),
                a_task("t2", cpu=1.0, only=["a", "b"]),
                a_task("t3", cpu=1.0),
            ),
            transport=FakeTransport(
                {**dict(self.hosts.hosts), "evil": answer(evil), "robot1": answer(robot)}
            ),
            state=state,
            clock=self._tick,
            warn=self.said.append,
        )
        self.hosts["evil"].used = 3.5

    def _tick(self) -> float:
        self.now += 1.0
        return self.now

    def apply(self) -> None:
        applied = plan_and_apply(self.fleet, POLICY)
        assert applied.results is None or applied.results.done


@pytest.fixture
def site(tmp_path: Path) -> Site:
    made = Site(tmp_path)
    made.apply()
    assert set(made.hosts.placed.values()) <= {"a", "b"}
    return made


def reports(state: str, **fields: object) -> Lie:
    """Claim all three tasks, with a generation far above that of the placed ones."""
    entry = {"state": state, "pid": 1, "age_s": 1.0, "generation": (1 << 33) - 1, "instance": "x", **fields}

    def lie(reply: dict[str, Any]) -> None:
        if reply["host"] == "evil":
            reply["tasks"] = {name: dict(entry) for name in ("t1", "t2", "t3")}

    return lie


@pytest.mark.parametrize(
    "lie",
    [
        reports("completed", spec_hash=""),
        *(reports("completed", spec_hash=f"hash-{name}") for name in ("t1", "t2", "t3")),
        reports("running"),
        *(reports("ready", spec_hash=f"hash-{name}") for name in ("t1", "t2", "t3")),
        reports("running", managed=False),
        reports("failed", given_up=True, spec_hash="hash-t3"),
        # a check that nobody asked for, by a robot, whose word about its own tasks counts everywhere
        lambda reply: reply.update(checks={name: {"exit": 0} for name in ("t1", "t2", "t3")}),
        lambda reply: reply.update(generations=dict.fromkeys(("t1", "t2", "t3"), 1 << 63)),
    ],
)
def test_a_liar_neither_stops_nor_takes_tasks_of_other_hosts(site: Site, lie: Lie) -> None:
    """Neither the running ones, nor, with nothing placed there any more, those that are started again."""
    before, site.lie = dict(site.hosts.placed), lie
    site.apply()
    assert site.hosts.placed == before
    assert set(site.hosts.placed) == {"t1", "t2", "t3"}
    assert not site.hosts.world.overlap
    site.apply()
    assert site.hosts.placed == before


def test_what_a_liar_claims_is_told(site: Site) -> None:
    site.lie = reports("completed", spec_hash="hash-t3")
    site.apply()
    placed = site.hosts.placed["t3"]
    assert f"evil reports t3 as completed, but it is placed on {placed}: the report is ignored" in site.said


def test_a_crashed_task_is_started_again_although_a_liar_claims_it(site: Site) -> None:
    host = site.hosts.placed["t3"]
    site.hosts[host].tasks["t3"].update(state="failed", pid=0)
    site.lie = reports("running", spec_hash="hash-t3")
    started = len([event for event in site.hosts.world.events if event.startswith("start t3")])
    site.apply()
    events = [event for event in site.hosts.world.events if event.startswith("start t3")]
    assert len(events) == started + 1


def test_generations_of_a_liar_do_not_make_honest_hosts_unusable(site: Site) -> None:
    """It names the highest generation that is believed; starts elsewhere and its removal go on all the same."""
    site.lie = lambda reply: reply.update(
        generations={"t3": (1 << 33), "t1": 1 << 63, "t2": -5} if reply["host"] == "evil" else {}
    )
    for _ in range(3):
        applied = restart_tasks(site.fleet, ["t3"])
        assert applied.results is not None
        assert applied.results.done
    without = dataclasses.replace(
        site.fleet, inventory=an_inventory(an_edge("a"), an_edge("b"), a_robot("robot1"))
    )
    stopped = stop_tasks(without, ["t3"])
    assert stopped.results is not None
    assert [action.outcome for action in stopped.results.actions] == [Outcome.DONE]


def test_a_task_that_was_placed_on_the_liar_cannot_spoil_generations_either(site: Site) -> None:
    """The highest generation is sent to an honest host, and can be sent to it again and again."""
    tasks = some_tasks(a_task("t3", cpu=1.0, hosts=HostRules(pin="evil")))
    fleet = dataclasses.replace(site.fleet, tasks=tasks)
    plan_and_apply(fleet, POLICY)
    site.lie = lambda reply: (
        reply["tasks"].get("t3", {}).update(generation=1 << 33) if reply["host"] == "evil" else None
    )
    for _ in range(2):
        plan_and_apply(site.fleet, Policy(move_margin=0.0, min_dwell=0.0))
        assert restart_tasks(site.fleet, ["t3"]).results is not None
    assert site.hosts.placed["t3"] in ("a", "b", "evil")


def test_restart_restarts_the_placed_instance_and_not_the_claimed_one(tmp_path: Path) -> None:
    site = Site(tmp_path)
    site.fleet = dataclasses.replace(site.fleet, tasks=some_tasks(a_task("t3", cpu=1.0, pin="b")))
    site.apply()
    site.hosts["a"].tasks["t3"] = {**site.hosts["b"].tasks["t3"], "instance": "x", "generation": 1 << 33}
    restart_tasks(site.fleet, ["t3"])
    assert site.hosts.placed["t3"] == "b"


@pytest.mark.parametrize("text", ["half \ud800", "\x9b31m\u202e", "x" * 900_000])
def test_texts_of_failures_are_bounded_and_printable(site: Site, text: str) -> None:
    """In messages, results and files, also of the replies of starts and waits."""
    site.hosts["a"].faults["wait"] = lambda _request: {"state": "failed", "detail": text, "exit_code": text}
    site.hosts["b"].faults["wait"] = site.hosts["a"].faults["wait"]
    applied = restart_tasks(site.fleet, ["t3"])
    assert applied.results is not None
    (action,) = applied.results.actions
    assert action.outcome is Outcome.FAILED
    assert len(action.error) < 2000
    assert action.error.isprintable()
    action.error.encode()


@pytest.mark.parametrize("odd", [None, "ready", [], {"state": "happy"}, {"state": "running", "age_s": 1e12}])
def test_an_odd_entry_of_a_status_reply_costs_that_entry(site: Site, odd: object) -> None:
    """The task that is asked for is found, on this host and on others; nothing else ends with an error."""
    site.hosts["evil"].tasks["job"] = {"state": "failed", "age_s": 5.0}
    status = site.hosts["evil"]._status
    site.hosts["evil"].faults["status"] = lambda request: {
        "tasks": {**status({**request, "task": None})["tasks"], "x": odd, "t2": odd}  # type: ignore[dict-item]
    }
    inventory, transport = site.fleet.inventory, site.fleet.transport
    found, alive, silent = find_task_host("job", inventory, transport, timeout=1.0)
    assert (found, alive, silent) == (inventory.hosts["evil"], False, ())
    found, alive, silent = find_task_host("t2", inventory, transport, timeout=1.0)
    assert (found, alive, silent) == (inventory.hosts[site.hosts.placed["t2"]], True, ("evil",))
    hosts = list(inventory.hosts.values())
    doubled = find_doubled_instances(hosts, transport, timeout=1.0)
    assert set(doubled) == {"t2"}  # what cannot be read may run


def test_a_liar_delays_by_a_cycle_of_a_watch_and_by_no_year() -> None:
    """It says that a watch with a cycle of 30 years holds the fleet."""
    lease = FleetLease(holder="h", session="s", who="me", verb="apply", clock=lambda: 0.0)
    lease.build_claim("evil")
    held = {"state": "held", "who": "x", "verb": "watch", "age_s": 1, "left_s": 1e9, "every_s": 1e9}
    lease.take_reply("evil", held)
    assert _get_patience_s(lease) == 75.0


def test_a_host_that_replies_to_waits_at_once_is_asked_twice_a_second(site: Site) -> None:
    """Until the wait is over, and not thousands of times."""
    asked: list[Request] = []

    def hurry(request: Request) -> Request:
        asked.append(request)
        return {"state": "starting", "detail": "soon"}

    ready = Check(command="true", timeout=0.6)
    site.fleet = dataclasses.replace(
        site.fleet, tasks=some_tasks(a_task("t4", cpu=0.1, pin="evil", ready=ready))
    )
    site.hosts["evil"].faults["wait"] = hurry
    applied = plan_and_apply(site.fleet, POLICY)
    assert applied.results is not None
    assert [action.outcome for action in applied.results.actions if action.task == "t4"] == [Outcome.FAILED]
    assert 1 <= len(asked) <= 4
