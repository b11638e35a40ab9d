# SPDX-License-Identifier: Apache-2.0
"""Metrics as a page, as a file, and over HTTP from real probes; the history as rows."""

import contextlib
import csv
import dataclasses
import gzip
import io
import json
import os
import re
import signal
import sqlite3
import stat
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from edgectl.cli.http_server import parse_listen_address
from edgectl.errors import UsageError
from edgectl.export.history_rows import RowKind
from edgectl.export.metrics import METRICS
from edgectl.model.event import Event, EventKind
from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.model.snapshot import Snapshot
from edgectl.state.store import Store
from edgectl.units import parse_instant
from tests.cli.conftest import Run
from tests.cli.fleet_dir import open_fleet_dir
from tests.forkserver import ForkedProcess
from tests.pace import patience
from tests.views import fixtures


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    return tmp_path / "state"


@contextlib.contextmanager
def serve_metrics(site: Path, *words: str) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Run ``export prometheus --listen`` on a free port of this machine; yields its URL."""
    command = ["export", "prometheus", "--listen", "127.0.0.1:0", *words]
    process = ForkedProcess(command, cwd=site, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stderr is not None
    try:
        said = process.stderr.readline()
        found = re.search(r"http://127\.0\.0\.1:[0-9]+/metrics", said)
        assert found, said
        yield found[0], process
    finally:
        process.kill()
        process.communicate()


def fetch_page(url: str, **headers: str) -> bytes:
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=patience(60)) as answer:
        return bytes(answer.read())


def test_a_real_scrape_and_several_at_once_are_one_probe(site: Path, state: Path) -> None:
    with serve_metrics(site, "--every", "10m", "--timeout", "50s") as (url, process):
        with ThreadPoolExecutor(6) as pool:
            pages = set(pool.map(fetch_page, [url] * 6))
        assert len(pages) == 1, "one probe, one page"
        page = pages.pop().decode()
        assert gzip.decompress(fetch_page(url, **{"Accept-Encoding": "gzip"})).decode() == page
        up = {
            sample.labels["host"]: sample.value
            for family in text_string_to_metric_families(page)
            for sample in family.samples
            if sample.name == "edgectl_host_up"
        }
        assert up == dict.fromkeys(("edge1", "edge2", "edge3", "robot1", "robot2", "robot3"), 1.0)
        assert "# EOF" in fetch_page(url, Accept="application/openmetrics-text; version=1.0.0").decode()
        with pytest.raises(urllib.error.HTTPError, match="404"):
            fetch_page(url.removesuffix("/metrics") + "/etc/passwd")
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
        assert process.communicate() == ("", "")


def test_each_scrape_probes_where_nothing_is_kept_and_ctrl_c_ends_it(site: Path, state: Path) -> None:
    with serve_metrics(site, "--every", "0s", "--timeout", "50s") as (url, process):
        seen = [
            re.findall(rb"^edgectl_last_probe_timestamp_seconds (.*)$", fetch_page(url), re.MULTILINE)
            for _ in range(2)
        ]
        assert seen[0] != seen[1]
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


def test_a_failure_costs_the_scrape_not_the_server(site: Path, state: Path) -> None:
    with serve_metrics(site, "--every", "0s", "--timeout", "50s") as (url, process):
        fleet = next((state / "fleets").iterdir())
        (fleet / "memory.json").write_text('{"format_version": 99}')
        with pytest.raises(urllib.error.HTTPError, match="503: no metrics"):
            fetch_page(url)
        (fleet / "memory.json").unlink()
        assert b"edgectl_host_up" in fetch_page(url)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
        assert "newer edgectl" in process.communicate()[1]


def test_the_textfile_is_replaced_whole_and_readable_for_others(site: Path, state: Path, run: Run) -> None:
    target = site / "edgectl.prom"
    target.write_text("old")
    before = os.umask(0o077)
    try:
        assert run("export", "prometheus", "--textfile", str(target), "--timeout", "50s") == (0, "", "")
    finally:
        os.umask(before)
    page = target.read_text()
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    assert [line.split()[2] for line in page.splitlines() if line.startswith("# TYPE")] == [
        metric.name for metric in METRICS
    ]
    assert [path.name for path in site.iterdir() if "edgectl.prom" in path.name] == ["edgectl.prom"]


def test_what_cannot_be_written_or_bound_is_said(site: Path, state: Path, run: Run) -> None:
    ended = run("export", "prometheus", "--textfile", "missing/edgectl.prom", "--timeout", "50s")
    assert (ended.code, ended.out) == (1, "")
    assert "cannot write missing/edgectl.prom" in ended.err
    ended = run("export", "prometheus", "--listen", "192.0.2.1:0")
    assert ended.code == 1
    assert "cannot listen on 192.0.2.1:0" in ended.err
    assert run("export", "prometheus", "--listen", "1", "--textfile", "x").code == 64


def test_a_silent_host_shows_in_the_page_and_in_the_exit_code(site: Path, state: Path, run: Run) -> None:
    inventory = site / "inventories" / "local.yaml"
    text = inventory.read_text().replace(
        "  edge3: {host: 127.0.1.13,", "  edge3: {host: 127.0.1.13, connection: ssh, port: 1, user: nobody,"
    )
    inventory.write_text(text)
    ended = run("export", "prometheus", "--timeout", "50s")
    assert ended.code == 4
    assert 'edgectl_host_up{host="edge3",role="edge"} 0.0' in ended.out
    assert run("export", "prometheus", "--timeout", "50s", "--allow-unreachable").code == 0


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("9815", ("127.0.0.1", 9815)),
        (":9815", ("127.0.0.1", 9815)),
        ("0.0.0.0:1", ("0.0.0.0", 1)),
        ("[::1]:2", ("::1", 2)),
    ],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert parse_listen_address(text) == address


@pytest.mark.parametrize("text", ["", "host", "host:", "host:x", "host:65536", "host:-1", "1:²"])
def test_no_addresses(text: str) -> None:
    with pytest.raises(UsageError, match="cannot read the address"):
        parse_listen_address(text)


# -- rows
# ---------------------------------------------------------------------------------------------------------------------------------


def add_metrics(snapshot: Snapshot) -> Snapshot:
    """Return the snapshot with metrics for every task."""
    hosts = {
        name: dataclasses.replace(
            host,
            tasks={
                each: dataclasses.replace(task, metrics={"fps": 29.5}) for each, task in host.tasks.items()
            },
        )
        for name, host in snapshot.hosts.items()
    }
    return dataclasses.replace(snapshot, hosts=hosts)


@pytest.fixture
def recorded(site: Path, state: Path, run: Run) -> Path:
    """The history of two real probes, an hour apart and just now, a move and an event; the file."""
    directory = open_fleet_dir(site / "inventories" / "local.yaml")
    snapshot = add_metrics(dataclasses.replace(fixtures.fleet()[2], manager=None))
    with Store.open(directory) as store:
        store.record_snapshot(dataclasses.replace(snapshot, taken_at=time.time() - 3600.0))
        store.record_snapshot(dataclasses.replace(snapshot, taken_at=time.time()))
        move = ActionResult(
            task="slam-robot1", action=Action.MOVE, outcome=Outcome.DONE, host="edge2", previous_host="edge1", downtime_s=0.5, located="edge2"
        )  # fmt: skip
        store.record_results(fixtures.plan(), Results(revision=1, actions=(move,), seconds=1.0), time.time())
        store.record_events(
            [Event(at=time.time(), kind=EventKind.HOST_LOST, host="edge1", message='no "route", none')]
        )
    return directory / "history.db"


@pytest.mark.parametrize("kind", RowKind)
def test_rows_as_csv_and_json_lines_are_the_same(recorded: Path, run: Run, kind: RowKind) -> None:
    table, lines = run("export", "csv", kind.value), run("export", "jsonl", kind.value)
    assert (table.code, table.err, lines.code, lines.err) == (0, "", 0, "")
    rows = list(csv.DictReader(io.StringIO(table.out, newline="")))
    objects = [json.loads(line) for line in lines.out.splitlines()]
    assert rows == [
        {key: "" if value is None else str(value) for key, value in each.items()} for each in objects
    ]
    assert rows
    assert [parse_instant(row["at"]) for row in rows] == sorted(parse_instant(row["at"]) for row in rows)


def test_since_leaves_out_what_is_older(recorded: Path, run: Run) -> None:
    every = run("export", "csv", "hosts").out.splitlines()
    newer = run("export", "csv", "hosts", "--since", "30m").out.splitlines()
    assert newer[0] == every[0]
    assert newer[1:] == every[len(every) // 2 + 1 :]
    assert len(newer) == 1 + 6
    assert run("export", "csv", "hosts", "--since", "soon").code == 64


def test_rows_into_a_file(recorded: Path, site: Path, run: Run) -> None:
    target = site / "hosts.csv"
    assert run("export", "csv", "hosts", "--out", str(target)) == (0, "", "")
    assert target.read_text() == run("export", "csv", "hosts").out


def test_nobody_reads_to_the_end(recorded: Path, site: Path) -> None:
    with sqlite3.connect(recorded) as database:
        database.executemany(
            "INSERT INTO host_samples (host, at, status) VALUES ('edge1', ?, 'unreachable')",
            [(float(at),) for at in range(20_000)],
        )
    database.close()
    command = f"{sys.executable} -m edgectl export jsonl hosts | head -n 2; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(
        ["bash", "-c", command], cwd=site, capture_output=True, text=True, check=False, timeout=patience(60)
    )
    assert (done.returncode, done.stdout.count("\n"), done.stderr) == (0, 2, "")


def test_a_row_that_cannot_be_read_is_said_and_no_file_is_replaced(
    recorded: Path, site: Path, run: Run
) -> None:
    with sqlite3.connect(recorded) as database:
        database.execute("UPDATE host_samples SET status = 'sideways' WHERE host = 'robot3'")
    database.close()
    target = site / "hosts.csv"
    target.write_text("as before\n")
    ended = run("export", "csv", "hosts", "--out", str(target))
    assert ended.code == 1
    assert "the history cannot be read to its end" in ended.err
    assert target.read_text() == "as before\n"
    assert [path.name for path in site.iterdir() if "hosts.csv" in path.name] == ["hosts.csv"]


def test_a_fleet_without_a_history_has_no_rows(site: Path, state: Path, run: Run) -> None:
    assert run("export", "csv", "handoffs") == (
        0,
        "at,task,host,previous_host,outcome,downtime_s,duration_s,gap_s\n",
        "",
    )
    assert run("export", "jsonl", "handoffs") == (0, "", "")
