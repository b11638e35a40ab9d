# SPDX-License-Identifier: Apache-2.0
"""What people try first, and no other test holds: rows of docs/conventions.md."""

import json
import os
import re
from pathlib import Path

import pytest

from edgectl.cli.completion import complete_revisions
from tests.cli.conftest import Run
from tests.cli.terminal import Terminal
from tests.executor.fake_fleet import FakeFleet
from tests.views.fixtures import ROOT

DEMAND = "demand: {cpu: 0.1, memory: 1Mi, throughput: 0}"
FLEET = "version: 1\nfleet: lab\nedges:\n  edge3: {host: edge3.lab}\n  edge2: {host: edge2.lab}\n  edge1: {host: edge1.lab}\n"
TASKS = f"version: 1\nmin_dwell: 0s\ntasks:\n  zeta: {{command: sleep 9, {DEMAND}}}\n  yak: {{command: sleep 9, {DEMAND}}}\n"


@pytest.fixture
def hosts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> FakeFleet:
    """Three simulated edges of different load on which zeta and yak run, and the files of the fleet."""
    fleet = FakeFleet.of(["edge3", "edge2", "edge1"])
    for used, name in enumerate(("edge3", "edge2", "edge1")):
        fleet[name].used = float(used)
    monkeypatch.setattr("edgectl.transport.fleet_transport.FleetTransport", lambda **_: fleet.transport)
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    for name, text in (("inventories", FLEET), ("tasks", TASKS)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "lab.yaml").write_text(text)
    assert run("apply", "--yes").code == 0
    return fleet


def test_describe_takes_a_kind_in_all_its_forms(hosts: FakeFleet, run: Run) -> None:
    for words in ("edge edge2", "edges edge2", "e edge2", "edge/edge2", "edge edge/edge2"):
        said = run("describe", *words.split(), "-o", "json")
        assert (said.code, json.loads(said.out)["item"]["host"]) == (0, "edge2"), words
    for words in ("task yak", "tasks yak", "t yak", "task/yak"):
        said = run("describe", *words.split(), "-o", "json")
        assert (said.code, json.loads(said.out)["item"]["task"]) == (0, "yak"), words
    named = run("get", "tasks", "-o", "name").out.split()
    assert [run("describe", name).code for name in named] == [0, 0]
    assert run("describe", "edge/edge9").err.startswith("error: unknown edge 'edge9'")


def test_get_takes_a_kind_in_all_its_forms(hosts: FakeFleet, run: Run) -> None:
    edges = "edge/edge1\nedge/edge2\nedge/edge3\n"
    found = {"edges": edges, "hosts": edges, "robots": "", "tasks": "task/yak\ntask/zeta\n", "links": ""}
    for kind, names in found.items():
        for word in (kind, kind.removesuffix("s"), kind[0]):
            assert run("get", word, "-o", "name").out == names, word


def test_the_variables_of_the_environment_stand_in_the_help(run: Run) -> None:
    """Those that this side reads; a task is given its own."""
    read = {
        name
        for part in ("cli", "state", "transport", "config")
        for path in (ROOT / "edgectl" / part).rglob("*.py")
        for name in re.findall(r"\"(EDGECTL_[A-Z_]+)\"", path.read_text())
    }
    assert "EDGECTL_SSH_CONFIG" in read
    text = " ".join(run("--help").out.split())
    read -= {"EDGECTL_TASK_DIR"}
    assert sorted(name for name in read if not re.search(rf"\b{name}\b", text)) == []


def test_state_and_settings_lie_in_the_places_of_xdg(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("EDGECTL_STATE_DIR", raising=False)
    for kind in ("STATE", "CONFIG"):
        monkeypatch.setenv(f"XDG_{kind}_HOME", str(tmp_path / kind))
    (tmp_path / "lab.yaml").write_text(FLEET)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    settings = tmp_path / "CONFIG" / "edgectl" / "config.yaml"
    settings.parent.mkdir(parents=True)
    settings.write_text(
        f"version: 1\ncontext: lab\ncontexts:\n  lab: {{inventory: {tmp_path}/lab.yaml, tasks: {tmp_path}/tasks.yaml}}\n"
    )
    settings.chmod(0o600)
    monkeypatch.chdir(tmp_path)
    rows = json.loads(run("config", "view", "-o", "json").out)["items"]
    assert [row["values"] for row in rows if row["setting"] == "user"] == [[str(settings)]]
    assert run("cordon", "edge2").code == 0
    assert list((tmp_path / "STATE" / "edgectl" / "fleets" / "lab").iterdir())


def test_names_are_taken_as_they_are_printed(hosts: FakeFleet, run: Run) -> None:
    names = run("get", "tasks", "-o", "name").out.split()
    assert names == ["task/yak", "task/zeta"]
    said = run("restart", *names, "--yes", "-o", "name")
    assert (said.code, sorted(said.out.split())) == (0, names), said
    for name in names:
        told = [json.loads(line) for line in run("events", "--task", name, "-o", "jsonl").out.splitlines()]
        assert {f"task/{each['task']}" for each in told} == {name}
    place = f"edge/{hosts.placed['yak']}"
    told = [json.loads(line) for line in run("events", "--host", place, "-o", "jsonl").out.splitlines()]
    assert {f"edge/{each['host']}" for each in told} == {place}
    left = json.loads(run("plan", "--without", place, "-o", "json").out)
    assert f"edge/{next(each['host'] for each in left['decisions'] if each['task'] == 'yak')}" != place
    assert run("events", "--task", "task/yakk").err == "error: unknown task 'yakk'\nhint: did you mean yak?\n"


def test_what_acts_on_tasks_takes_labels(hosts: FakeFleet, run: Run) -> None:
    restarted = run("restart", "-l", "task!=zeta", "--yes", "-o", "name")
    assert (restarted.code, restarted.out) == (0, "task/yak\n")
    stopped = run("stop", "-l", "task=zeta", "--yes", "-o", "name")
    assert (stopped.code, stopped.out, set(hosts.placed)) == (0, "task/zeta\n", {"yak"})
    assert run("wait", "-l", "task=zeta", "--for", "gone", "--every", "100ms").code == 0
    started = run("start", "-l", "task=zeta", "--yes", "-o", "name")
    assert (started.code, started.out, set(hosts.placed)) == (0, "task/zeta\n", {"yak", "zeta"})
    for words in ("stop", "stop --all -l task=zeta", "start", "restart", "wait"):
        assert run(*words.split()).code == 64, words


def test_a_mark_that_is_set_already_is_said_and_no_error(hosts: FakeFleet, run: Run) -> None:
    """Each twice, in an order in which the first one changes something."""
    place = hosts.placed["yak"]
    other = next(name for name in hosts.hosts if name not in hosts.placed.values())
    for words, named, act in (
        ("cordon edge3", "edge/edge3", "cordoned"),
        ("cordon edge3 --drain", "edge/edge3", "cordoned; its tasks leave at the next apply"),
        ("uncordon edge3", "edge/edge3", "uncordoned"),
        (f"move yak {other}", "task/yak", f"pinned to {other}"),
        ("unpin yak", "task/yak", "unpinned"),
        ("done yak", "task/yak", "marked as done"),
        ("reopen yak", "task/yak", "reopened"),
        (f"move yak {place}", "task/yak", f"pinned to {place}"),
    ):
        assert run(*words.split()).out == f"{named} {act}\n", words
        tried = run(*words.split(), "--dry-run")
        assert tried.out == f"{named} {'' if 'reopen' in words else 'already '}{act} (dry run)\n", words
        again = run(*words.split())
        assert (again.code, again.out) == (0, f"{named} already {act}\n"), words
    hosts.down.add(other)
    run("get", "hosts")
    for words, act in ((f"fence {other}", "fenced"), (f"unfence {other}", "unfenced")):
        yes = ["--yes"] if act == "fenced" else []
        assert run(*words.split(), *yes).out == f"edge/{other} {act}\n"
        again = run(*words.split())
        assert (again.code, again.out, again.err) == (0, f"edge/{other} already {act}\n", "")
    timed = run("move", "yak", place, "--for", "1h").out
    assert timed.startswith(f"task/yak pinned to {place} until ")
    assert run("move", "yak", place, "--for", "2h").out != timed, "a time is counted from now"
    mixed = run("cordon", "edge1", "edge2", "edge3").out
    assert mixed == "edge/edge1 cordoned\nedge/edge2 cordoned\nedge/edge3 cordoned\n"
    assert run("uncordon", "edge2").code == 0
    assert run("cordon", "edge3", "edge2").out == "edge/edge3 already cordoned\nedge/edge2 cordoned\n"


def test_a_mark_is_a_document_too(hosts: FakeFleet, run: Run) -> None:
    """Each one changes something, and changes nothing the second time; the words for people stay on stderr."""
    place = hosts.placed["yak"]
    for words, host, task in (
        (["cordon", "edge3", "edge2"], "edge3", None),
        (["uncordon", "edge3", "edge2"], "edge3", None),
        (["move", "yak", place], None, "yak"),
        (["unpin", "yak"], None, "yak"),
        (["done", "yak"], None, "yak"),
        (["reopen", "yak"], None, "yak"),
        (["fence", "edge3", "--yes"], "edge3", None),
        (["unfence", "edge3"], "edge3", None),
    ):
        for dry_run, changed in ((True, True), (False, True), (False, False)):
            said = run(*words, "-o", "json", *["--dry-run"][: int(dry_run)])
            document = json.loads(said.out)
            first = document["items"][0]
            assert (said.code, document["kind"], first["verb"]) == (0, "mark", words[0]), said
            assert (first["host"], first["task"]) == (host, task)
            assert (first["changed"], first["dry_run"]) == (changed, dry_run), words
            if words[0] == "move":
                assert (first["pin"]["pinned_to"], first["decision"]["action"]) == (place, "keep")
                assert said.err.startswith("next apply: keep: pinned to ")
    assert run("cordon", "edge3", "edge2", "-o", "name").out == "edge/edge3\nedge/edge2\n"
    lines = run("uncordon", "edge3", "-o", "csv").out.splitlines()
    assert lines[1].startswith("edge3,")
    assert len(lines) == 2


def test_tab_offers_the_revisions_of_this_fleet(
    hosts: FakeFleet, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    for verb in ("stop", "start"):
        assert run(verb, "yak", "--yes").code == 0
    names = run("history", "-o", "name").out.split()
    assert names == ["revision/1", "revision/2", "revision/3"]
    for line in ("edgectl rollback ", "edgectl show "):
        monkeypatch.setenv("COMP_WORDS", line)
        assert complete_revisions("") == ["3", "2", "1"], "newest first"
        assert complete_revisions("2") == ["2"]


def test_top_is_sorted_and_cut_as_get_is(hosts: FakeFleet, run: Run) -> None:
    order = ["edge3", "edge2", "edge1"]
    said = run("top", "hosts", "--sort-by", "cpu.used_cores")
    assert [line.split()[0] for line in said.out.splitlines()] == ["HOST", *order]
    bare = run("top", "hosts", "--sort-by", "cpu.used_cores", "--no-headers")
    assert [line.split()[0] for line in bare.out.splitlines()] == order
    assert run("top", "--field", "host", "--sort-by", "cpu.used_cores").out.split() == order
    items = json.loads(run("top", "hosts", "--sort-by", "cpu.used_cores", "-o", "json").out)["items"]
    assert [item["host"] for item in items] == order
    places = hosts.placed
    found = run("top", "tasks", "--sort-by", "host", "--field", "task").out.split()
    assert found == sorted(sorted(places), key=lambda task: places[task])
    assert run("top", "tasks", "--no-headers").out.split()[0] == "yak"
    unknown = run("top", "hosts", "--field", "cpu.usd_cores")
    assert (unknown.code, unknown.err) == (
        64,
        "error: unknown key of -o json 'cpu.usd_cores'\nhint: did you mean cpu.used_cores?\n",
    )
    every = run("get", "hosts", "--field", "§")
    assert "cpu.used_cores" in every.err
    assert ".." not in every.err, "all keys are listed, not the first twelve"
    assert run("top", "hosts", "-w", "--field", "host").code == 64


def test_in_ci_nobody_is_asked_even_on_a_terminal(site: Path) -> None:
    for value, asks in (("true", False), ("1", False), ("false", True)):
        with Terminal(["apply"], site, env={**os.environ, "CI": value, "TERM": "xterm"}) as seen:
            if asks:
                seen.until('Only "yes" is accepted: ')
                seen.type("no\n")
            assert seen.wait() == (1 if asks else 64)
            assert ("CI is set: cannot ask for confirmation" in seen.seen) is not asks


def test_v_prints_requests_on_stderr_as_text_or_json(site: Path, run: Run) -> None:
    plain, told = run("get", "edges", "-o", "name"), run("-v", "get", "edges", "-o", "name")
    assert (plain.err, told.out) == ("", plain.out)
    assert re.search(r"edge1.*probe", told.err)
    lines = run("get", "edges", "-o", "name", "-v", "--log-format", "json").err.splitlines()
    assert {"edge1", "edge2", "edge3"} <= {json.loads(line).get("host") for line in lines}


def test_max_moves_and_a_selector_that_leaves_a_task_out(hosts: FakeFleet, run: Run) -> None:
    """Both run where a third host is now far better: with --max-moves 0 none of them goes there by itself."""
    for host in hosts.hosts.values():
        host.used = 0.0 if host.name not in hosts.placed.values() else 3.5
    free = run("plan", "-o", "json")
    moves = [each["task"] for each in json.loads(free.out)["decisions"] if each["action"] == "move"]
    assert moves
    held = json.loads(run("plan", "--max-moves", "0", "-o", "json").out)
    assert [each["task"] for each in held["decisions"] if each["action"] == "move"] == []
    assert (held["options"]["max_moves"], held["options"]["attended"]) == (0, False)
    left = run("plan", "-l", f"task!={moves[0]}", "-o", "json")
    assert re.search(r"other change is left out|other changes are left out", left.err)
    counts = json.loads(run("plan", "-o", "gitlab").out)
    assert counts == {"create": 0, "update": len(moves), "delete": 0}


def test_a_report_of_the_doctor_to_paste(site: Path, run: Run) -> None:
    said = run("doctor", "edge1", "-o", "markdown")
    assert re.match(r"edgectl \d+\.\d+\.\d+, Python 3\.\d+\.\d+, Linux-", said.out)
    assert "<details><summary>All checks</summary>" in said.out
    assert said.out.count("```") == 2


def test_a_comment_silences_a_warning_of_its_line_or_the_line_below(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lab.yaml").write_text(FLEET)

    def list_codes(*lines: str) -> list[str]:
        (tmp_path / "tasks.yaml").write_text(
            "version: 1\ntasks:\n  zeta:\n" + "".join(f"    {line}\n" for line in lines)
        )
        said = run("validate", "-i", "lab.yaml", "-t", "tasks.yaml")
        assert said.code == 0, said.err
        return re.findall(r"warning\[(EC\d+)\]", said.err)

    command, demand = "command: sleep 9 &", DEMAND
    assert list_codes(command, demand) == ["EC106"]
    assert list_codes(f"{command}  # edgectl: ignore EC106", demand) == []
    assert list_codes("# edgectl: ignore EC101, EC106", command, demand) == []
    assert list_codes(f"{command}  # edgectl: ignore EC101", demand) == ["EC106"]
    assert list_codes(command, f"{demand}  # edgectl: ignore EC106") == ["EC106"]
    (tmp_path / "lab.yaml").chmod(0o666)
    (tmp_path / "lab.yaml").write_text("# edgectl: ignore EC104\n" + FLEET)
    assert "EC104" in list_codes(f"{command}  # edgectl: ignore EC106, EC104", demand)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("report nosuch", "error: no run in nosuch: run.json not found\n"),
        ("experiment show nosuch", "error: no run in nosuch: run.json not found\n"),
        (
            "-i X get hosts",
            "error: No such option: -i\nhint: options follow the command: edgectl get -i X hosts\n",
        ),
        (
            "-o json describe edge edge1",
            "error: No such option: -o\nhint: options follow the command: edgectl describe edge -o json edge1\n",
        ),
        (
            "status --sort-by cpu.used_cores",
            (
                "error: No such option: --sort-by\nhint: status is a report of several tables; a list takes it: "
                "edgectl get tasks --sort-by cpu.used_cores\n"
            ),
        ),
        (
            "status --field cpu.used_cores",
            (
                "error: No such option: --field\nhint: status is a report of several tables; a list takes it: "
                "edgectl get tasks --field cpu.used_cores\n"
            ),
        ),
        (
            "status -i X -l robot=robot1",
            (
                "error: No such option: -l\nhint: status is a report of several tables; a list takes it: "
                "edgectl get tasks -i X -l robot=robot1\n"
            ),
        ),
    ],
)
def test_wrong_words_are_answered_with_64_and_the_right_ones(words: str, said: str, run: Run) -> None:
    found = run(*words.split())
    assert found.code == 64
    assert said in found.err or said.splitlines()[0].removeprefix("error: ") in found.err


def test_an_inventory_that_is_no_mapping_is_one_mistake(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    tasks = "".join(f"  t{number}: {{robot: robot1, command: sleep 9, {DEMAND}}}\n" for number in range(5))
    (tmp_path / "tasks.yaml").write_text("version: 1\ntasks:\n" + tasks)
    for text, codes in (
        ("- edge1\n", ["EC010"]),
        ("version: 1\n", ["EC011"]),
        ("version: 1\nedges: {}\n", ["EC011"]),
    ):
        (tmp_path / "lab.yaml").write_text(text)
        said = run("validate", "-i", "lab.yaml", "-t", "tasks.yaml")
        assert (said.code, re.findall(r"error\[(EC\d+)\]", said.err)) == (64, codes), said.err
