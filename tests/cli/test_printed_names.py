# SPDX-License-Identifier: Apache-2.0
"""What -o name prints goes into every verb that takes names, as many as it takes, as xargs passes them on."""

import json
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from typer.main import get_command

from edgectl.cli.app import COMMANDS, build_app_with_commands
from edgectl.transport.fake import FakeTransport
from tests.cli.conftest import Run
from tests.cli.test_matrix import HOSTS, INVENTORY, TASKS, answer
from tests.executor.fake_fleet import FakeFleet

# The verbs in an order in which each finds what it acts on; {} stands for the names. Hosts, then tasks, then revisions.
HOST_VERBS = {
    "describe edge": "describe edge {}",
    "describe robot": "describe robot {}",
    "doctor": "doctor {} --timeout 5s",
    "trust": "trust {} --dry-run",
    "profilers start": "profilers start {}",
    "profilers status": "profilers status {}",
    "profilers stop": "profilers stop {} --dry-run",
    "counters install": "counters install {}",
    "counters show": "counters show {}",
    "counters remove": "counters remove {}",
    "cordon": "cordon {}",
    "uncordon": "uncordon {}",
    "drain": "drain {} --dry-run",
    "unfence": "unfence {}",
}
TASK_VERBS = {
    "describe task": "describe task {}",
    "wait": "wait {}",
    "logs": "logs {} --prefix",
    "stop": "stop {} --yes",
    "start": "start {} --yes",
    "restart": "restart {} --yes",
    "unpin": "unpin {}",
    "done": "done {}",
    "reopen": "reopen {}",
}
# They take one, or one of each kind: {task} and {host}.
SINGLE_VERBS = {
    "explain": "explain {task}",
    "profile": "profile {task}",
    "move": "move {task} {host}",
    "exec": "exec {task} --dry-run -- true",
    "fence": "fence {host} --dry-run",
    "ssh": "ssh {host} --dry-run -- true",
}
EDGES_ALONE = {"counters install", "counters show", "counters remove"}
# No host listens for SSH, and no profiler lives: both are said of the hosts that were meant.
CODES = {"trust": 4, "profilers start": 4}


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> FakeFleet:
    """The fleet of the matrix: three edges and a robot, on which zeta and nav run."""
    fleet = FakeFleet.of(HOSTS)
    transport = FakeTransport({name: partial(answer, host) for name, host in fleet.hosts.items()})
    monkeypatch.setattr("edgectl.transport.fleet_transport.FleetTransport", lambda **_: transport)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    for name, text in (("inventories", INVENTORY), ("tasks", TASKS)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "lab.yaml").write_text(text)
    assert run("apply", "--yes").code == 0
    return fleet


def list_names(run: Run, kind: str) -> list[str]:
    return run("get", kind, "-o", "name").out.split()


def test_every_verb_that_takes_names_is_tried() -> None:
    command = get_command(build_app_with_commands(list(COMMANDS)))
    taking = set()
    for name in COMMANDS:
        found = command
        for word in name.split():
            found = found.commands[word]  # type: ignore[attr-defined]
        words = [str(each.metavar) for each in found.params if each.param_type_name == "argument"]
        if any(re.fullmatch(r"\[?(TASK|HOST|NAME)(\.\.\.)?\]?", word) for word in words):
            taking.add(name)
    tried = HOST_VERBS.keys() | TASK_VERBS.keys() | SINGLE_VERBS.keys()
    # Below, with names of its own.
    assert taking == tried | {"get", "config use-context"}


def test_verbs_of_many_names_take_them_as_they_are_printed(lab: FakeFleet, run: Run) -> None:
    edges, tasks = list_names(run, "edges"), list_names(run, "tasks")
    hosts = list_names(run, "hosts")
    assert hosts == ["edge/edge1", "edge/edge2", "edge/edge3", "robot/robot1"]
    assert tasks == ["task/big", "task/nav", "task/zeta"]
    for verbs, names in ((HOST_VERBS, hosts), (TASK_VERBS, tasks)):
        for verb, words in verbs.items():
            given = edges if verb in EDGES_ALONE else [name for name in names if name != "task/big"]
            said = run(*words.replace("{}", " ".join(given)).split())
            assert said.code == CODES.get(verb, 0), (verb, said)
            assert "unknown" not in said.err.replace("name unknown", ""), (verb, said)
            if verb == "drain":  # no edge is left to which a task could go, so nothing is sent
                continue
            told = said.out + said.err
            assert [name for name in given if name.partition("/")[2] not in told] == [], (verb, said)
    assert lab.placed.keys() == {"nav", "zeta"}


def test_verbs_of_one_name_take_it_and_say_how_many_are_given(lab: FakeFleet, run: Run) -> None:
    here = f"edge/{lab.placed['zeta']}"
    for verb, words in SINGLE_VERBS.items():
        said = run(*words.format(task="task/zeta", host=here).split())
        assert said.code == 0, (verb, said)
        if "--" in words.split():
            continue
        many = run(*words.format(task="task/zeta", host=f"{here} task/nav").split(), "task/big")
        assert many.code == 64, (verb, many)
        takes = {"move": "one TASK and one HOST", "fence": "one HOST"}.get(verb, "one TASK")
        first = takes.split()[1]
        call = f"edgectl {verb} {takes.replace('one ', '').replace('and ', '')}"
        assert many.err.endswith(
            f"hint: edgectl {verb} takes {takes}; for several: xargs -I {first} {call}\n"
        ), many


def test_what_other_lists_print_goes_back_too(lab: FakeFleet, run: Run) -> None:
    for kind in ("hosts", "edges", "robots", "tasks", "links"):
        names = list_names(run, kind)
        assert names
        assert names == run("get", kind, *names, "-o", "name").out.split()
    assert run("get", "all", "-o", "name").out.split()[0] == "edge/edge1"
    revisions = run("history", "-o", "name").out.split()
    assert revisions == ["revision/1"]
    assert run("show", *revisions).code == 0
    assert run("rollback", *revisions, "--dry-run").code == 0
    assert run("rollback", "first").err == (
        "error: 'first' is not a revision\nhint: list their numbers: edgectl history\n"
    )
    assert run("profilers", "status", "profiler/edge2").out.split("\n")[1].split()[0] == "edge2"
    assert run("describe", *run("trust", "--all", "--dry-run", "-o", "name").out.split()).code == 0


def test_several_are_described_one_after_the_other(lab: FakeFleet, run: Run) -> None:
    names = [*list_names(run, "hosts"), *list_names(run, "tasks")]
    alone = {name: run("describe", name) for name in names}
    assert {said.code for said in alone.values()} == {0}
    together = run("describe", *names)
    assert together.code == 0
    parts = together.out.split("\n\n\n")
    assert [part.splitlines()[0].split() for part in parts] == [
        ["Name:", name.partition("/")[2]] for name in names
    ]
    found = json.loads(run("describe", *names, "-o", "json").out)
    assert (found["kind"], found.keys()) == ("details", {"format_version", "kind", "items", "warnings"})
    named = [
        f"{item['kind']}/{item['task' if item['kind'] == 'task' else 'host']}" for item in found["items"]
    ]
    assert named == names
    lines = run("describe", *names, "-o", "jsonl").out.splitlines()
    assert [json.loads(line)["kind"] for line in lines] == [name.partition("/")[0] for name in names]
    twice = json.loads(run("describe", "task", "zeta", "task/zeta", "-o", "json").out)
    assert (twice["kind"], twice["item"]["task"]) == ("task", "zeta")


def test_unknown_names_are_said_at_once(lab: FakeFleet, run: Run) -> None:
    said = "error: unknown tasks 'zetta', 'naw'\nhint: did you mean zeta for zetta, nav for naw?\n"
    for words in (
        "describe task",
        "stop --yes",
        "start --yes",
        "restart --yes",
        "wait",
        "done",
        "reopen",
        "unpin",
    ):
        assert run(*words.split(), "zetta", "zeta", "naw") == (64, "", said), words
    hosts = "error: unknown hosts 'egde2', 'robot9'\nhint: did you mean edge2 for egde2, robot1 for robot9?\n"
    for words in ("cordon", "uncordon", "drain --yes", "doctor", "profilers start", "trust --yes"):
        assert run(*words.split(), "egde2", "edge1", "robot9") == (64, "", hosts), words
    assert run("describe", "edge/edge1", "edge/egde2", "robot/robot2").err == (
        "error: unknown edge 'egde2'\nhint: did you mean edge2?\n"
    )
    assert run("describe", "edge/edge1", "link/edge1/robot1").err == (
        "error: describe takes edges, robots and tasks, not link/edge1/robot1\n"
        "hint: edgectl get links edge1/robot1 -o json\n"
    )
    assert run("describe", "pod/x").err == (
        "error: unknown kind 'pod'\nhint: known: edge, robot, task, host\n"
    )


def test_the_installed_command_behind_xargs(tmp_path: Path) -> None:
    """The pipe of the shell itself, on two local edges."""
    command = shutil.which("edgectl", path=str(Path(sys.executable).parent))
    assert command is not None
    local = "{host: 127.0.0.1, connection: local, capacity: {cpu: 1, memory: 1Gi}}"
    (tmp_path / "inventories").mkdir()
    (tmp_path / "inventories" / "lab.yaml").write_text(
        f"version: 1\nfleet: lab\nedges:\n  edge2: {local}\n  edge1: {local}\n"
    )
    done = subprocess.run(
        ["sh", "-c", f"'{command}' get edges -o name | xargs '{command}' describe"],
        cwd=tmp_path,
        env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "EDGECTL_STATE_DIR": str(tmp_path / "state")},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert re.findall(r"^Name: +(\w+)$", done.stdout, re.MULTILINE) == ["edge1", "edge2"]
