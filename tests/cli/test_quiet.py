# SPDX-License-Identifier: Apache-2.0
"""``apply --yes --quiet``, as cron calls it: no output if nothing was done and nothing failed; else the
reason, and the exit code.
"""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.compiled_agent import give_agent_and_keys

QUIET = ("apply", "--yes", "--quiet")
INVENTORY = """version: 1
edges:
  edge1: {host: 127.0.0.1, connection: local, capacity: {cpu: 1, memory: 1Gi}}
"""
# Port 1 of this machine: nobody listens there, and no packet leaves it.
GONE = "  edge2: {host: 127.0.0.1, port: 1}\n"
IDLE = '  idle: {command: "exec sleep 600", demand: {cpu: 0.1, memory: 10Mi}, stop: {grace: 2s}}\n'


class QuietFleet:
    """Its files, and the command in its directory."""

    def __init__(self, site: Path, run: Run) -> None:
        self.site, self.run = site, run
        self.write(INVENTORY, IDLE)

    def write(self, inventory: str, *tasks: str) -> None:
        for name, text in (
            ("inventories/lab.yaml", inventory),
            ("tasks/lab.yaml", "version: 1\ntasks:\n" + "".join(tasks)),
        ):
            (self.site / name).parent.mkdir(exist_ok=True)
            (self.site / name).write_text(text)


@pytest.fixture
def fleet(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> Iterator[QuietFleet]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: SIM115, PTH123 - closed below
    made = QuietFleet(tmp_path, run)
    give_agent_and_keys(tmp_path / "state", tmp_path / "inventories" / "lab.yaml")
    with sys.stdin:
        yield made
        made.write(INVENTORY, IDLE)
        assert run("stop", "--all", "--yes").code == 0
        assert run("status", "-o", "name").out == ""


def test_what_was_done_is_said_once_without_the_plan(fleet: QuietFleet) -> None:
    said = fleet.run(*QUIET)
    assert (said.code, said.err) == (0, "")
    assert "Applied 1 of 1" in said.out
    assert "Plan:" not in said.out
    assert fleet.run(*QUIET) == (0, "", "")


def test_warnings_about_files_are_for_people(fleet: QuietFleet) -> None:
    """An omitted demand and an ignored change are reported to an operator, not every five minutes."""
    other = '  other: {command: "exec sleep 600"}\n'
    fleet.run(*QUIET)
    fleet.write(INVENTORY, IDLE, other)
    assert fleet.run(*QUIET, "--target", "idle") == (0, "", "")
    assert "left out" in fleet.run("plan", "--target", "idle").err


def test_a_task_without_a_host_is_silent_unless_its_exit_code_is_wanted(fleet: QuietFleet) -> None:
    fleet.write(INVENTORY, IDLE, '  big: {command: "true", demand: {cpu: 64, memory: 1Mi}}\n')
    fleet.run(*QUIET)
    assert fleet.run(*QUIET) == (0, "", "")
    said = fleet.run(*QUIET, "--detailed-exitcode")
    assert (said.code, said.out) == (3, "")
    assert said.err.startswith("big: unplaced: ")
    assert said.err.count("\n") == 1


def test_a_host_that_does_not_answer_is_one_line_and_4(fleet: QuietFleet) -> None:
    fleet.run(*QUIET)
    fleet.write(INVENTORY + GONE, IDLE)
    said = fleet.run(*QUIET)
    assert (said.code, said.out) == (4, "")
    assert said.err.startswith("edge2 does not answer: ")
    assert said.err.count("\n") == 1
    assert fleet.run(*QUIET, "--allow-unreachable") == (0, "", "")
    assert fleet.run("fence", "edge2", "--yes").code == 0
    assert fleet.run(*QUIET) == (0, "", "")


def test_an_action_that_fails_is_said_and_4(fleet: QuietFleet) -> None:
    fleet.write(
        INVENTORY,
        '  idle: {command: "exec false", demand: {cpu: 0.1, memory: 1Mi}, restart: never, ready: {command: "false", timeout: 2s}}\n',
    )
    said = fleet.run(*QUIET)
    assert said.code == 4
    assert "idle" in said.out
    assert "Plan:" not in said.out


def test_what_is_wrong_with_the_files_is_said_and_64(fleet: QuietFleet) -> None:
    fleet.write(INVENTORY, "  idle: {comand: x}\n")
    said = fleet.run(*QUIET)
    assert (said.code, said.out) == (64, "")
    assert "comand" in said.err


def test_a_lock_that_is_held_is_said_and_75(fleet: QuietFleet, tmp_path: Path) -> None:
    from edgectl.state.lock import FleetLock
    from tests.cli.fleet_dir import open_fleet_dir

    fleet.run(*QUIET)
    with FleetLock(open_fleet_dir(tmp_path / "inventories" / "lab.yaml"), verb="drain"):
        said = fleet.run(*QUIET)
    assert (said.code, said.out) == (75, "")
    assert said.err.startswith("error: lock held by ")
    assert fleet.run(*QUIET) == (0, "", "")
