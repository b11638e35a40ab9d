# SPDX-License-Identifier: Apache-2.0
"""``edgectl import ros --live`` on real graphs: nodes that roslaunch and shells started, beside one of edgectl's own."""

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.cli.fleet_dir import enter_fleet
from tests.cli.inprocess import Said, edgectl
from tests.docs.blocks import blocks
from tests.e2e.test_unreachable import wait_until
from tests.pace import patience
from tests.ros.test_gateway import find_free_port, kill_with_children, run_beside
from tests.ros.test_ros2 import NODE as NODE2
from tests.ros.test_ros2 import PYTHON
from tests.views.fixtures import ROOT

PAGE = ROOT / "docs" / "ros.md"
COUNTING = Path(__file__).with_name("counting.py")
INVENTORY = """
version: 1
fleet: lab
defaults:
  ros: {ros}
edges:
  edge1: {{host: 127.0.0.1, connection: local}}
robots:
  robot1: {{host: 127.0.0.1, probe: false}}
"""
IDLE = "demand: {cpu: 0, memory: 1Mi, throughput: 0}"
LAUNCH = """
<launch>
  <group ns="robot1"><node pkg="rosout" type="rosout" name="logger"/></group>
  <group ns="robot2"><node pkg="rosout" type="rosout" name="logger"/></group>
  <node pkg="rosout" type="rosout" name="archive" output="log"/>
</launch>
"""
HEAD = """\
# Read from the running ROS graph of edge1.
# edgectl measures these tasks and never starts or stops them. To have it start one, write
# command: .. in place of managed: and detect:, and end the process that runs.
version: 1
tasks:
"""
ROSOUT_RULE = "detect: {cmdline: '^/usr/lib/rosout/rosout __name:=rosout( |$)'}"
TASKS_1 = """\
  # The master of ROS 1 on edge1
  roscore:
    managed: false
    detect: {cmdline: '^/usr/bin/python3 /usr/bin/rosmaster --core -p PORT -w 3( |$)'}
  # /archive on edge1
  archive:
    managed: false
    detect: {ros_node: /archive}
    needs: [roscore]
  # /hearer on edge1
  # subscribes to /counted
  hearer:
    managed: false
    detect: {cmdline: '^/usr/bin/python3 COUNTING hear hearer FOLDER/heard( |$)'}
    needs: [own, roscore, talker]
  # /robot1/logger on edge1
  robot1-logger:
    robot: robot1
    managed: false
    detect: {ros_node: /robot1/logger}
    needs: [roscore]
  # /robot2/logger on edge1
  robot2-logger:
    managed: false
    detect: {ros_node: /robot2/logger}
    needs: [roscore]
  # /rosout on edge1
  rosout:
    managed: false
    ROSOUT_RULE
    needs: [roscore]
  # /talker on edge1
  # publishes /counted
  talker:
    managed: false
    detect: {cmdline: '^/usr/bin/python3 COUNTING talk talker( |$)'}
    needs: [roscore]
"""
TASKS_2 = """\
  # /camera on edge1
  # publishes /camera/transition_event, /ticks
  camera:
    managed: false
    detect: {cmdline: '^PYTHON NODE camera( |$)'}
  # /lidar on edge1
  # publishes /lidar/transition_event, /ticks
  lidar:
    managed: false
    detect: {cmdline: '^PYTHON NODE lidar( |$)'}
"""


def run(folder: Path, *words: str) -> Said:
    said = edgectl(words, folder, dict(os.environ))
    assert said.code == 0, said
    return said


def read_items(folder: Path, command: str) -> dict[str, dict[str, Any]]:
    document = json.loads(run(folder, command, "-o", "json").out)
    items = document["decisions"] if command == "plan" else document["items"]
    return {item["task"]: item for item in items}


@contextlib.contextmanager
def end_with_children(process: "subprocess.Popen[bytes]") -> Iterator[None]:
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(patience(20.0))
        kill_with_children(process)


def check_readings(folder: Path, processes: dict[str, int]) -> None:
    """Plan and status show the imported tasks where they run, with what they use."""
    wait_until(lambda: set(read_items(folder, "status")) >= set(processes), 20.0)
    status = read_items(folder, "status")
    for task, pid in processes.items():
        entry = status[task]
        assert (entry["host"], entry["state"], entry["managed"]) == ("edge1", "running", False), entry
        assert entry["pid"] == pid or pid == 0, entry
        assert entry["memory"]["used_bytes"] > 1e6
    steps = read_items(folder, "plan")
    assert {(steps[task]["action"], steps[task]["reason"]) for task in processes} == {("keep", "unmanaged")}


def list_tasks(folder: Path) -> str:
    return (folder / "tasks" / "live-edge1.yaml").read_text()


def test_nodes_of_a_running_ros_1_become_tasks_that_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    master = f"http://127.0.0.1:{find_free_port()}"
    for name, value in {
        "ROS_LOG_DIR": str(tmp_path / "log"),
        "ROS_MASTER_URI": master,
        "ROS_IP": "127.0.0.1",
    }.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "lab.launch").write_text(LAUNCH)
    python, counting = "/usr/bin/python3", str(COUNTING)
    own = f"version: 1\ntasks:\n  own: {{command: 'exec {python} {counting} talk own', {IDLE}, ready: {{ros_node: /own}}}}\n"
    with (
        enter_fleet(
            tmp_path, INVENTORY.format(ros=f'{{version: 1, master: "{master}"}}'), own, monkeypatch
        ) as folder,
        run_beside("roslaunch", "-p", master.rpartition(":")[2], str(tmp_path / "lab.launch")) as launched,
        end_with_children(launched),
        run_beside(python, counting, "talk", "talker") as talker,
        run_beside(python, counting, "hear", "hearer", str(tmp_path / "heard")) as hearer,
        run_beside(python, counting, "talk", "zombie") as zombie,
    ):
        run(folder, "apply", "--yes")

        def list_nodes() -> set[str]:
            done = subprocess.run(["rosnode", "list"], capture_output=True, text=True, check=False)
            return set(done.stdout.split())

        everybody = {"/own", "/talker", "/hearer", "/zombie", "/archive", "/robot1/logger", "/robot2/logger"}
        wait_until(lambda: list_nodes() >= everybody, 60.0)
        zombie.kill()
        zombie.wait()
        [block] = [each for each in blocks(PAGE) if "--live" in each.commands[0][0]]
        said, status, plan = [run(folder, *words[1:]) for words in block.plain]
        assert said.out == block.commands[0][1] == "wrote tasks/live-edge1.yaml\n"
        assert "robot1-logger" in status.out
        assert "No changes. 8 tasks are where they should be." in plan.out
        assert "edge1: /zombie is registered and does not answer: Connection refused" in said.err
        # Found by its name alone, unless another test has a /rosout at this moment.
        found = list_tasks(folder).replace("detect: {ros_node: /rosout}", ROSOUT_RULE)
        assert found == HEAD + TASKS_1.replace("COUNTING", counting.replace(".", "\\.")).replace(
            "FOLDER", str(tmp_path).replace(".", "\\.")
        ).replace("PORT", master.rpartition(":")[2]).replace("ROSOUT_RULE", ROSOUT_RULE)
        monkeypatch.setenv("EDGECTL_TASKS", "tasks")
        check_readings(
            folder,
            {
                "talker": talker.pid,
                "hearer": hearer.pid,
                "archive": 0,
                "robot1-logger": 0,
                "robot2-logger": 0,
                "roscore": 0,
            },
        )
        again = run(folder, "import", "ros", "--live", "edge1")
        assert (again.out, "no node is new" in again.err) == ("", True)


def test_nodes_of_a_running_ros_2_become_tasks_that_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process of a node is read off the graph, also where its command line does not name it."""
    domain = str(1 + (os.getpid() + 100) % 200)
    setup = tmp_path / "setup.bash"
    setup.write_text(f"export PATH={PYTHON.parent}:$PATH\n")
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    wanted = HEAD + TASKS_2.replace("NODE", str(NODE2).replace(".", "\\.")).replace(
        "PYTHON", str(PYTHON).replace(".", "\\.")
    )
    own = f"version: 1\ntasks:\n  own: {{command: 'exec python3 {NODE2} own', {IDLE}, ready: {{ros_node: /own}}}}\n"
    with (
        enter_fleet(
            tmp_path,
            INVENTORY.format(ros=f"{{version: 2, domain: {domain}, setup: [{setup}]}}"),
            own,
            monkeypatch,
        ) as folder,
        run_beside(str(PYTHON), str(NODE2), "camera") as camera,
        run_beside(str(PYTHON), str(NODE2), "lidar") as lidar,
    ):
        run(folder, "apply", "--yes")
        # They take some seconds to be in the graph.
        wait_until(lambda: run(folder, "import", "ros", "--live", "edge1").out == wanted, 30.0)
        said = run(folder, "import", "ros", "--live", "edge1", "--out", ".")
        assert said.err == ""
        assert list_tasks(folder) == wanted
        monkeypatch.setenv("EDGECTL_TASKS", "tasks")
        check_readings(folder, {"camera": camera.pid, "lidar": lidar.pid})
