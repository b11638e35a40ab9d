# SPDX-License-Identifier: Apache-2.0
"""The patrol as nodes of ROS 2 on computers in namespaces: its tasks as they are shipped, and a move of its detection."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.docs.blocks import blocks
from tests.experiments.lab.patrol import PATROL, ROOT, world
from tests.faults.fleet import APPLY, FaultFleet, format_yaml
from tests.faults.namespace_host import find_missing_for_namespaces
from tests.pace import patience
from tests.ros.lab import open_lab, wait_for

pytestmark = pytest.mark.skipif(
    bool(find_missing_for_namespaces()), reason=f"no namespaces: {find_missing_for_namespaces()}"
)
PAGE = ROOT / "docs" / "ros.md"
TASKS = PATROL / "ros2.yaml"
FOLLOWER = "ros2_follower.py"
ROBOT, EDGES = "robot1", ("edge2", "edge1")


def install_patrol(fleet: FaultFleet) -> None:
    """Copy the programs to all computers, and write the inventory: two edges and a robot, which has no room for much."""
    for name in fleet.hosts:
        shutil.copytree(PATROL, fleet.get_computer(name).home / "tasks" / "patrol")
    hosts: dict[str, dict[str, Any]] = {name: dict(fleet.inventory[name]) for name in fleet.hosts}
    for host in hosts.values():
        host["ros"] = {**host["ros"], "domain": 46}
    hosts[ROBOT] |= {"onboard": True, "capacity": {"cpu": 0.25, "memory": "1Gi"}}
    inventory = {
        **fleet.inventory_head,
        "edges": {name: hosts[name] for name in EDGES},
        "robots": {ROBOT: hosts[ROBOT]},
    }
    (fleet.directory / "inventory.yaml").write_text(format_yaml(inventory))


def write_tasks(fleet: FaultFleet, words: str = "") -> None:
    """Write the tasks as they are shipped, the follower with these words."""
    (fleet.directory / "tasks.yaml").write_text(TASKS.read_text().replace(FOLLOWER, f"{FOLLOWER} {words}"))


def read_log(fleet: FaultFleet, task: str) -> str:
    """The log of a task of the robot, from its disk."""
    [log] = fleet.get_computer(ROBOT).home.rglob(f"{task}/log.0")
    return log.read_text()


def count_stops(fleet: FaultFleet) -> int:
    stops = re.findall(r"stops=(\d+)", read_log(fleet, "follower-robot1"))
    return int(stops[-1]) if stops else 0


def read_commands() -> list[list[str]]:
    """The commands of docs/ros.md: apply, move, apply; without their files, which the fleet adds."""
    [block] = [each for each in blocks(PAGE) if "ros2.yaml" in each.commands[0][0]]
    files = " -i inventories/lab.yaml -t tasks/patrol/ros2.yaml"
    assert all(command.endswith(files) for command, _ in block.commands)
    return [command.removesuffix(files).split()[1:] for command, _ in block.commands]


def move_detection(fleet: FaultFleet, move: list[str], apply: list[str]) -> None:
    """Move it to the other edge; robot and edgectl say how long the robot has heard nothing."""
    status = json.loads(fleet.run_edgectl("status", "-o", "json").expect_exit(0, 4).out)
    old = next(item["host"] for item in status["items"] if item["task"] == "detection-robot1")
    new = EDGES[1 - EDGES.index(old)]
    assert "gap_ms" not in read_log(fleet, "robot-robot1"), "all results were of one instance"
    assert move[:2] == ["move", "detection-robot1"]
    fleet.run_edgectl(*move[:2], new).expect_exit(0)
    document = json.loads(fleet.run_edgectl(*apply, "--yes", "-o", "json").expect_exit(0).out)
    [moved] = [each for each in document["item"]["actions"] if each["task"] == "detection-robot1"]
    assert (moved["action"], moved["outcome"], moved["host"]) == ("move", "done", new)
    wait_for(lambda: "gap_ms" in read_log(fleet, "robot-robot1"), 30.0)
    [gap] = re.findall(r"^gap_ms=([\d.]+)$", read_log(fleet, "robot-robot1"), re.MULTILINE)
    # Each subscriber discovers the new node by itself, so the two may differ by a second or two.
    print(f"gap of edgectl {moved['gap_s']} s, silence before the first new result {gap} ms")
    assert "heard" in {each["phase"] for each in moved["phases"]}
    assert float(gap) < 1e3 * patience(3.0), "both instances live until the new one is heard"


def test_a_robot_goes_on_while_its_detection_moves(tmp_path: Path) -> None:
    with open_lab(tmp_path, 2, (ROBOT, *EDGES)) as fleet:
        install_patrol(fleet)
        write_tasks(fleet)
        begin, move, again = read_commands()
        fleet.run_edgectl(*begin, "--yes").expect_exit(0)
        wait_for(lambda: count_stops(fleet) >= 1, 60.0)
        move_detection(fleet, move, again)
        before = count_stops(fleet)
        wait_for(lambda: count_stops(fleet) > before, 60.0)
        # A follower that begins anew knows from the robot that it has done more than is asked for now.
        write_tasks(fleet, f"--tour {before}")
        fleet.run_edgectl(*APPLY).expect_exit(0)
        maps = [fleet.get_computer(name).home / "edgectl-patrol" / "map.pgm" for name in fleet.hosts]
        wait_for(
            lambda: fleet.run_edgectl(*APPLY).expect_exit(0) and any(each.exists() for each in maps), 60.0
        )
        [merged] = [each.read_bytes() for each in maps if each.exists()]
        assert 0.1 < merged.count(world.FREE) / (world.WIDTH * world.HEIGHT) < 1.0, (
            "it has seen some of the world"
        )
        fleet.run_edgectl("stop", "--all", "--yes").expect_exit(0)
        # The helpers of edgectl, which know the graph, end half a minute later (test_ros2.py).
        left = [each for name in fleet.hosts for each in fleet.get_computer(name).processes()]
        assert [each.command for each in left if "patrol" in each.command] == []
