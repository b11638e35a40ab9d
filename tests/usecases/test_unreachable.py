# SPDX-License-Identifier: Apache-2.0
"""Unreachable hosts: their remembered state, the state of their tasks, and the operator's commands."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.errors import UsageError
from edgectl.model.plan import Action
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import StopRule, UnreachablePolicy
from edgectl.state.heartbeats import load_heartbeats
from edgectl.state.uptime import Uptime
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.logs import read_log
from edgectl.usecases.plan import make_plan
from edgectl.usecases.probe import probe_fleet
from edgectl.views.state import resolve_absent_task
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet

POLICY = Policy(min_dwell=0.0)
REPLACED = a_task(
    "slam",
    on_unreachable=UnreachablePolicy.REPLACE,
    replace_after=30.0,
    self_fence=60.0,
    stop=StopRule(grace=20.0),
    restart=a_task("x").restart,
)
HELD = a_task("camera", pin="edge1")


class Bench:
    """Three edges and a robot; ``wait`` advances every clock."""

    def __init__(self, state: Path) -> None:
        self.hosts = FakeFleet.of(["edge1", "edge2", "edge3", "robot1"])
        self.now = NOW
        self.said: list[str] = []
        inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"), a_robot("robot1"))
        self.fleet = Fleet(
            inventory=inventory, tasks=some_tasks(REPLACED, HELD), transport=self.hosts.transport, state=state, clock=lambda: self.now,
            uptime=lambda: Uptime(boot="b", seconds=self.now - NOW + 1000.0), warn=self.said.append,
        )  # fmt: skip

    def wait(self, seconds: float) -> None:
        self.now += seconds

    def actions(self) -> dict[str, Action]:
        return {step.task: step.action for step in make_plan(self.fleet, POLICY).steps}

    def lose(self, task: str) -> str:
        """Switch the host of a task off; return its name."""
        host = self.hosts.placed[task]
        self.hosts.down.add(host)
        return host


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    made = Bench(tmp_path)
    plan_and_apply(made.fleet, POLICY)
    return made


def test_every_command_that_asks_a_host_notes_the_contact(bench: Bench) -> None:
    bench.wait(50.0)
    silent = bench.lose("slam")
    snapshot = probe_fleet(bench.fleet)
    assert snapshot.manager is not None
    assert snapshot.manager.contact == {
        name: bench.now - 50.0 * (name == silent) for name in bench.hosts.hosts
    }
    bench.hosts.down.clear()
    bench.wait(10.0)
    read_log(bench.fleet, "slam")
    assert load_heartbeats(bench.fleet.state).last[silent].seconds == 1060.0


def test_a_request_whose_answer_is_lost_counts_as_contact(bench: Bench) -> None:
    """The request may have reached the host and postponed the task's self-fence."""
    bench.wait(50.0)
    silent = bench.hosts.placed["slam"]

    def lost(_request: dict[str, object]) -> dict[str, object]:
        raise TimeoutError

    bench.hosts[silent].faults["probe"] = lost
    with pytest.raises(TimeoutError):
        probe_fleet(bench.fleet)
    assert load_heartbeats(bench.fleet.state).last[silent].seconds == 1050.0


def test_a_contact_is_on_disk_before_its_request_leaves(bench: Bench) -> None:
    bench.wait(50.0)
    seen = []

    def look(_request: dict[str, object]) -> dict[str, object]:
        seen.append(load_heartbeats(bench.fleet.state).last["edge1"].seconds)
        return {}

    bench.hosts["edge1"].faults["probe"] = look
    probe_fleet(bench.fleet)
    assert seen[0] == 1050.0


def test_a_task_of_a_silent_host_is_unknown_since_the_last_contact(bench: Bench) -> None:
    silent = bench.lose("slam")
    bench.wait(20.0)
    snapshot = probe_fleet(bench.fleet)
    known = resolve_absent_task(REPLACED, snapshot)
    assert (known.state, known.host, known.contact) == ("unknown", silent, bench.now - 20.0)


def test_replaced_only_after_its_own_end_is_certain(bench: Bench) -> None:
    silent = bench.lose("slam")
    bench.wait(89.0)
    assert bench.actions()["slam"] is Action.HOLD
    bench.wait(1.5)
    applied = plan_and_apply(bench.fleet, POLICY)
    assert {step.task: step.action for step in applied.plan.steps}["slam"] is Action.START
    assert applied.results is not None
    assert applied.results.done
    there = [host.name for host in bench.hosts.hosts.values() if "slam" in host.tasks and host.name != silent]
    assert len(there) == 1
    assert bench.actions()["slam"] is Action.KEEP


def test_a_replaced_task_is_at_home_on_its_new_host(bench: Bench) -> None:
    """Also for policy static: a later start goes to the new host, not to the first one."""
    bench.lose("slam")
    bench.wait(100.0)
    static = Policy(name=PolicyName.STATIC)
    plan_and_apply(bench.fleet, static)
    (new,) = (
        name
        for name, host in bench.hosts.hosts.items()
        if "slam" in host.tasks and name not in bench.hosts.down
    )
    bench.hosts.down.clear()
    plan_and_apply(bench.fleet, static)
    bench.hosts[new].tasks.pop("slam")
    (again,) = (step for step in make_plan(bench.fleet, static).steps if step.task == "slam")
    assert (again.action, again.decision.host) == (Action.START, new)


def test_the_host_comes_back_with_its_old_copy_and_the_newer_assignment_wins(bench: Bench) -> None:
    silent = bench.lose("slam")
    bench.wait(100.0)
    plan_and_apply(bench.fleet, POLICY)
    bench.hosts.down.clear()
    made = make_plan(bench.fleet, POLICY)
    (step,) = (step for step in made.steps if step.task == "slam")
    assert (step.action, step.stop) == (Action.KEEP, (silent,))
    assert made.changes
    applied = plan_and_apply(bench.fleet, POLICY)
    assert applied.results is not None
    assert applied.results.done
    assert "slam" not in bench.hosts[silent].tasks
    assert not make_plan(bench.fleet, POLICY).changes


def test_without_self_fence_it_is_held_until_the_operator_says_that_the_host_is_off(bench: Bench) -> None:
    held = dataclasses.replace(HELD, hosts=a_task("x").hosts)
    bench.fleet = dataclasses.replace(bench.fleet, tasks=some_tasks(REPLACED, held))
    silent = bench.lose("camera")
    bench.wait(100_000.0)
    assert bench.actions()["camera"] is Action.HOLD
    assert operator_marks.fence_hosts(bench.fleet, [silent]) == {silent}
    assert bench.actions()["camera"] is Action.START
    bench.hosts.down.clear()
    bench.actions()
    assert bench.said[-1] == f"{silent} answers, so it is not powered off: its fence is cleared"
    bench.hosts.down.add(silent)
    assert bench.actions()["camera"] is Action.HOLD
    operator_marks.fence_hosts(bench.fleet, [silent])
    assert operator_marks.unfence_hosts(bench.fleet, [silent]) == frozenset()
    with pytest.raises(UsageError, match="unknown host 'edge9'"):
        operator_marks.fence_hosts(bench.fleet, ["edge9"])


def test_contacts_that_are_lost_replace_nothing(bench: Bench) -> None:
    bench.lose("slam")
    bench.wait(1000.0)
    (bench.fleet.state / "contacts.json").write_text("{")
    assert bench.actions()["slam"] is Action.HOLD


def test_a_long_apply_keeps_the_hosts_from_taking_the_manager_for_lost(bench: Bench) -> None:
    """camera is slow on edge1; meanwhile other hosts get heartbeats, but only where a task fences itself."""
    for fence, asked in ((0.4, True), (None, False)):
        restless = dataclasses.replace(HELD, spec_hash=f"changed {fence}")
        bench.fleet = dataclasses.replace(
            bench.fleet,
            tasks=some_tasks(dataclasses.replace(REPLACED, self_fence=fence), restless),
            transport=bench.hosts.transport,
        )
        bench.hosts["edge1"].faults["wait"] = a_slow_task(bench, patience=30.0 if asked else 0.5)
        plan_and_apply(bench.fleet, POLICY)
        assert is_renewed(bench, "edge2") is asked


def is_renewed(bench: Bench, host: str) -> bool:
    """Whether ``host`` heard from the manager between probe and release."""
    requests = bench.fleet.transport.requests  # type: ignore[attr-defined]
    return any(name == host and request.get("action") == "renew" for name, request in requests)


def a_slow_task(bench: Bench, *, patience: float) -> Callable[[dict[str, object]], dict[str, object]]:
    """A task that runs only after edge2 received a heartbeat, or after ``patience`` seconds."""

    def answer(_request: dict[str, object]) -> dict[str, object]:
        end = time.monotonic() + patience
        while not is_renewed(bench, "edge2") and time.monotonic() < end:
            time.sleep(0.02)
        return {"state": "running"}

    return answer
