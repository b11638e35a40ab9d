# SPDX-License-Identifier: Apache-2.0
"""The commands simulate sweep and simulate merge: shards, files by content, killed processes, Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import psutil
import pytest

from edgectl.experiments.files.sweep_file import load_sweep
from edgectl.experiments.files.sweep_results import select_worlds
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.model.sweep import SchemeRuns, Sweep, SweepBounds, SweepWorld, WorldResult
from edgectl.experiments.sweep_local import simulate_on_cores
from edgectl.experiments.sweep_runs import simulate_world
from edgectl.experiments.views.sweep import SweepView
from edgectl.model.policy import Policy
from tests.builders import a_task, an_edge, an_inventory, some_tasks
from tests.cli.conftest import Run
from tests.views.fixtures import ROOT

SCENARIOS = ROOT / "docs" / "scenarios"
SPEC = """version: 1
name: small
scenario: {scenario}
schemes: {{policies: [static, local], weights: [all]}}
runs: {runs}
vary:
  - robot_cores: [2, 1]
    every: [30s, 25s]
"""
WORLD = SweepWorld(
    settings={"link_ratio": "10"},
    inventory=an_inventory(an_edge("edge1")),
    tasks=some_tasks(a_task("slam")),
    scenario=Scenario(name="", assumptions=(), hosts={}, jobs=()),
    schemes=(Scheme(name="static", policy=Policy()),),
    bounds=SweepBounds(runs=2, seed=1, error=0.05),
    digest="ab" * 32,
)
RESULT = WorldResult(
    digest=WORLD.digest,
    runs=2,
    schemes={"static": SchemeRuns(latency=(10.0, 12.5), handoffs=(0, 1), unplaced=(0, 0), unfinished=1)},
    winner="static",
)
VIEW = SweepView(
    sweep=Sweep(name="small", axes=("link_ratio",), worlds=(WORLD,), bounds=WORLD.bounds),
    results={WORLD.digest: RESULT},
)


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    """Four worlds of two schemes that are quick to simulate."""
    return write_spec(tmp_path / "small.yaml")


def write_spec(path: Path, runs: int = 1) -> Path:
    path.write_text(SPEC.format(scenario=SCENARIOS / "paper-2.yaml", runs=runs))
    return path


def test_a_sweep_without_a_bound_says_why_it_names_no_fastest() -> None:
    world = replace(WORLD, bounds=replace(WORLD.bounds, error=None))
    sweep = replace(VIEW.sweep, worlds=(world,), bounds=world.bounds)
    result = replace(RESULT, winner="")
    text = replace(VIEW, sweep=sweep, results={WORLD.digest: result}).table()
    assert "FASTEST: - everywhere, since the sweep file states no error" in text
    assert "states no error" not in VIEW.table()


def test_shards_make_the_same_bytes_as_one_run(run: Run, spec: Path, tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", [tmp_path / "part2", tmp_path / "part1"]
    said = run("simulate", "sweep", str(spec), "--out", str(whole), "--workers", "1", "-o", "json")
    assert (said.code, said.err) == (0, "")
    for number, part in zip((2, 1), parts, strict=True):
        shard = run(
            "simulate", "sweep", str(spec), "--out", str(part), "--shard", f"{number}/2", "--workers", "2"
        )
        assert (shard.code, shard.out) == (0, "")
        assert "worlds simulated: 2, known: 0" in shard.err
    merged = run("simulate", "merge", str(spec), *map(str, parts), "-o", "json")
    assert (merged.code, merged.out) == (0, said.out)
    names = sorted(path.name for path in whole.iterdir())
    assert names == sorted(path.name for part in parts for path in part.iterdir())
    assert all(
        (whole / path.name).read_bytes() == path.read_bytes() for part in parts for path in part.iterdir()
    )
    worlds = json.loads(said.out)["items"]
    assert [world["settings"] for world in worlds] == [
        {"robot_cores": cores, "every": every} for cores in ("2", "1") for every in ("30s", "25s")
    ]
    _check_that_nothing_is_computed_again(run, spec, whole)


def _check_that_nothing_is_computed_again(run: Run, spec: Path, whole: Path) -> None:
    files = sorted(whole.iterdir())
    before = [path.stat().st_mtime_ns for path in files]
    broken, missing = files[0], files[1]
    broken.write_text("{")
    text = missing.read_bytes()
    missing.unlink()
    lacking = run("simulate", "merge", str(spec), str(whole))
    assert lacking.code == 1
    assert "of 4 worlds have no result" in lacking.err
    assert run("simulate", "sweep", str(spec), "--out", str(whole), "--workers", "1").code == 0
    assert missing.read_bytes() == text
    assert [path.stat().st_mtime_ns for path in files[2:]] == before[2:]


def test_a_world_has_the_same_name_however_it_is_written(tmp_path: Path, spec: Path) -> None:
    other = tmp_path / "other.yaml"
    text = spec.read_text().replace("[2, 1]", "[2000m, 1.0]").replace("name: small", "name: other")
    other.write_text(text)
    digests = [world.digest for world in load_sweep(spec).worlds]
    assert [world.digest for world in load_sweep(other).worlds] == digests
    other.write_text(text.replace("runs: 1", "runs: 2"))
    assert not {world.digest for world in load_sweep(other).worlds} & set(digests)


def test_a_setting_that_a_policy_does_not_read_makes_no_new_world(tmp_path: Path) -> None:
    path = tmp_path / "margins.yaml"
    path.write_text(
        f"version: 1\nname: m\nscenario: {SCENARIOS / 'paper-2.yaml'}\nschemes: {{policies: [local]}}\n"
        "vary: [{margin: [0.2, 0], dwell: [30s, 0s]}]\n"
    )
    worlds = load_sweep(path).worlds
    assert (len(worlds), len(select_worlds(worlds))) == (4, 1)


def test_shards_are_disjoint_and_complete(spec: Path) -> None:
    worlds = load_sweep(spec).worlds
    for count in (1, 2, 3, 7):
        parts = [select_worlds(worlds, (number, count)) for number in range(1, count + 1)]
        assert sorted(world.digest for part in parts for world in part) == sorted(w.digest for w in worlds)


def test_a_killed_process_is_reported_and_its_world_made_again(tmp_path: Path) -> None:
    short = load_sweep(write_spec(tmp_path / "short.yaml")).worlds[:2]
    long = load_sweep(write_spec(tmp_path / "long.yaml", runs=40)).worlds[0]
    worlds = [short[0], long, short[1]]
    reports: list[str] = []
    results = simulate_on_cores(worlds, 2, reports.append)
    found = [next(results)]
    assert found[0].digest == short[0].digest
    os.kill(find_busy_child().pid, signal.SIGKILL)
    found += results
    assert sorted(result.digest for result in found) == sorted(world.digest for world in worlds)
    assert ["was killed by SIGKILL" in report for report in reports] == [True]
    expected = {world.digest: simulate_world(world) for world in worlds}
    assert {result.digest: result for result in found} == expected


def find_busy_child() -> psutil.Process:
    """The process of this one that has used most CPU since the call; it is waited for."""
    children = [psutil.Process(child.pid) for child in active_children()]
    before = [child.cpu_times().user for child in children]

    def list_used() -> list[float]:
        return [child.cpu_times().user - was for child, was in zip(children, before, strict=True)]

    assert wait_until(lambda: max(list_used()) > 0.05)
    return children[list_used().index(max(list_used()))]


def wait_until(holds: Callable[[], bool], seconds: float = 60.0) -> bool:
    """Whether it holds within this time."""
    end = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def test_ctrl_c_ends_all_processes_and_keeps_what_is_finished(tmp_path: Path) -> None:
    spec, out = write_spec(tmp_path / "long.yaml", runs=60), tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "edgectl",
        "simulate",
        "sweep",
        str(spec),
        "--out",
        str(out),
        "--workers",
        "2",
    ]
    program = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=tmp_path
    )
    try:
        manager = psutil.Process(program.pid)
        assert wait_until(lambda: len(manager.children(recursive=True)) >= 2)
        children = manager.children(recursive=True)
        assert wait_until(lambda: any(out.glob("*.json")), 120)
        os.killpg(program.pid, signal.SIGINT)
        _, said = program.communicate(timeout=60)
    finally:
        if program.poll() is None:
            os.killpg(program.pid, signal.SIGKILL)
    assert program.returncode == 130
    assert "Traceback" not in said
    assert wait_until(lambda: not any(child.is_running() for child in children))
    assert all(json.loads(path.read_text())["runs"] == 60 for path in out.glob("*.json"))


@pytest.mark.parametrize(
    ("change", "place", "message", "hint"),
    [
        (("every", "evry"), "8:5", "unknown key evry in a block of vary", "did you mean every?"),
        (("[2, 1]", "[2, -1]"), "7:22", "must be", "write"),
        (("[2, 1]", "[]"), "7:18", "no values of robot_cores", "write a value, or remove it"),
        (("every: [30s, 25s]", "link_ratio: [0.5]"), "8:18", "must be a number from 1", "write 10 for a tenth"),
        (("runs: 1", "error: 60%"), "5:8", "must be above 0% and at most 50%, not 60%", "write 5%"),
        (("paper-2.yaml", "paper-9.yaml"), "3:11", "file not found", "name a scenario file, relative to this file"),
        (("static", "statik"), "4:22", "unknown word 'statik'", "did you mean static?"),
    ],
)  # fmt: skip
def test_a_fault_has_its_place_and_a_hint(
    run: Run, spec: Path, change: tuple[str, str], place: str, message: str, hint: str
) -> None:
    spec.write_text(spec.read_text().replace(*change))
    said = run("simulate", "sweep", str(spec), "--out", str(spec.parent / "out"))
    assert said.code == 64
    assert f"{spec}:{place}" in said.err
    assert message in said.err
    assert hint in said.err
    assert "^" in said.err


@pytest.mark.parametrize("shard", ["0/2", "3/2", "x", "1/2/3", "-1/2"])
def test_a_shard_that_there_is_not_is_refused(run: Run, spec: Path, shard: str) -> None:
    said = run("simulate", "sweep", str(spec), f"--shard={shard}")
    assert (said.code, "write 1/4 for the first of four" in said.err) == (64, True)
