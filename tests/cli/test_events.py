# SPDX-License-Identifier: Apache-2.0
"""events: the command, on the scaffold's own hosts."""

import contextlib
import json
import re
import signal
import sqlite3
import subprocess
import time
from pathlib import Path

import pytest

from edgectl.model.event import Event, EventKind
from edgectl.state.store import Store
from tests.cli.conftest import Run
from tests.cli.fleet_dir import open_fleet_dir
from tests.compiled_agent import give_scaffold_keys
from tests.forkserver import ForkedProcess
from tests.views.fixtures import ROOT


@pytest.fixture
def state(site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The scaffold's state directory."""
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    give_scaffold_keys(tmp_path / "state", site)
    return open_fleet_dir(site / "inventories" / "local.yaml")


def record_events(state: Path, *events: Event) -> None:
    with Store.open(state) as store:
        store.record_events(events)


def test_no_history_is_said_and_no_error(run: Run, state: Path) -> None:
    assert run("events") == (
        0,
        "",
        "note: no events in this time, or no edgectl observed any (edgectl probe does)\n",
    )
    assert json.loads(run("events", "-o", "json").out) == {
        "format_version": 2,
        "kind": "event",
        "items": [],
        "warnings": [],
    }
    assert run("events", "-o", "yaml").out == "format_version: 2\nkind: event\nitems: []\nwarnings: []\n"


def test_events_as_a_table_and_as_documents(run: Run, state: Path) -> None:
    now = time.time()
    record_events(
        state,
        Event(at=now - 90000, kind=EventKind.HOST_LOST, host="edge1", message="no route"),
        Event(
            at=now - 60,
            kind=EventKind.TASK_MOVED,
            host="edge2",
            task="slam-robot1",
            message="from edge1, gap 1.2s\x1b[2J",
        ),
        Event(at=now - 30, kind=EventKind.PLANNED, message="1 move"),
    )
    rows = run("events").out.splitlines()
    assert rows[0].split() == ["AT", "KIND", "SUBJECT", "MESSAGE"]
    assert [row.split(maxsplit=1)[1].split() for row in rows[1:]] == [
        ["task-moved", "slam-robot1", "on", "edge2", "from", "edge1,", "gap", "1.2s\\x1b[2J"],
        ["planned", "-", "1", "move"],
    ]
    assert len(run("events", "--since", "2d").out.splitlines()) == 4
    assert len(run("events", "--since", "2d", "--host", "edge1").out.splitlines()) == 2
    (event,) = json.loads(run("events", "--task", "slam-robot1", "-o", "json").out)["items"]
    assert (event["id"], event["kind"], event["host"], event["task"]) == (
        2,
        "task-moved",
        "edge2",
        "slam-robot1",
    )
    assert "kind: planned" in run("events", "-o", "yaml").out
    assert {path.name for path in state.iterdir()} == {"agent-key", "history.db"}


def test_a_name_that_nobody_knows_is_refused_with_the_closest(run: Run, state: Path) -> None:
    assert (run("events", "--host", "edge9").code, run("events", "--task", "slam-robt1").code) == (64, 64)
    assert "did you mean slam-robot1?" in run("events", "--task", "slam-robt1").err
    record_events(state, Event(at=time.time(), kind=EventKind.HOST_LOST, host="edge9"))
    assert run("events", "--host", "edge9").code == 0
    assert run("events", "--since", "soon").code == 64
    assert run("events", "-w", "-o", "yaml").code == 64


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_events_are_followed_until_a_signal(state: Path, ending: signal.Signals) -> None:
    record_events(state, Event(at=time.time(), kind=EventKind.HOST_LOST, host="edge1"))
    process = ForkedProcess(["events", "-w", "-o", "json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    with process, process.stdout as out, process.stderr as err:
        assert json.loads(out.readline())["kind"] == "host-lost"
        record_events(
            state, Event(at=time.time(), kind=EventKind.HOST_BACK, host="edge1", message="after 3.0s")
        )
        assert json.loads(out.readline())["message"] == "after 3.0s"
        process.send_signal(ending)
        assert process.wait(30) == 0
        assert (out.read(), err.read()) == ("", "")


def test_followed_rows_stand_below_each_other_and_end_when_nobody_reads(state: Path) -> None:
    record_events(state, Event(at=time.time(), kind=EventKind.HOST_LOST, host="edge1", message="no route"))
    process = ForkedProcess(["events", "-w"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    with process:
        rows = [process.stdout.readline() for _ in range(2)]
        record_events(
            state,
            Event(
                at=time.time(),
                kind=EventKind.TASK_CRASHLOOP,
                host="edge1",
                task="slam-robot1",
                message="exit code 1",
            ),
        )
        rows.append(process.stdout.readline())
        process.stdout.close()
        record_events(state, Event(at=time.time(), kind=EventKind.HOST_BACK, host="edge1"))
        assert process.wait(30) == 0
    places = [
        (row.index(what), row.index(why))
        for row, what, why in zip(rows, ("SUBJECT", "edge1", "slam"), ("MESS", "no r", "exit"), strict=True)
    ]
    assert len(set(places)) == 1


def test_a_broken_history_is_said_and_the_command_goes_on(run: Run, state: Path) -> None:
    (state / "history.db").write_bytes(b"SQLite format 3\0" + b"x" * 5000)
    said = run("events")
    assert said.code == 0
    assert "note: no events" in said.err
    assert "warning: " in said.err
    assert "set aside as history.db.broken-1" in said.err


def test_the_tables_and_the_queries_of_the_documentation_work(run: Run, state: Path) -> None:
    assert run("probe", "-o", "name").code == 0
    text = (ROOT / "docs" / "concepts" / "history.md").read_text()
    queries = re.findall(r"^```sql\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    named = set(
        re.findall(
            r"`([a-z_]+)`", "".join(re.findall(r"^\| (`[a-z_`, ]+) \| .* \| .* \|$", text, re.MULTILINE))
        )
    )
    with contextlib.closing(sqlite3.connect(f"file:{state / 'history.db'}?mode=ro", uri=True)) as connection:
        names = {
            row[0]
            for row in connection.execute("SELECT name FROM sqlite_master WHERE type IN ('table', 'view')")
        }
        assert {"host_samples", "task_samples", "events"} <= named <= names
        assert len(queries) == 3
        assert len({row[0] for query in queries for row in connection.execute(query)}) == 6
