# SPDX-License-Identifier: Apache-2.0
"""history, show REV, rollback, drain, fence: the commands, on two local edges with one small real process."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.cli.fleet_dir import enter_fleet
from tests.cli.terminal import Terminal

INVENTORY = """version: 1
edges:
  edge1: {host: 127.0.0.1, connection: local, capacity: {cpu: 1, memory: 1Gi}}
  edge2: {host: 127.0.0.2, connection: local, capacity: {cpu: 1, memory: 1Gi}}
"""
SMALL = "127.0.0.2, connection: local, capacity: {cpu: 0.05,"
TASKS = """version: 1
tasks:
  idle: {command: "exec sleep 600", demand: {cpu: 0.1, memory: 10Mi}, stop: {grace: 2s}}
"""


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Two edges, one task; whatever was started is stopped."""
    with enter_fleet(tmp_path, INVENTORY, TASKS, monkeypatch) as folder:
        yield folder


def list_running_hosts(run: Run) -> list[str]:
    rows = json.loads(run("status", "-o", "json").out)["items"]
    return [row["host"] for row in rows if row["state"] == "running"]


def test_history_show_drain_rollback(run: Run, small: Path) -> None:
    before = run("history")
    assert (before.out, before.err) == ("", "note: nothing was applied yet\n")
    assert run("rollback", "--yes").code == 64
    assert run("apply", "--yes").code == 0
    assert list_running_hosts(run) == ["edge1"]
    said = run("drain", "edge1", "--yes")
    assert said.code == 0
    assert "edge1 is drained" in said.out
    assert list_running_hosts(run) == ["edge2"]
    probed = run("probe").out
    assert "ok, draining" in probed
    assert "note: draining, tasks move away: edge1 (edgectl uncordon)" in run("plan").err
    assert json.loads(run("plan", "-o", "json").out)["snapshot"]["manager"]["draining"] == ["edge1"]
    assert run("uncordon", "edge1").out == "edge/edge1 uncordoned\n"

    rows = run("history").out.splitlines()
    assert rows[0].split() == ["REVISION", "STARTED", "USER", "VERB", "TOOK", "OUTCOME", "ACTIONS"]
    assert [row.split()[0] for row in rows[1:]] == ["1", "2"]
    assert rows[2].split()[-2:] == ["1", "move"]
    assert run("history", "-o", "name").out == "revision/1\nrevision/2\n"
    document = json.loads(run("history", "-o", "json").out)["items"][1]
    assert (document["verb"], document["outcome"], document["counts"]) == ("drain", "done", {"move": 1})
    shown = json.loads(run("show", "2", "-o", "json").out)["item"]
    assert [phase["phase"] for phase in shown["actions"][0]["phases"]] == ["stop", "start", "ready"]
    assert shown["placements"] == {"idle": "edge2"}
    assert "gap " in run("show", "2").out
    assert "outcome: done" in run("show", "2", "-o", "yaml").out
    assert run("show", "2", "-o", "name").out == "task/idle\n"
    assert run("show", "9").code == 64
    assert run("show", "2", "-o", "markdown").code == 64

    assert run("rollback").code == 64
    assert "# edge1: start idle" in run("rollback", "--dry-run").out
    assert list_running_hosts(run) == ["edge2"]
    said = run("rollback", "1", "--yes")
    assert (said.code, list_running_hosts(run)) == (0, ["edge1"])
    assert "as after revision 1" in said.out
    assert run("rollback", "3", "--yes", "--quiet") == (0, "", "")


def test_a_drain_that_leaves_something_behind_exits_4(run: Run, small: Path) -> None:
    run("apply", "--yes")
    (small / "inventories" / "lab.yaml").write_text(
        INVENTORY.replace("127.0.0.2, connection: local, capacity: {cpu: 1,", SMALL)
    )
    said = run("drain", "edge1", "--yes", "--timeout", "1s")
    why = "0/2 hosts fit: 1 short of cpu (need 0.100 cores, free 0.050 cores), 1 cordoned; it stays where it runs"
    assert (said.code, said.err.splitlines()[-1]) == (4, f"still on edge1: idle ({why})")
    assert list_running_hosts(run) == ["edge1"]
    assert run("drain", "edge9", "--yes").code == 64


def test_fence_takes_the_name_of_the_host_for_a_yes(run: Run, small: Path) -> None:
    assert run("fence", "edge1").code == 64
    assert run("fence", "edge9", "--yes").code == 64
    with Terminal(["fence", "edge1"], small) as terminal:
        terminal.until("Type its name if it is powered off: ")
        terminal.type("yes\n")
        assert terminal.wait() == 1
    with Terminal(["fence", "edge1"], small) as terminal:
        terminal.until("Type its name if it is powered off: ")
        terminal.type("edge1\n")
        assert terminal.wait() == 0
    assert run("fence", "edge2", "--yes").out == "edge/edge2 fenced\n"
    assert run("unfence", "edge2").out == "edge/edge2 unfenced\n"
    said = run("probe")
    assert "warning: edge1 answers, so it is not powered off: its fence is cleared\n" in said.err
    assert run("unfence", "edge1").out == "edge/edge1 already unfenced\n"
    tried = run("fence", "edge1", "--dry-run")
    assert tried.out == "edge/edge1 fenced (dry run)\n"
    assert tried.err.startswith("note: edge1 last answered ")
    assert tried.err.endswith(" ago; the fence ends when it answers\n")
