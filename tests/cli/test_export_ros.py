# SPDX-License-Identifier: Apache-2.0
"""export ros as a process, its node with a stand-in for the packages of ROS; make ros hears real topics."""

import json
import signal
import subprocess
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.cli.fleet_dir import enter_fleet
from tests.e2e.test_unreachable import wait_until
from tests.forkserver import ForkedProcess
from tests.pace import patience
from tests.ros1_peer import serve_master
from tests.rospy_standin import read_published, write_standin

INVENTORY = """version: 1
edges:
  edge1: {{host: 127.0.0.1, connection: local, ros: {{version: 1, master: "{master}"}}}}
  edge2: {{host: 127.0.0.1, connection: local, ros: {{version: 2, domain: 7}}}}
"""
TASKS = """version: 1
tasks:
  idle: {command: "exec sleep 600", demand: {cpu: 0.1, memory: 10Mi}}
"""


def test_the_fleet_is_published_until_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    setup = write_standin(tmp_path)
    with (
        serve_master() as master,
        enter_fleet(tmp_path, INVENTORY.format(master=master.uri), TASKS, monkeypatch) as folder,
    ):
        process = ForkedProcess(
            ["export", "ros", "--setup", str(setup), "--host", "edge1"],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        try:
            wait_until(lambda: len(read_published(tmp_path)) >= 2, patience(30.0))
            process.send_signal(signal.SIGINT)
            assert process.wait(patience(30.0)) == 0
        finally:
            process.kill()
            out, err = process.communicate()
        assert out == ""
        assert "publishing /diagnostics and /edgectl/status; press Ctrl-C to stop" in err
        assert "sourced with 0 arguments" in err
        said = dict(read_published(tmp_path))
        assert [item["task"] for item in json.loads(str(said["/edgectl/status"]))["items"]] == ["idle"]
        array = said["/diagnostics"]
        assert isinstance(array, dict)
        levels = {each["name"].partition(": ")[2]: each["level"] for each in array["status"]}
        assert levels == {"fleet": 1, "host edge1": 0, "host edge2": 0, "task idle": 1}
        assert said["goodbye"] == "edgectl has ended"


def test_what_cannot_be_published_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    with enter_fleet(tmp_path, INVENTORY.format(master="http://127.0.0.1:9"), TASKS, monkeypatch):
        assert run("export", "ros") == (
            64,
            "",
            "error: edge1 and edge2 are in different graphs of ROS\nhint: choose one: --host edge1\n",
        )
        assert run("export", "ros", "--host", "edge9").code == 64
        said = run("export", "ros", "--host", "edge1", "--setup", "nothing.bash")
        assert (said.code, said.err.splitlines()[0]) == (
            1,
            "error: set-up file nothing.bash cannot be read on this machine",
        )
