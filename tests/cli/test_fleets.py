# SPDX-License-Identifier: Apache-2.0
"""Two fleets of one login on one computer, as two people with one account have them."""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.compiled_agent import give_agent_and_keys
from tests.docs.blocks import stopped

INVENTORY = """version: 1
fleet: {fleet}
edges:
  edge1: {{host: 127.0.0.1, connection: local, capacity: {{cpu: 1, memory: 1Gi}}}}
"""
TASKS = """version: 1
tasks:
  idle: {{command: "echo {fleet}; exec sleep 600", demand: {{cpu: 0.1, memory: 10Mi}}, up: 100ms, stop: {{grace: 2s}}}}
  {fleet}: {{command: exec sleep 600, demand: {{cpu: 0.1, memory: 10Mi}}, up: 100ms, stop: {{grace: 2s}}}}
"""


@pytest.fixture
def fleets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Directories lab and hall, each with an inventory and tasks for the same host; all is stopped in the end."""
    for fleet in ("lab", "hall"):
        for name, text in (("inventories/site.yaml", INVENTORY), ("tasks/site.yaml", TASKS)):
            (tmp_path / fleet / name).parent.mkdir(parents=True)
            (tmp_path / fleet / name).write_text(text.format(fleet=fleet))
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: SIM115, PTH123 - closed below
    give_agent_and_keys(
        tmp_path / "state", *(tmp_path / fleet / "inventories" / "site.yaml" for fleet in ("lab", "hall"))
    )
    env = dict(os.environ)
    with sys.stdin, stopped(env, tmp_path / "lab", tmp_path / "hall"):
        yield tmp_path


def list_runs(run: Run) -> dict[str, int]:
    return {row["task"]: row.get("pid", 0) for row in json.loads(run("status", "-o", "json").out)["items"]}


def test_a_second_fleet_sees_stops_and_restarts_nothing_of_the_first(
    fleets: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same host name, one task of the same name with another command, one that only the first has."""
    monkeypatch.chdir(fleets / "lab")
    assert run("apply", "--yes").code == 0
    first = list_runs(run)
    assert set(first) == {"idle", "lab"}
    assert all(first.values())
    monkeypatch.chdir(fleets / "hall")
    assert run("apply", "--yes").code == 0
    second = list_runs(run)
    assert set(second) == {"idle", "hall"}
    said = run("status")
    assert "edge1: fleet lab (" in said.out + said.err
    assert "runs idle and lab; it is left alone" in " ".join((said.out + said.err).split())
    assert "Other tasks on this machine:" in run("describe", "edge", "edge1").out
    assert run("restart", "idle", "--yes").code == 0
    assert run("stop", "--all", "--yes").code == 0
    monkeypatch.chdir(fleets / "lab")
    assert list_runs(run) == first
    assert run("logs", "idle").out == "lab\n"


def test_a_fleet_keeps_its_marks_when_its_file_is_renamed(
    fleets: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(fleets / "lab")
    assert run("cordon", "edge1").code == 0
    Path("inventories/site.yaml").rename("inventories/renamed.yaml")
    assert "cordoned" in run("get", "edges").out
