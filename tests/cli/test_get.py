# SPDX-License-Identifier: Apache-2.0
"""get and top on local edges of this machine, in tables and in machine-readable formats."""

import json
import os
import re
import signal
import subprocess
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.cli.terminal import Terminal
from tests.forkserver import ForkedProcess, run_edgectl

HOSTS = ["edge1", "edge2", "edge3", "robot1", "robot2", "robot3"]


def test_get_lists_what_the_files_state(run: Run, site: Path) -> None:
    said = run("get", "edges")
    assert (said.code, [line.split()[:2] for line in said.out.splitlines()]) == (
        0,
        [["HOST", "STATUS"], ["edge1", "ok"], ["edge2", "ok"], ["edge3", "ok"]],
    )
    assert (
        run("get", "l", "edge1", "-o", "name").out
        == "link/edge1/robot1\nlink/edge1/robot2\nlink/edge1/robot3\n"
    )
    assert run(
        "get", "task", "-l", "task in (detection, map-merge),task!=map-merge", "-o", "name"
    ).out.split() == [f"task/detection-robot{number}" for number in (1, 2, 3)]
    items = json.loads(run("get", "tasks", "map-merge", "-o", "json").out)["items"]
    assert [(item["task"], item["state"]) for item in items] == [("map-merge", "not running")]


def test_get_refuses_what_there_is_not(run: Run, site: Path) -> None:
    assert run("get", "edgs").err == "error: unknown kind 'edgs'\nhint: did you mean edges?\n"
    assert run("get", "edges", "edge9").err.startswith("error: unknown edge 'edge9'\nhint: did you mean edge")
    assert run("get", "tasks", "slam-robot7").err.startswith(
        "error: unknown task 'slam-robot7'\nhint: did you mean slam-robot"
    )
    assert run("get", "tasks", "-w", "-o", "yaml").code == 64
    assert run("get", "tasks", "--every", "x").code == run("top", "tasks", "--every", "x").code == 64
    assert run("get", "edges", "-l", "a b").code == 64
    assert (
        run("get", "edges", "-w", "--every", "0").err
        == "error: --every 0 is too short\nhint: write 100ms or more\n"
    )
    assert (
        run("describe").err == "error: missing subcommand: describe edge, describe robot, describe task\n"
        "hint: run edgectl describe edge, robot or task\n"
    )


def test_hosts_are_asked_without_a_task_file(run: Run, site: Path) -> None:
    """The first question of a new user: do my hosts answer?"""
    (site / "tasks" / "demo.yaml").unlink()
    (site / "inventories" / "local.yaml").write_text(
        "version: 1\nedges: {edge1: {connection: local}}\nrobots: {robot1: {host: 127.0.0.1, probe: false}}\n"
    )
    for words in (("probe",), ("get", "links"), ("top",)):
        said = run(*words)
        assert said.code == 0, said
        assert "edge1" in said.out or "robot1" in said.out
    assert "edge1" in run("doctor", "-o", "json").out
    trust = run("trust", "edge1")
    assert (trust.code, trust.out) == (0, "")
    assert "no host here has a host key" in trust.err
    (site / "tasks" / "a.yml").touch()
    (site / "tasks" / "b.yml").touch()
    assert run("get", "edges").code == 0, "which of two is meant does not matter here"
    assert run("get", "tasks").code == 64


def test_what_to_write_where_only_the_tasks_are_missing(run: Run, site: Path) -> None:
    (site / "tasks" / "demo.yaml").unlink()
    assert run("plan").err == (
        "error: no task file given, and there is none in tasks/\n"
        "hint: pass -t FILE, or write tasks/local.yaml\n"
    )


def test_get_w_tells_changes_one_object_per_line_and_ends_well(site: Path) -> None:
    words = ["get", "edges", "-w", "--every", "0.2s", "-o", "json"]
    with ForkedProcess(words, cwd=site, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        first = [json.loads(process.stdout.readline()) for _ in range(3)]
        assert [(line["type"], line["object"]["host"]) for line in first] == [
            ("ADDED", f"edge{number}") for number in (1, 2, 3)
        ]
        run_edgectl("cordon", "edge2", cwd=site).check_returncode()
        changed = next(line for line in map(json.loads, process.stdout) if line["object"]["host"] == "edge2")
        assert (changed["type"], changed["object"]["mark"]) == ("MODIFIED", "cordoned")
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


def test_a_reader_that_goes_away_ends_it(site: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    words = ["get", "edges", "-w", "--every", "0.1s"]
    with os.fdopen(writing, "wb") as nobody:
        done = run_edgectl(*words, cwd=site, stdout=nobody)
    assert (done.returncode, done.stderr) == (0, "")


def test_top_shows_every_host_and_no_task(run: Run, site: Path) -> None:
    assert [line.split()[0] for line in run("top", "hosts").out.splitlines()] == ["HOST", *HOSTS]
    assert run("top", "tasks") == (0, "", "note: 10 of 10 tasks do not run: edgectl status\n")
    document = json.loads(run("top", "hosts", "-o", "json").out)
    assert [len(host["history"]) for host in document["items"]] == [3] * 6, "one sample of each look"
    assert run("top", "hosts", "-w", "-o", "yaml").code == 64
    said = run("top", "hosts", "--interactive")
    assert (said.code, said.err.splitlines()[0]) == (64, "error: stdout is not a terminal")


def test_top_w_gives_programs_one_object_per_host_and_probe(site: Path) -> None:
    words = ["top", "hosts", "-w", "--every", "0.1s", "-o", "json"]
    with ForkedProcess(words, cwd=site, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        lines = [json.loads(process.stdout.readline()) for _ in range(3 * len(HOSTS))]
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
    assert [len(line["history"]) for line in lines if line["host"] == "edge1"] == [1, 2, 3]
    assert len({line["taken_at"] for line in lines}) == 3


@pytest.mark.parametrize("end", ["q", "SIGINT", "SIGTERM"])
def test_top_w_draws_in_place_and_leaves_the_terminal_as_it_was(site: Path, end: str) -> None:
    env = {**os.environ, "TERM": "xterm", "LC_ALL": "C.UTF-8"}
    with Terminal(["top", "hosts", "-w", "--every", "0.2s"], site, env=env) as terminal:
        terminal.until("\x1b[?1049h")
        for _ in range(2):
            terminal.seen = terminal.seen.replace("\x1b[H", "", 1)
            terminal.until("\x1b[J")
            terminal.until("\x1b[H")
        terminal.type(end) if end == "q" else terminal.process.send_signal(signal.Signals[end])
        assert terminal.wait() == 0
        shown, _, after = terminal.seen.rpartition("\x1b[?25h\x1b[?1049l")
        assert "robot3" in shown
        fleet, heading, *_ = re.sub(r"\x1b\[\d+m", "", after).splitlines()
        assert fleet.startswith("Fleet demo-")
        assert heading.split()[:2] == ["HOST", "STATUS"], "the last look stays"


@pytest.mark.parametrize("words", ["get edges -w", "events -w"])
def test_a_watched_list_names_its_fleet_once(site: Path, words: str) -> None:
    env = {**os.environ, "TERM": "xterm", "NO_COLOR": "1"}
    run_edgectl("probe", cwd=site).check_returncode()
    with Terminal(words.split(), site, env=env) as terminal:
        terminal.until("edge3" if "get" in words else "Fleet demo-")
        terminal.process.send_signal(signal.SIGINT)
        assert terminal.wait() == 0
        assert len(re.findall(r"^Fleet demo-[0-9a-f]+\r?$", terminal.seen, re.MULTILINE)) == 1


def test_describe_ends_with_the_last_events(run: Run, site: Path) -> None:
    text = run("describe", "edge", "edge1").out
    assert text.startswith("Name: ")
    assert "\nCapacity:      0.30 cores, 512.0Mi (declared)\n" in text
    assert text.endswith("\nEvents: none\n")
    assert json.loads(run("describe", "robot", "robot1", "-o", "json").out)["item"]["host"] == "robot1"
    assert (
        "\nState:        not running\nDecision:     start: "
        in run("describe", "task", "detection-robot1").out
    )
    assert run("describe", "edge", "robot1").err.startswith("error: unknown edge 'robot1'\n")
    assert run("describe", "task", "slam-robot9").err.startswith(
        "error: unknown task 'slam-robot9'\nhint: did you mean slam-robot"
    )


def test_get_hosts_and_all(run: Run, site: Path) -> None:
    said = run("get", "hosts")
    rows = [line.split() for line in said.out.splitlines()]
    assert [row[0] for row in rows] == ["HOST", *HOSTS]
    assert rows[0][-2:] == ["ROLE", "LABELS"]
    assert [row[-2] for row in rows[1:]] == ["edge"] * 3 + ["robot"] * 3
    every = run("get", "all", "-o", "json")
    kinds = [item["kind"] for item in json.loads(every.out)["items"]]
    assert {kind: kinds.count(kind) for kind in kinds} == {"edge": 3, "robot": 3, "task": 10, "link": 9}
    headings = [line.split()[0] for line in run("get", "all").out.split("\n\n")]
    assert headings == ["HOST", "TASK", "EDGE"]
    assert run("get", "all", "edge1").code == run("get", "all", "--field", "host").code == 64


def test_one_field_sorting_and_no_headings(run: Run, site: Path) -> None:
    """Names sort as people sort them, and what lacks the key comes last."""
    assert run("get", "robots", "--field", "host").out == "robot1\nrobot2\nrobot3\n"
    assert run("get", "robots", "--field", "cpu.capacity_cores").out == "0.1\n" * 3
    assert run("get", "tasks", "task/map-merge", "--field", "host").out == "-\n"
    wrong = run("get", "edges", "--field", "cpu.capacity_core")
    assert (wrong.code, wrong.err) == (
        64,
        "error: unknown key of -o json 'cpu.capacity_core'\nhint: did you mean cpu.capacity_cores?\n",
    )
    assert "no single value" in run("get", "edges", "--sort-by", "cpu").err
    found = run("get", "hosts", "--sort-by", "memory.capacity_bytes", "-o", "name").out.split()
    assert [name.partition("/")[0] for name in found] == ["robot"] * 3 + ["edge"] * 3
    rows = run("get", "hosts", "--no-headers", "--sort-by", "host").out.splitlines()
    assert [row.split()[0] for row in rows] == HOSTS


def test_selectors_know_what_follows_from_the_files_and_the_state(run: Run, site: Path) -> None:
    def named(*words: str) -> list[str]:
        return run("get", *words, "-o", "name").out.split()

    assert named("tasks", "-l", "robot=robot2") == [
        "task/detection-robot2",
        "task/map-merge",
        "task/navigation-robot2",
        "task/slam-robot2",
    ]
    assert named("tasks", "-l", "robot=robot2,task!=detection,robot notin (robot3)") == [
        "task/navigation-robot2",
        "task/slam-robot2",
    ]
    assert named("tasks", "-l", "host") == []
    assert len(named("tasks", "-l", "kind=service,state=not-running")) == 10
    assert named("hosts", "-l", "kind=robot,state=ok,host!=robot1") == ["robot/robot2", "robot/robot3"]
    assert named("links", "-l", "robot=robot1,host in (edge1,edge3)") == [
        "link/edge1/robot1",
        "link/edge3/robot1",
    ]
    assert named("tasks", "detection") == [f"task/detection-robot{number}" for number in (1, 2, 3)]


def test_names_as_they_are_printed_are_taken_back(run: Run, site: Path) -> None:
    for kind in ("hosts", "edges", "robots", "tasks", "links"):
        names = run("get", kind, "-o", "name").out.split()
        assert run("get", kind, *names, "-o", "name").out.split() == names
