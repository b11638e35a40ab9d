# SPDX-License-Identifier: Apache-2.0
"""The short form of ``make experiment``: a tiny patrol on the local fleet, under one scheme, once."""

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
    """The shipped experiment with one room for each robot (its door, its middle), at addresses that no other test uses.

    The robots join soon, and the stranger comes at once and stays for a second.
    """
    site = directory / "site"
    write_scaffold(site)
    mission = site / "tasks" / "patrol"
    for name, old, new in (
        ("fleet.yaml", "127.0.1.", "127.0.7."),
        ("tasks.yaml", "patrol/follower.py", "patrol/follower.py --tour 2 --scans 4 --frames 4"),
    ):
        text = (mission / name).read_text()
        assert old in text
        (mission / name).write_text(text.replace(old, new))
    spec = mission / "experiment.yaml"
    text = spec.read_text()
    for old, new in (
        ("at: 4s", "at: 1s"),
        ("at: 8s", "at: 2s"),
        ("at: 40s", "at: 2s"),
        ("timeout 25", "timeout 1"),
        ("sleep 0.5", ":"),
    ):
        assert old in text
        text = text.replace(old, new)
    spec.write_text(shortened(text, repetitions=1, policies="utility", weights="all", every="1s"))
    return site


@pytest.mark.timeout(240)
def test_a_tiny_patrol(tmp_path: Path) -> None:
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
        "tasks/patrol/experiment.yaml",
        "-o",
        "json",
    ]
    fleet = {"EDGECTL_INVENTORY": "tasks/patrol/fleet.yaml", "EDGECTL_TASKS": "tasks/patrol/tasks.yaml"}
    with stopped(env | fleet, site):
        done = subprocess.run(
            command, cwd=site, env=env, capture_output=True, text=True, timeout=patience(200), check=False
        )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    (trial,) = load_run(site / "runs" / "patrol").trials
    assert trial.finished, done.stderr
    assert set(trial.completed) >= {
        f"{task}-robot{n}" for task in ("detection", "mapper", "follower") for n in (3, 2, 1)
    } | {"map-merge"}
    assert trial.ssim["ssim"] > 0.5, "the robots' rooms and the corridor are on the map"
    for name in ("fps", "recall", "latency/p95_ms"):
        assert set(trial.readings[name]) == {f"detection-robot{n}" for n in (1, 2, 3)}
    assert all(reading.value > 0 for task in trial.readings["fps"].values() for reading in task)
    events = {event.event: event for event in trial.events}
    assert {"links", "robot2-joins", "robot3-joins", "stranger"} <= events.keys()
    assert not any(event.error for event in trial.events)
    began = {span.task: span.start for span in trial.spans}
    assert began["robot-robot3"] > events["robot3-joins"].at, "nothing of a robot runs before it has joined"
    hosts = {span.task: span.host for span in trial.spans}
    assert hosts["detection-robot1"].startswith("edge"), "a robot has no room for its detection"
    assert {host for host, usage in trial.usage.items() if usage.cpu_s > 0} >= {"robot1", "robot2", "robot3"}
    assert [path.name for path in home.iterdir()] == ["edgectl-patrol"]
