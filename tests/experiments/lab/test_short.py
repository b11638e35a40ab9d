# SPDX-License-Identifier: Apache-2.0
"""The short form of ``make experiment``: a tiny mission on the local fleet, under two schemes, once each."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from edgectl.experiments.files.run_directory import load_run
from edgectl.scaffold.write import write_scaffold
from tests.compiled_agent import give_scaffold_keys
from tests.docs.blocks import environment, stopped
from tests.experiments.lab.spec import shortened
from tests.pace import patience


def a_tiny_site(directory: Path) -> Path:
    """The shipped experiment with one room for each robot (its door, its middle), at addresses that no other test uses."""
    site = directory / "site"
    write_scaffold(site)
    mission = site / "tasks" / "mission"
    for name, old, new in (
        ("fleet.yaml", "127.0.1.", "127.0.7."),
        ("tasks.yaml", "mission/follower.py", "mission/follower.py --tour 2 --scans 4 --frames 4"),
    ):
        text = (mission / name).read_text()
        assert old in text
        (mission / name).write_text(text.replace(old, new))
    spec = mission / "experiment.yaml"
    spec.write_text(
        shortened(spec.read_text(), repetitions=1, policies="local,utility", weights="all", every="1s")
    )
    return site


@pytest.mark.timeout(240)
def test_a_tiny_mission_under_two_schemes(tmp_path: Path) -> None:
    site = a_tiny_site(tmp_path)
    home = tmp_path / "home"
    home.mkdir()
    give_scaffold_keys(tmp_path / "state", site)
    env = environment(tmp_path / "state") | {"HOME": str(home)}
    command = [
        sys.executable,
        "-m",
        "edgectl",
        "experiment",
        "run",
        "tasks/mission/experiment.yaml",
        "-o",
        "json",
    ]
    fleet = {"EDGECTL_INVENTORY": "tasks/mission/fleet.yaml", "EDGECTL_TASKS": "tasks/mission/tasks.yaml"}
    with stopped(env | fleet, site):
        done = subprocess.run(
            command, cwd=site, env=env, capture_output=True, text=True, timeout=patience(200), check=False
        )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    run = load_run(site / "runs" / "mission")
    assert [trial.scheme for trial in run.trials] == ["local", "utility all"]
    for trial in run.trials:
        assert trial.finished, done.stderr
        assert set(trial.completed) >= {
            f"{task}-robot{n}" for task in ("detection", "mapper", "follower") for n in (1, 2)
        } | {"map-merge"}
        assert trial.ssim["ssim"] > 0.5, "both robots' rooms and the corridor are on the map"
        for name in ("fps", "recall"):
            assert set(trial.readings[name]) == {"detection-robot1", "detection-robot2"}
        assert all(reading.value > 0 for task in trial.readings["fps"].values() for reading in task)
    local, utility = ({span.task: span.host for span in trial.spans} for trial in run.trials)
    assert set(local.values()) == {"robot1", "robot2"}
    assert utility["detection-robot1"].startswith("edge"), "a robot has no room for its detection"
    assert [path.name for path in home.iterdir()] == ["edgectl-mission"]
