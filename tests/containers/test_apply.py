# SPDX-License-Identifier: Apache-2.0
"""The commands on a task with an image: plan, apply, exec, a change of the image's keys, stop."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.containers.docker_engine import IMAGE, DockerEngine
from tests.pace import patience

INVENTORY = """\
version: 1
fleet: lab
edges:
  edge1: {host: localhost, connection: local}
"""
TASKS = """\
version: 1
tasks:
  slam:
    image: {name: "%s", volumes: ["/usr:/usr:ro"], pull: never%s}
    command: echo started; exec sleep 600
    demand: {cpu: 0, memory: 0}
    up: 1s
"""


def test_plan_apply_exec_and_stop(engine: DockerEngine, tmp_path: Path) -> None:
    (tmp_path / "i.yaml").write_text(INVENTORY)

    def run(*words: str, more: str = "", **changes: str) -> "subprocess.CompletedProcess[str]":
        (tmp_path / "t.yaml").write_text(TASKS % (IMAGE, more))
        files = ["-i", str(tmp_path / "i.yaml"), "-t", str(tmp_path / "t.yaml")]
        verb, *others = words
        return subprocess.run(
            [sys.executable, "-m", "edgectl", *verb.split(), *files, *others],
            env=os.environ
            | engine.environment
            | {"EDGECTL_STATE_DIR": str(tmp_path / "state"), "COLUMNS": "200"}
            | changes,
            capture_output=True,
            text=True,
            timeout=patience(240.0),
            check=False,
        )

    refused = run("plan", "--full", PATH="/bin", DOCKER_HOST="unix:///nowhere.sock")
    assert "without its container engine" in refused.stdout
    done = run("apply", "-y")
    assert done.returncode == 0, done.stdout + done.stderr
    assert engine.list_containers() == ["edgectl-lab-edge1-slam"]
    item = json.loads(run("describe task", "slam", "-o", "json").stdout)["item"]
    assert (item["spec"]["image"], item["runs"][0]["state"]) == (IMAGE, "running")
    inside = run("exec", "slam", "--", "/bin/sh", "-c", "echo $EDGECTL_CONTAINER")
    assert inside.stdout == "edgectl-lab-edge1-slam\n", inside.stderr
    again = run("apply", "-y", more=", user: '0:0'")
    assert again.returncode == 0, again.stdout + again.stderr
    assert "image changed" in again.stdout
    assert engine.call("inspect", "--format", "{{.Config.User}}", "edgectl-lab-edge1-slam") == "0:0"
    stopped = run("stop", "slam", "-y", more=", user: '0:0'")
    assert stopped.returncode == 0, stopped.stdout + stopped.stderr
    assert engine.list_containers() == []
