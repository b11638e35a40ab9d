# SPDX-License-Identifier: Apache-2.0
"""wait: the command, on the scaffold's own hosts."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Run


@pytest.fixture
def fleet(site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> Iterator[Path]:
    """One task that takes its time to be ready, one job, and one that fails; stopped afterwards."""
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    (site / "tasks" / "wait.yaml").write_text(
        "version: 1\ntasks:\n"
        "  slow: {command: 'sleep 1; touch up; sleep 600', workdir: "
        + str(site)
        + ", demand: {cpu: 0, memory: 0},"
        " ready: test -e up}\n"
        "  job: {command: sleep 0.5, kind: job, demand: {cpu: 0, memory: 0}}\n"
        "  bad: {command: 'sleep 0.2; exit 3', restart: never, demand: {cpu: 0, memory: 0}}\n"
    )
    yield site
    assert run("stop", "--all", "--yes", "-t", "tasks/wait.yaml").code == 0


def test_ready_completed_failed_and_gone(fleet: Path, run: Run) -> None:
    tasks = ("--every", "100ms", "-t", "tasks/wait.yaml")
    assert run("wait", "task/slow", "--for", "gone", *tasks).code == 0
    run("apply", "--yes", "-t", "tasks/wait.yaml")
    ready = run("wait", "slow", "-o", "name", *tasks)
    assert (ready.code, ready.out) == (0, "task/slow\n")
    assert run("wait", "job", "--for", "completed", *tasks).code == 0
    failed = run("wait", "bad", "slow", "-o", "json", *tasks)
    assert failed.code == 1
    states = {item["task"]: (item["state"], item["reached"]) for item in json.loads(failed.out)["items"]}
    assert states == {"bad": ("failed", False), "slow": ("ready", True)}
    still = run("wait", "slow", "--for", "gone", "--timeout", "200ms", *tasks)
    assert still.code == 1
    assert "task/slow ready on" in still.err
    assert "not gone" in still.err


def test_an_unknown_name_is_refused(fleet: Path, run: Run) -> None:
    said = run("wait", "slwo", "-t", "tasks/wait.yaml")
    assert said.code == 64
    assert "did you mean slow?" in said.err
