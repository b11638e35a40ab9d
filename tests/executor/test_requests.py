# SPDX-License-Identifier: Apache-2.0
"""Requests to hosts: content, environment, dry run, order."""

from typing import Any

import pytest

from edgectl.executor import action_phases, host_requests
from edgectl.executor.action_phases import DEFAULT_UP_S
from edgectl.executor.dependencies import build_step_dependencies, list_stop_hosts
from edgectl.executor.dry_run import list_dry_run_requests
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.check import Check, CheckLocation
from edgectl.model.image import ContainerImage
from edgectl.model.inventory import Runtime
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy
from edgectl.model.task import HandoffContract, HandoffOrder, StopRule
from edgectl.rules.environment import merge_environment
from tests.builders import a_robot, a_snapshot, a_task, an_edge, an_inventory, some_tasks

EDGE = an_edge(
    "edge1",
    env={"ROS_MASTER_URI": "http://a", "LEVEL": "host"},
    prelude="source setup.bash",
    runtime=Runtime.PROCESS,
)
FLEET = an_inventory(EDGE, an_edge("edge2"), a_robot("robot1"), a_robot("robot2"))


def test_the_tasks_variables_win_over_the_hosts() -> None:
    task = a_task("slam", robots=["robot2", "robot1"], env={"LEVEL": "task"})
    assert merge_environment(task, EDGE, FLEET.hosts) == {
        "ROS_MASTER_URI": "http://a",
        "LEVEL": "task",
        "EDGECTL_TASK": "slam",
        "EDGECTL_HOST": "edge1",
        "EDGECTL_ROBOT": "robot2",
        "EDGECTL_ROBOT_HOST": "robot2.lab",
        "EDGECTL_ROBOTS": "robot2 robot1",
        "EDGECTL_ROBOT_HOSTS": "robot2.lab robot1.lab",
    }
    assert "EDGECTL_ROBOT" not in merge_environment(a_task("merge"), EDGE, FLEET.hosts)


def test_a_start_request_is_the_task_as_it_will_run() -> None:
    task = a_task(
        "slam", ready=Check(command="is up", timeout=7.0), stop=StopRule(preset="ros"), workdir="/data"
    )
    request = host_requests.fill_start_request(
        host_requests.build_start_request(task, EDGE, FLEET.hosts),
        instance="i",
        generation=4,
        manager="ana@lab",
        variables={},
    )
    assert {key: request[key] for key in ("op", "host", "task", "instance", "generation", "manager")} == {
        "op": "start", "host": "edge1", "task": "slam", "instance": "i", "generation": 4,
        "manager": "ana@lab",
    }  # fmt: skip
    spec = request["spec"]
    assert isinstance(spec, dict)
    assert (spec["command"], spec["prelude"], spec["workdir"], spec["runtime"]) == (
        "run slam",
        "source setup.bash",
        "/data",
        "process",
    )
    assert (spec["ready"], spec["stop"]) == (
        {"command": "is up", "graph": None, "timeout_s": 7.0},
        {"signal": "TERM", "grace_s": 20.0, "preset": "ros"},
    )


def test_the_workdir_of_an_image_is_in_the_container() -> None:
    image = ContainerImage(name="lab/slam:1", env={"LEVEL": "image"}, devices=("/dev/video0",))
    task = a_task("slam", workdir="/data", image=image, env={"LEVEL": "task", "MORE": "x"})
    spec = host_requests.build_start_request(task, EDGE, FLEET.hosts)["spec"]
    assert isinstance(spec, dict)
    assert (spec["workdir"], spec["env"]["LEVEL"], spec["env"]["MORE"]) == (None, "image", "x")
    assert spec["image"] == {
        "name": "lab/slam:1", "engine": None, "gpus": None, "devices": ["/dev/video0"], "volumes": [],
        "user": None, "network": "host", "ipc": "host", "pull": "missing", "args": [], "workdir": "/data",
        "managers": [],
    }  # fmt: skip


def test_a_ready_check_on_the_robot_stays_with_the_manager() -> None:
    task = a_task("slam", ready=Check(command="sees the map", on=CheckLocation.ROBOT))
    spec = host_requests.build_start_request(task, EDGE, FLEET.hosts)["spec"]
    assert isinstance(spec, dict)
    assert spec["ready"] is None


def test_an_instance_is_named_by_run_task_host_and_attempt() -> None:
    name = host_requests.build_instance_id("plan:1", "slam", "edge1", 1)
    assert name == host_requests.build_instance_id("plan:1", "slam", "edge1", 1)
    others = [
        ("plan:2", "slam", "edge1", 1),
        ("plan:1", "slan", "edge1", 1),
        ("plan:1", "slam", "edge2", 1),
        ("plan:1", "slam", "edge1", 2),
    ]
    assert len({name, *(host_requests.build_instance_id(*other) for other in others)}) == 5


@pytest.mark.parametrize(
    ("stated", "up_s"),
    [({}, DEFAULT_UP_S), ({"up": 7.0}, 7.0), ({"up": 7.0, "ready": Check(command="true", timeout=9.0)}, 0.0)],
)
def test_a_start_waits_for_its_check_or_until_the_command_is_up(
    stated: dict[str, Any], up_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(action_phases, "DEFAULT_UP_S", DEFAULT_UP_S)
    _, ready = action_phases.build_run_phases(a_task("slam", **stated), "edge1", FLEET)
    assert ready.requests[0].body["up_s"] == up_s
    assert ready.timeout_s == (9.0 if "ready" in stated else up_s + 10.0)
    assert DEFAULT_UP_S == 3.0


def a_plan(*steps: Step) -> Plan:
    return Plan(
        created_at=0.0,
        policy=Policy(),
        inventory_digest="",
        tasks_digest="",
        snapshot=a_snapshot(),
        settled=True,
        steps=steps,
        expected={},
    )


def a_step(
    task: str, action: Action, host: str | None, previous: str | None = None, stop: tuple[str, ...] = ()
) -> Step:
    decision = Decision(
        task=task, verdict=Verdict.PLACED, reason=Reason.BEST, host=host, previous_host=previous
    )
    return Step(decision=decision, action=action, instances={previous: "old"} if previous else {}, stop=stop)


def list_dry_run(order_of_move: HandoffOrder) -> list[tuple[object, object]]:
    hooks: dict[str, Any] = {
        name: Check(command=name, on=CheckLocation.ROBOT) for name in ("safe_when", "hold", "release")
    }
    task = a_task("slam", robots=["robot1"], handoff=HandoffContract(order=order_of_move, **hooks))
    entries = list_dry_run_requests(
        a_plan(a_step("slam", Action.MOVE, "edge2", "edge1")), FLEET, some_tasks(task)
    )
    return [(entry["phase"], entry["host"]) for entry in entries]


def test_a_dry_run_of_a_move_shows_its_phases_in_order() -> None:
    around = [("safe", "robot1"), ("hold", "robot1")], [("release", "robot1")]
    reach, stop, start = [("reach", "edge2")], [("stop", "edge1")], [("start", "edge2"), ("ready", "edge2")]
    assert list_dry_run(HandoffOrder.STOP_FIRST) == [*reach, *around[0], *stop, *start, *around[1]]
    assert list_dry_run(HandoffOrder.START_FIRST) == [*reach, *around[0], *start, *stop, *around[1]]


def test_a_dry_run_shows_stops_first_and_duplicates_once() -> None:
    plan = a_plan(
        a_step("slam", Action.START, "edge1", stop=("edge2",)), a_step("old", Action.STOP, None, "edge1")
    )
    entries = list_dry_run_requests(plan, FLEET, some_tasks(a_task("slam")))
    assert [(entry["task"], entry["phase"], entry["host"]) for entry in entries] == [
        ("slam", "stop", "edge2"),
        ("old", "stop", "edge1"),
        ("slam", "reach", "edge1"),
        ("slam", "start", "edge1"),
        ("slam", "ready", "edge1"),
    ]


def test_starts_wait_for_needs_and_for_room_but_never_in_a_circle() -> None:
    """b needs a and starts where a leaves; c starts where b leaves; a starts where c leaves: the last
    dependency would close the cycle.
    """
    steps = (
        a_step("a", Action.MOVE, "edge2", "edge1"),
        a_step("b", Action.MOVE, "edge1", "edge3"),
        a_step("c", Action.MOVE, "edge3", "edge2"),
    )
    waits = build_step_dependencies(
        steps, some_tasks(a_task("a"), a_task("b", needs=["a", "other"]), a_task("c"))
    )
    assert list(waits) == ["a", "b", "c"]
    assert [need.task for need in waits["b"].needs] == ["a"]
    assert [need.task for need in waits["b"].others] == ["other"]
    assert waits["a"].leaving == ("c",)
    assert waits["c"].leaving == ()
    assert waits["b"].tasks == {"a"}


def test_what_a_step_stops_first() -> None:
    assert list_stop_hosts(a_step("a", Action.MOVE, "edge2", "edge1", stop=("edge3",))) == ("edge3",)
    assert list_stop_hosts(a_step("a", Action.STOP, None, "edge1", stop=("edge2",))) == ("edge1", "edge2")
    assert list_stop_hosts(a_step("a", Action.KEEP, "edge1")) == ()
