# SPDX-License-Identifier: Apache-2.0
"""Levels of the fleet in ROS."""

from dataclasses import replace

from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import Snapshot, TaskState
from edgectl.views.ros_diagnostics import ERROR, OK, STALE, WARN, encode_diagnostics
from tests.builders import a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, silent, some_tasks

NAMES = ("ready", "sick", "broken", "twice", "unseen", "absent", "done")
TASKS = some_tasks(*(a_task(name) for name in NAMES))


def a_fleet() -> Snapshot:
    runs = {
        "ready": a_run(),
        "sick": a_run(TaskState.UNHEALTHY, detail="node /slam is not registered"),
        "broken": a_run(TaskState.FAILED),
        "twice": a_run(),
        "done": a_run(TaskState.COMPLETED),
        "stranger": a_run(),
    }
    hosts = {
        "edge1": a_sample(tasks=runs),
        "edge2": a_sample(tasks={"twice": a_run()}),
        "edge3": silent(),
        "edge4": a_sample(),
    }
    placed = Placement(host="edge3", since=1.0, generation=1)
    memory = ManagerState(placements={"unseen": placed}, cordons=frozenset({"edge4"}))
    return replace(a_snapshot(hosts), manager=memory)


def test_each_level_has_its_cause() -> None:
    inventory = an_inventory(*(an_edge(f"edge{n}") for n in (1, 2, 3, 4)))
    found = encode_diagnostics(a_fleet(), inventory, TASKS)
    levels = {
        str(each["name"]).removeprefix(f"edgectl {inventory.fleet}: "): (each["level"], each["message"])
        for each in found
    }
    assert levels["fleet"] == (ERROR, "5 ok, 3 warnings, 3 errors, 1 unknown")
    assert levels["host edge1"] == (OK, "ok")
    assert levels["host edge3"][0] == ERROR
    assert levels["host edge4"] == (WARN, "cordoned")
    assert levels["task ready"] == (OK, "ready on edge1")
    assert levels["task sick"] == (WARN, "unhealthy (node /slam is not registered) on edge1")
    assert levels["task broken"] == (ERROR, "failed on edge1")
    assert levels["task twice"] == (ERROR, "runs twice: on edge1 and edge2")
    assert levels["task unseen"][0] == STALE
    assert levels["task absent"] == (WARN, "not running")
    assert levels["task done"][0] == OK
    assert levels["task stranger"][0] == OK
    assert all(isinstance(text, str) for each in found for text in each["values"].values())  # type: ignore[attr-defined]
