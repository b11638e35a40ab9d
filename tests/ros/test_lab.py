# SPDX-License-Identifier: Apache-2.0
"""Hosts that lose power, and moves of a pipeline, as nodes on other hosts of a real ROS 1 notice them."""

import json
from pathlib import Path

import pytest

from tests.faults.fleet import FaultFleet
from tests.faults.namespace_host import find_missing_for_namespaces
from tests.ros.lab import (
    CORE,
    NODE,
    ROBOT,
    SECOND,
    WITH_CORE,
    add_core,
    add_task,
    apply,
    list_nodes,
    open_lab,
    read_times,
    wait_for,
)
from tests.ros.moves import measure_moves

pytestmark = pytest.mark.skipif(
    bool(find_missing_for_namespaces()), reason=f"no namespaces: {find_missing_for_namespaces()}"
)
PIPELINE = NODE.format(file="pipeline.py")


def test_all_are_heard_again_after_the_host_of_the_master_was_rebooted(tmp_path: Path) -> None:
    """Within three cycles; and the job that loads parameters runs again before who reads them starts."""
    with open_lab(tmp_path) as fleet:
        add_core(fleet)
        add_task(fleet, "parameters", "rosparam set /lab/speed 7", SECOND, kind="job", needs=[WITH_CORE])
        loaded = {"task": "parameters", "until": "completed"}
        talk = f'test "$(rosparam get /lab/speed)" = 7 && {PIPELINE} 1 talker source /said 20 10'
        rule = {"ready": {"ros_node": "/talker", "timeout": "60s"}, "restart": "never"}
        add_task(fleet, "talker", talk, SECOND, needs=[WITH_CORE, loaded], **rule)
        add_task(fleet, "listener", f"{PIPELINE} 1 listener sink /said $HOME/heard", ROBOT, needs=[WITH_CORE])
        wait_for(lambda: apply(fleet) and read_times(fleet, "heard"), 120.0)
        core = fleet.get_computer(CORE)
        core.power_off()
        core.boot()
        for _ in range(3):
            before = len(read_times(fleet, "heard"))
            apply(fleet)
            if {"/talker", "/listener"} <= list_nodes(fleet):
                break
        wait_for(lambda: len(read_times(fleet, "heard")) > before + 20, 30.0)
        assert list_nodes(fleet) == {"/listener", "/rosout", "/talker"}


def test_names_of_a_lost_host_are_removed_once_it_is_certain_that_it_is_gone(tmp_path: Path) -> None:
    """Not while it is only silent; then by the host of the master, which is said."""
    with open_lab(tmp_path) as fleet:
        add_core(fleet)
        talk = f"{PIPELINE} 1 talker source /said 20 10"
        ready = {"ros_node": "/talker", "timeout": "60s"}
        add_task(fleet, "talker", talk, SECOND, needs=["roscore"], ready=ready)
        apply(fleet)
        # The names of what it started are in the next probe.
        wait_for(lambda: apply(fleet) and knows_node(fleet, "/talker"), 30.0)
        fleet.get_computer(SECOND).power_off()
        apply(fleet)
        assert "/talker" in list_nodes(fleet)
        assert fleet.run_edgectl("fence", SECOND, "--yes").code == 0
        apply(fleet)
        assert list_nodes(fleet) == {"/rosout"}
        events = json.loads(fleet.run_edgectl("events", "-o", "json").out)["items"]
        [said] = [each for each in events if each["kind"] == "nodes-removed"]
        assert (said["host"], said["task"], said["message"]) == (SECOND, "talker", "unregistered /talker")
        # A host that comes back after a reboot knows itself what it had.
        fleet.get_computer(SECOND).boot()
        apply(fleet)
        wait_for(lambda: "/talker" in list_nodes(fleet), 30.0)


@pytest.mark.parametrize("version", [1, 2])
def test_moves_of_a_pipeline_are_as_silent_as_they_are_said_to_be(version: int, tmp_path: Path) -> None:
    with open_lab(tmp_path, version) as fleet:
        for move in measure_moves(fleet, version, count=1):
            print(move)
            assert move.gap_s is not None
            # The sink hears from when the nodes know each other, which is after the node is ready.
            assert move.silence_s < move.gap_s + 3.0
            assert move.silence_s < 1.0 or move.order == "stop-first"


def knows_node(fleet: FaultFleet, node: str) -> bool:
    """Whether the state of the manager has the node."""
    return any(f'"{node}"' in path.read_text() for path in fleet.state.rglob("*.json"))
