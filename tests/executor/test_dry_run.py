# SPDX-License-Identifier: Apache-2.0
"""A dry run prints the very requests that apply sends, in their order."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.executor.dependencies import order_by_dependencies
from edgectl.executor.dry_run import list_dry_run_requests
from edgectl.executor.run import RunIdentity, RunOptions, run_plan
from edgectl.model.check import Check, CheckLocation
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan
from edgectl.model.task import HandoffContract, HandoffOrder, Need, NeedCondition, Task
from edgectl.state.journal import Journal
from edgectl.transport.fake import FakeTransport
from tests.builders import a_robot, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet
from tests.executor.test_run import EDGES, a_plan, a_step

Sent = list[tuple[str, dict[str, object]]]
HOOKS = {name: Check(command=name, on=CheckLocation.ROBOT) for name in ("safe_when", "hold", "release")}
READY_ON_ROBOT = Check(command="sees the map", on=CheckLocation.ROBOT, timeout=5.0)


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with Journal.open(tmp_path) as opened:
        yield opened


def a_fleet() -> Inventory:
    return an_inventory(*(an_edge(name) for name in EDGES), a_robot("robot1"))


def mask_request(host: str, request: dict[str, object]) -> tuple[str, dict[str, object]]:
    """Replace values by a dry run's placeholders; the rest of a time-out becomes a whole number."""
    placeholders: dict[str, object] = {"generation": 0} if request.get("generation") is not None else {}
    if request["op"] in ("start", "wait", "mark") and request["instance"] != "old":
        placeholders["instance"] = "0"
    if "manager" in request:
        placeholders["manager"] = ""
    if "timeout_s" in request:
        placeholders["timeout_s"] = round(float(str(request["timeout_s"])))
    return host, {**request, **placeholders}


def list_planned(made: Plan, *tasks: Task, inventory: Inventory | None = None) -> Sent:
    entries = list_dry_run_requests(made, inventory or a_fleet(), some_tasks(*tasks))
    return [mask_request(str(entry["host"]), dict(entry["stdin"])) for entry in entries]  # type: ignore[call-overload]


def list_sent(fleet: FakeFleet, journal: Journal, made: Plan, *tasks: Task) -> Sent:
    transport: FakeTransport = fleet.transport
    options, identity = RunOptions(max_parallel=1, poll_s=0.01), RunIdentity(plan_id="p", revision=1)
    results = run_plan(made, a_fleet(), some_tasks(*tasks), transport, journal, identity, options)
    assert results.done, results
    return [mask_request(host, request) for host, request in transport.requests]


def a_moving_task(order: HandoffOrder, **fields: object) -> Task:
    contract = HandoffContract(order=order, timeout=3.0, **HOOKS)
    return a_task("slam", robots=["robot1"], handoff=contract, **fields)  # type: ignore[arg-type]


CASES: dict[str, tuple[Plan, tuple[Task, ...]]] = {
    "start": (a_plan(a_step("slam", Action.START, host="edge1")), (a_task("slam"),)),
    "start, ready on the host": (
        a_plan(a_step("slam", Action.START, host="edge1")),
        (a_task("slam", ready=Check(command="is up", timeout=40.0)),),
    ),
    "start, ready on the robot": (
        a_plan(a_step("slam", Action.START, host="edge1")),
        (a_task("slam", robots=["robot1"], ready=READY_ON_ROBOT),),
    ),
    "stop": (a_plan(a_step("slam", Action.STOP, previous="edge1")), (a_task("slam"),)),
    "stop of a task that left the files": (a_plan(a_step("slam", Action.STOP, previous="edge1")), ()),
    "complete": (a_plan(a_step("slam", Action.COMPLETE, previous="edge1")), (a_task("slam"),)),
    "stop-first move": (
        a_plan(a_step("slam", Action.MOVE, host="edge2", previous="edge1")),
        (a_moving_task(HandoffOrder.STOP_FIRST),),
    ),
    "start-first move": (
        a_plan(a_step("slam", Action.MOVE, host="edge2", previous="edge1")),
        (a_moving_task(HandoffOrder.START_FIRST, ready=READY_ON_ROBOT),),
    ),
    "restart": (
        a_plan(a_step("slam", Action.RESTART, host="edge1", previous="edge1")),
        (a_moving_task(HandoffOrder.START_FIRST),),
    ),
    "replacement": (
        a_plan(a_step("slam", Action.START, host="edge2", previous="edge3")),
        (a_moving_task(HandoffOrder.STOP_FIRST),),
    ),
    "duplicate of a kept task": (
        a_plan(a_step("slam", Action.KEEP, host="edge2", stop=("edge1",))),
        (a_task("slam"),),
    ),
    "room before the newcomer, stops before starts": (
        a_plan(
            a_step("camera", Action.START, host="edge1"),
            a_step("slam", Action.MOVE, host="edge2", previous="edge1"),
            a_step("other", Action.STOP, previous="edge3"),
        ),
        (a_task("camera"), a_moving_task(HandoffOrder.STOP_FIRST), a_task("other")),
    ),
    "needs a task that is starting": (
        a_plan(
            a_step("slam", Action.KEEP, host="edge1"),
            a_step("navigation", Action.START, host="edge2"),
            snapshot=a_snapshot(
                edge1=a_sample(tasks={"slam": a_run(instance="old", state="starting")})  # type: ignore[arg-type]
            ),
        ),
        (a_task("slam", ready=Check(command="is up")), a_task("navigation", needs=["slam"])),
    ),
    "needs a job that has completed": (
        a_plan(a_step("slam", Action.KEEP, host="edge1"), a_step("after", Action.START, host="edge2")),
        (a_task("slam"), a_task("after", needs=[Need(task="slam", until=NeedCondition.COMPLETED)])),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_apply_sends_what_a_dry_run_prints(name: str, journal: Journal) -> None:
    made, tasks = CASES[name]
    fleet = FakeFleet.of([*EDGES, "robot1"])
    fleet.down.add("edge3") if name == "replacement" else None
    if any(action.instances or action.stop or action.action is Action.KEEP for action in made.steps):
        state = "starting" if "starting" in name else "completed" if "completed" in name else "running"
        fleet["edge1"].runs("slam", state=state)
    assert list_sent(fleet, journal, made, *tasks) == list_planned(made, *tasks)


def test_an_action_that_apply_would_defer_has_no_requests() -> None:
    made = a_plan(a_step("slam", Action.UNPLACED), a_step("navigation", Action.START, host="edge2"))
    assert list_planned(made, a_task("slam"), a_task("navigation", needs=["slam"])) == []


def test_order_follows_dependencies_and_else_the_plan() -> None:
    after = {"c": frozenset({"a"}), "b": frozenset[str](), "a": frozenset({"b"}), "d": frozenset[str]()}
    assert order_by_dependencies(after) == ["b", "a", "c", "d"]
    with pytest.raises(ValueError, match="circular"):
        order_by_dependencies({"a": frozenset({"b"}), "b": frozenset({"a"})})
