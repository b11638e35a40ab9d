# SPDX-License-Identifier: Apache-2.0
"""The walk of docs/ros.md on a real ROS: from a launch file to a moved SLAM, its commands as they are printed."""

import contextlib
import json
import os
import re
import subprocess
from pathlib import Path

import pytest

from edgectl.cli.user_files import refuse_exposed_files
from edgectl.usecases.import_files import read_launch_files
from tests.cli.fleet_dir import enter_fleet
from tests.cli.inprocess import edgectl
from tests.docs.blocks import blocks, environment
from tests.e2e.test_unreachable import wait_until
from tests.ros.test_bringups import Lab, ask_ros2, call, make_lab
from tests.views.fixtures import ROOT

PAGE = ROOT / "docs" / "ros.md"
FILES = {1: "slam.launch", 2: "slam.launch.xml"}
# The doctor may warn of the machine of the tests.
CODES = {"edgectl doctor": (0, 1)}


def adapt_inventory(lab: Lab) -> str:
    """The inventory of the page with this machine as every host, and the graph of the test."""
    found = re.search(
        r"^```yaml\n(# inventories/lab.yaml\n.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL
    )
    assert found is not None
    text = re.sub(r"ros: \{.*\}", lambda _: f"ros: {lab.ros}", found[1])
    text = re.sub(r"(edge\d): \{host: .*\}", r"\1: {host: 127.0.0.1, connection: local}", text)
    return re.sub(r"(robot\d): \{host: .*\}", r"\1: {host: 127.0.0.1, probe: false}", text)


def read_node_environ(lab: Lab) -> list[str]:
    """The environment of the process that the master has as the SLAM; empty for none."""
    with contextlib.suppress(AssertionError, OSError):
        pid = call(call(lab.master, "lookupNode", "/robot1/slam"), "getPid")
        return Path(f"/proc/{pid}/environ").read_text().split("\0")
    return []


def find_host(folder: Path, lab: Lab) -> str:
    """The host of the SLAM, as status says; the graph has the node, and it is that of this host."""
    items = json.loads(edgectl(["status", "-o", "json"], folder, dict(os.environ)).out)["items"]
    [entry] = [item for item in items if item["task"] == "slam"]
    assert entry["state"] in ("running", "ready"), entry
    if lab.version == 1:
        wait_until(lambda: f"EDGECTL_HOST={entry['host']}" in read_node_environ(lab), 30.0)
        assert call(lab.master, "getParam", "/robot1/slam") == {"particles": 30}
    else:
        topics, parameters = ask_ros2(["/robot1/slam"], lab)["/robot1/slam"]
        assert ("/robot1/front/scan" in topics, parameters["resolution"]) == (True, 0.05)
    return str(entry["host"])


def run_as_printed(command: str, folder: Path) -> None:
    """Run a command of the page: in this process, or where it needs a shell, in one."""
    if command.startswith("sed") or ">" in command:
        subprocess.run(["bash", "-c", command], env=environment(folder / "state"), check=True, cwd=folder)
        return
    done = edgectl(command.split()[1:], folder, dict(os.environ))
    assert done.code in CODES.get(command, (0,)), (command, done)


@pytest.mark.parametrize("version", [1, 2])
def test_the_walk_of_the_chapter(version: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    launch_file = str(ROOT / "docs" / "examples" / "launch" / FILES[version])
    launch = read_launch_files([launch_file], {}, [], by_file=False, refuse_exposed=refuse_exposed_files)
    lab = make_lab(tmp_path, launch)
    [block] = [each for each in blocks(PAGE) if "slam.launch" in each.commands[0][0]]
    first = block.commands[0][0]
    with enter_fleet(tmp_path, adapt_inventory(lab), "version: 1\ntasks: {}\n", monkeypatch) as folder:
        (folder / "docs").symlink_to(ROOT / "docs")
        (folder / "tasks" / "lab.yaml").unlink()
        places = []
        for command, _ in block.commands:
            run_as_printed(command.replace(FILES[1], FILES[version]), folder)
            if command == first:
                tasks = folder / "tasks" / "slam.yaml"
                tasks.write_text(
                    tasks.read_text().replace("command: roscore", f"command: roscore -p {lab.port}")
                )
            if command == "edgectl apply --yes":
                places.append(find_host(folder, lab))
        assert places[1:] == ["edge2", "edge1"]
