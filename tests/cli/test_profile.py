# SPDX-License-Identifier: Apache-2.0
"""profile: measured usage, and writing it into the task file."""

import json
import os
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import FileError
from edgectl.model.resource import Usage
from edgectl.state.store import Store
from tests.builders import GI, NOW, a_run, a_sample, a_snapshot
from tests.cli.conftest import Run
from tests.cli.fleet_dir import open_fleet_dir
from tests.cli.terminal import Terminal

TASKS = """\
version: 1  # the form
tasks:
  slam:     # one per robot
    for_each: robot
    command: run   # stays
    demand: {cpu: 35.2%, memory: "1Gi"}   # guessed
  idle: {command: x}
"""
INVENTORY = "version: 1\nedges: {edge1: {host: a}, edge2: {host: b}}\nrobots: {robot1: {host: c, probe: false}, robot2: {host: d, probe: false}}\n"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for folder, name, text in (("inventories", "lab.yaml", INVENTORY), ("tasks", "tasks.yaml", TASKS)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_text(text)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def record_samples(site: Path, *, samples: int = 100) -> None:
    """slam-robot1 used up to 1 core on edge1; slam-robot2 twice that on edge2, which is of another class."""
    _, tasks, _ = load_inventory_and_tasks(site / "inventories" / "lab.yaml", site / "tasks" / "tasks.yaml")
    with Store.open(open_fleet_dir(site / "inventories" / "lab.yaml")) as store:
        for n in range(samples):
            runs = {
                name: a_run(
                    spec_hash=tasks.tasks[name].spec_hash,
                    started_at=NOW - 60,
                    used=Usage(cpu=times * (n + 1) / 100, memory=GI / 4),
                )
                for name, times in (("slam-robot1", 1), ("slam-robot2", 2))
            }
            store.record_snapshot(a_snapshot(
                taken_at=NOW + 10 * n,
                edge1=a_sample(tasks={"slam-robot1": runs["slam-robot1"]}), edge2=a_sample(cores=8.0, tasks={"slam-robot2": runs["slam-robot2"]}),
            ))  # fmt: skip


def test_figures_beside_what_is_declared(site: Path, run: Run) -> None:
    record_samples(site)
    said = run("profile", "slam-robot1")
    assert [line.split() for line in said.out.splitlines()] == [
        ["TASK", "CLASS", "RESOURCE", "DECLARED", "P50", "P95", "MAX", "SAMPLES", "SPAN", "HOSTS"],
        ["slam-robot1", "4c-4Gi", "cpu", "35.2%", "0.50", "0.95", "1.00", "100", "16m30s", "edge1"],
        ["memory", "1.0Gi", "256.0Mi", "256.0Mi", "256.0Mi"],
        ["throughput", "-", "0B/s", "0B/s", "0B/s"],
    ]
    document = json.loads(run("profile", "slam", "-o", "json").out)
    assert [(each["task"], each["class"], each["resources"]["cpu"]["p95"]) for each in document["items"]] == [
        ("slam-robot1", "4c-4Gi", 0.95), ("slam-robot2", "8c-4Gi", 1.9),
    ]  # fmt: skip
    assert document["items"][0]["resources"]["cpu"]["declared"] == {
        "amount": pytest.approx(0.352),
        "relative": True,
        "until_measured": False,
    }
    assert run("profile", "slma").err.splitlines()[1] == "hint: did you mean slam?"


def test_service_times_are_those_of_a_nearly_idle_host(site: Path, run: Run) -> None:
    """frame_ms is 30 to 34 where others leave edge1 idle, and 90 where they use half of it."""
    _, tasks, _ = load_inventory_and_tasks(site / "inventories" / "lab.yaml", site / "tasks" / "tasks.yaml")
    with Store.open(open_fleet_dir(site / "inventories" / "lab.yaml")) as store:
        for n, (used, value) in enumerate([(0.6, 30.0), (0.6, 31.0), (0.7, 34.0), (2.5, 90.0), (0.6, 30.5)]):
            running = a_run(
                spec_hash=tasks.tasks["slam-robot1"].spec_hash,
                started_at=NOW - 60,
                used=Usage(cpu=0.5, memory=GI),
                metrics={"frame_ms": value},
            )
            sample = a_sample(used=used, tasks={"slam-robot1": running})
            store.record_snapshot(a_snapshot(taken_at=NOW + 10 * n, edge1=sample))
    code, _, err = run("profile", "slam-robot1", "--service", "frame_ms")
    assert code == 0
    line = "service_time: {4c-4Gi: {p50: 30.5ms, p95: 34ms}}  # 4 samples of frame_ms at low load"
    assert f"slam-robot1  {line}" in err
    _, _, err = run("profile", "slam-robot1", "--service", "fps")
    assert "slam-robot1 has no sample of fps while its host was nearly idle" in err


def test_the_greatest_of_the_group_is_written_and_nothing_else(site: Path, run: Run) -> None:
    record_samples(site)
    file = site / "tasks" / "tasks.yaml"
    file.chmod(0o640)
    tried = run("profile", "slam-robot1", "--write", "--dry-run")
    assert (tried.code, file.read_text()) == (0, TASKS)
    assert '+    demand: {cpu: 1.9, memory: "256Mi"}' in tried.err
    said = run("profile", "slam-robot1", "--write", "--yes")
    assert said.code == 0
    assert "slam is one entry for slam-robot1, slam-robot2: it gets the maximum of their p95" in said.err
    assert (
        '-    demand: {cpu: 35.2%, memory: "1Gi"}   # guessed\n+    demand: {cpu: 1.9, memory: "256Mi"}   # guessed\n'
        in said.err
    )
    assert file.read_text() == TASKS.replace('{cpu: 35.2%, memory: "1Gi"}', '{cpu: 1.9, memory: "256Mi"}')
    assert file.stat().st_mode & 0o777 == 0o640
    assert run("profile", "slam", "--write", "--yes").err == "tasks/tasks.yaml is up to date\n"
    assert sorted(path.name for path in file.parent.iterdir()) == ["tasks.yaml"]


def test_only_yes_is_a_yes(site: Path) -> None:
    record_samples(site)
    words = ["profile", "slam", "--write"]
    for answer, text in (
        ("no\n", TASKS),
        ("yes\n", TASKS.replace('{cpu: 35.2%, memory: "1Gi"}', '{cpu: 1.9, memory: "256Mi"}')),
    ):
        with Terminal(words, site, env={**os.environ, "TERM": "xterm"}) as terminal:
            terminal.until('Only "yes" is accepted: ')
            terminal.type(answer)
            assert terminal.wait() == (0 if answer == "yes\n" else 1)
        assert (site / "tasks" / "tasks.yaml").read_text() == text


def test_too_few_samples_and_no_terminal_are_refused(site: Path, run: Run) -> None:
    assert run("profile", "slam") == (
        0,
        "",
        "note: no samples yet; let the task run while edgectl probes or watches\n",
    )
    record_samples(site, samples=12)
    said = run("profile", "slam", "--write", "--yes")
    assert (said.code, (site / "tasks" / "tasks.yaml").read_text()) == (1, TASKS)
    assert "error: slam has 12 samples over 1m50s: too few to write a demand" in said.err
    assert "12 of 60" in said.out
    assert run("profile", "slam", "--write").code == 64


def test_a_file_that_changed_meanwhile_is_left_alone(site: Path) -> None:
    from edgectl.cli.user_files import replace_file_text

    file = site / "tasks" / "tasks.yaml"
    with pytest.raises(FileError, match="changed meanwhile"):
        replace_file_text(file, TASKS + "# more\n", "version: 1\n")
    assert file.read_text() == TASKS
    file.write_bytes("\ufeffversion: 1\r\n".encode())
    replace_file_text(file, "version: 1\r\n", "version: 2\r\n")
    assert file.read_bytes() == "\ufeffversion: 2\r\n".encode()
    assert len(list(file.parent.iterdir())) == 1


def test_a_line_with_a_secret_is_not_shown(site: Path, run: Run) -> None:
    file = site / "tasks" / "tasks.yaml"
    flow = "version: 1\ntasks:\n  slam: {for_each: robot, command: run, env: {T: {value: hush, secret: true}}, demand: {cpu: 1, memory: 1}}\n"
    file.write_text(flow)
    record_samples(site)
    said = run("profile", "slam", "--write", "--yes")
    assert said.code == 0
    assert "hush" not in said.err + said.out
    assert "(not shown)" in said.err
    assert file.read_text() == flow.replace("{cpu: 1, memory: 1}", "{cpu: 1.9, memory: 256Mi}")


def test_validate_tells_percent_demands_of_unlike_slices(site: Path, run: Run) -> None:
    assert "percent" not in run("validate").err, "nothing is known of these hosts"
    inventory = site / "inventories" / "lab.yaml"
    inventory.write_text(INVENTORY.replace("{host: a}", "{host: a, capacity: {cpu: 2, memory: 4Gi}}").replace(
        "{host: b}", "{host: b, capacity: {cpu: 4, memory: 4Gi}}"))  # fmt: skip
    said = run("validate")
    assert said.err.splitlines()[-1] == (
        "note: percent demands mean different amounts on unlike hosts: slam cpu 35.2% is 0.70 cores on edge1, 1.41 cores on edge2"
    )
    inventory.write_text(inventory.read_text().replace("cpu: 4", "cpu: 2.5"))
    assert "percent" not in run("validate").err
