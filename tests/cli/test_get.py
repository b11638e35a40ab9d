"""get and top: the commands, on pretend edges of this machine, as a person and as a program see them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.cli.conftest import Run

EDGECTL = [sys.executable, "-m", "edgectl"]


def test_get_lists_what_the_files_state(run: Run, site: Path) -> None:
    said = run("get", "edges")
    assert (said.code, [line.split()[:2] for line in said.out.splitlines()]) == (
        0,
        [["NAME", "STATUS"], ["edge1", "ok"], ["edge2", "ok"], ["edge3", "ok"]],
    )
    assert run("get", "l", "edge1", "-o", "name").out == "link/edge1/robot1\nlink/edge1/robot2\nlink/edge1/robot3\n"
    assert run("get", "task", "-l", "task in (detection, map-merge),task!=map-merge", "-o", "name").out.split() == [
        f"task/detection-robot{number}" for number in (1, 2, 3)
    ]
    items = json.loads(run("get", "tasks", "map-merge", "-o", "json").out)["items"]
    assert [(item["name"], item["state"]) for item in items] == [("map-merge", "not running")]


def test_get_refuses_what_there_is_not(run: Run, site: Path) -> None:
    assert run("get", "edgs").err == "error: unknown kind 'edgs'\nhint: did you mean edges?\n"
    assert run("get", "edges", "edge9").err.startswith("error: unknown edge 'edge9'\nhint: did you mean edge")
    assert run("get", "tasks", "slam-robot7").err.startswith("error: unknown task 'slam-robot7'\nhint: did you mean slam-robot")
    assert run("get", "tasks", "-w", "-o", "yaml").code == 64
    assert run("get", "edges", "-l", "a b").code == 64


def test_get_w_tells_changes_one_object_per_line_and_ends_well(site: Path) -> None:
    words = [*EDGECTL, "get", "edges", "-w", "--every", "0.2s", "-o", "json"]
    with subprocess.Popen(words, cwd=site, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = [json.loads(process.stdout.readline()) for _ in range(3)]
        assert [(line["type"], line["object"]["name"]) for line in first] == [("ADDED", f"edge{number}") for number in (1, 2, 3)]
        subprocess.run([*EDGECTL, "cordon", "edge2"], cwd=site, check=True, stdout=subprocess.DEVNULL, timeout=60)
        changed = json.loads(process.stdout.readline())
        assert (changed["type"], changed["object"]["name"], changed["object"]["closed"]) == ("MODIFIED", "edge2", "cordoned")
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
        assert process.stdout.read() == ""


def test_a_reader_that_goes_away_ends_it(site: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    words = [*EDGECTL, "get", "edges", "-w", "--every", "0.1s"]
    with os.fdopen(writing, "wb") as nobody:
        done = subprocess.run(words, cwd=site, stdout=nobody, stderr=subprocess.PIPE, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, b"")
