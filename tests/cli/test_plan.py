# SPDX-License-Identifier: Apache-2.0
"""plan from a snapshot, show, and their options: no host is contacted."""

import io
import json
import os
import shutil
import sys
from pathlib import Path

import pytest

from edgectl.model.resource import SPARE_TERMS, TERMS
from tests.cli.conftest import Run

PLAN = ("plan", "--snapshot", "snap.json")


def mark_unreachable(site: Path, host: str) -> None:
    document = json.loads((site / "snap.json").read_text())
    document["hosts"][host] = {"role": "edge", "status": "unreachable", "error": "no route"}
    (site / "snap.json").write_text(json.dumps(document))


def test_the_same_files_give_the_same_bytes(run: Run, site: Path) -> None:
    first = run(*PLAN, "-o", "json")
    assert first.code == 0
    assert first.err == ""
    assert run(*PLAN, "-o", "json") == first


def test_nothing_is_written_and_no_state_is_made(run: Run, site: Path, isolated: Path) -> None:
    shutil.rmtree(isolated / "state")
    before = sorted(site.rglob("*"))
    run(*PLAN)
    assert sorted(site.rglob("*")) == before
    assert not (isolated / "state").exists()


def test_detailed_exit_codes(run: Run, site: Path) -> None:
    assert run(*PLAN).code == 0
    assert run(*PLAN, "--detailed-exitcode").code == 2
    assert run(*PLAN, "--target", "slam-robot1", "--detailed-exitcode").code == 0


def test_an_unplaced_task_beats_pending_changes(run: Run, site: Path) -> None:
    tasks = site / "tasks" / "demo.yaml"
    tasks.write_text(tasks.read_text() + "  huge: {command: 'true', demand: {cpu: 64}}\n")
    said = run(*PLAN, "--detailed-exitcode")
    assert said.code == 3
    assert "unplaced: 0/3 hosts fit: 3 short of cpu (need 64.000 cores" in said.out


def test_a_silent_host_beats_everything_unless_allowed(run: Run, site: Path) -> None:
    mark_unreachable(site, "edge3")
    said = run(*PLAN, "--detailed-exitcode")
    assert said.code == 4
    assert run(*PLAN).code == 4
    assert "note: edge3 does not answer: no route" in said.err
    assert run(*PLAN, "--allow-unreachable").code == 0
    assert run(*PLAN, "--allow-unreachable", "--detailed-exitcode").code == 2


def test_a_saved_plan_is_shown_as_it_was_printed(run: Run, site: Path) -> None:
    printed = run(*PLAN, "--out", "next.plan", "-o", "wide")
    assert printed.err.startswith(
        "saved next.plan; apply it with: edgectl apply next.plan\nnote: slam-robot1 "
    )
    # A plan holds no commands, so it does not know what a move takes along; the first line has the age.
    parts = [part for part in printed.out.split("\n\n") if not part.startswith("State that moves transfer")]
    assert run("show", "next.plan", "-o", "wide").out.splitlines()[1:] == "\n\n".join(parts).splitlines()[1:]
    assert run("show", "next.plan", "--detailed-exitcode").code == 2
    assert (site / "next.plan").read_text() == run(*PLAN, "-o", "json").out


def give_stdin(monkeypatch: pytest.MonkeyPatch, data: bytes) -> None:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(data)))


def test_documents_come_from_standard_input(run: Run, site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    snapshot = (site / "snap.json").read_bytes()
    for words in (["plan", "-o", "json"], ["explain", "slam-robot1"], ["graph"]):
        printed = run(*words, "--snapshot", "snap.json")
        give_stdin(monkeypatch, snapshot)
        assert run(*words, "--snapshot", "-") == printed, words
    run(*PLAN, "--out", "next.plan")
    for form in ("table", "wide", "markdown", "json", "name"):
        give_stdin(monkeypatch, (site / "next.plan").read_bytes())
        assert run("show", "-", "-o", form) == run("show", "next.plan", "-o", form)
    give_stdin(monkeypatch, (site / "next.plan").read_bytes())
    assert run("apply", "-", "--target", "slam-robot1").err.startswith("error: - is a saved plan: ")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "error[EC201]: -:1:1: not JSON: Expecting value\nhint: write it again: edgectl plan -o json\n"),
        (b'{"hosts": {}}', "hint: plan from it: edgectl plan --snapshot -\n"),
        (b"\xff", "error[EC002]: -:1:1: byte 0xff is not UTF-8"),
        (b"[", "edgectl plan -o json"),
        (b" " * 100, "error[EC003]: -: the file is larger than 0 MiB"),
    ],
)
def test_what_is_no_plan_on_standard_input(
    run: Run, site: Path, monkeypatch: pytest.MonkeyPatch, data: bytes, said: str
) -> None:
    monkeypatch.setattr("edgectl.config.documents.MAX_DOCUMENT_BYTES", 99)
    give_stdin(monkeypatch, data)
    shown = run("show", "-")
    assert (shown.code, shown.out) == (64, "")
    assert said in shown.err


def test_a_saved_plan_names_its_fleet_and_another_fleet_refuses_it(run: Run, site: Path) -> None:
    run(*PLAN, "--out", "next.plan")
    inventory = site / "inventories" / "local.yaml"
    name = json.loads((site / "next.plan").read_text())["fleet"]
    assert f"fleet: {name}\n" in inventory.read_text()
    for form in ("table", "wide"):
        assert run("show", "next.plan", "-o", form).out.startswith(f"Fleet {name}, weights ")
    assert f"\nFleet {name}, weights " in run("show", "next.plan", "-o", "markdown").out
    inventory.write_text(inventory.read_text().replace(f"fleet: {name}\n", "fleet: hall\n"))
    assert run("apply", "next.plan", "--dry-run") == (
        75,
        "",
        (
            f"error: saved plan is stale; since it was made:\n  it is of fleet {name}, this is hall\n"
            "hint: make a new plan: edgectl plan --out PLAN\n"
        ),
    )
    raw = json.loads((site / "next.plan").read_text())
    del raw["fleet"]
    (site / "next.plan").write_text(json.dumps(raw))
    assert run("show", "next.plan").out.startswith("Weights "), "as an earlier release saved it"
    (site / "next.plan").write_text(json.dumps(raw | {"fleet": "\x1b[2J"}))
    assert "\x1b" not in run("show", "next.plan").out


def test_a_plan_that_cannot_be_saved_is_an_error(run: Run, site: Path) -> None:
    said = run(*PLAN, "--out", "no/such/dir/next.plan")
    assert (said.code, said.out) == (1, "")
    assert said.err == "error: cannot write no/such/dir/next.plan: No such file or directory\n"


def test_target_and_selector_choose_what_is_done(run: Run, site: Path) -> None:
    said = run(*PLAN, "--target", "detection-robot2")
    assert "1 left out." in said.out
    assert said.out.endswith("Plan: 0 to start, 0 to move, 0 to stop, 9 kept, 0 unplaced, 1 left out.\n")
    assert said.err.startswith("warning: 1 other change is left out, although this plan depends on it\n")
    assert "1 to move" in run(*PLAN, "-l", "task=detection").out
    assert "1 left out" in run(*PLAN, "-l", "task!=detection").out


def test_without_asks_what_if(run: Run, site: Path) -> None:
    document = json.loads(run(*PLAN, "--without", "edge1", "-o", "json").out)
    moved = {step["task"] for step in document["decisions"] if step["action"] == "move"}
    assert moved == {"detection-robot1", "navigation-robot1"}


def test_policy_and_weights_stand_in_the_plan(run: Run, site: Path) -> None:
    document = json.loads(
        run(
            *PLAN,
            "--policy",
            "paper",
            "--weights",
            "cpu=1,network=3",
            "--best-effort",
            "--full",
            "-o",
            "json",
        ).out
    )
    assert document["policy"] == "paper"
    unasked = dict.fromkeys((term for term in TERMS if term not in SPARE_TERMS), 0)
    assert document["weights"] == unasked | {"cpu": 0.25, "network": 0.75}
    assert document["options"]["best_effort"] is True


@pytest.mark.parametrize(
    ("words", "error", "hint"),
    [
        (("--weights", "cpu=-1"), "--weights: weight cpu must be a finite number", "write one of cpu"),
        (("--weights", "sun"), "--weights: unknown weights 'sun'", "write one of cpu"),
        (("--without", "edgy1"), "unknown host 'edgy1'", "did you mean edge1?"),
        (("--target", "slam"), "unknown task 'slam'", "did you mean slam-robot"),
        (("-l", "a b"), "cannot parse the selector 'a b'", "write a=b"),
        (("--snapshot", "inventories/local.yaml"), "error[EC", "hint: "),
    ],
)
def test_bad_options_say_what_to_write(
    run: Run, site: Path, words: tuple[str, ...], error: str, hint: str
) -> None:
    said = run(*PLAN, *words)
    assert (said.code, said.out) == (64, "")
    assert error in said.err
    assert hint in said.err


def test_files_come_from_options_environment_or_the_only_file(
    run: Run, site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = run(*PLAN).out
    (site / "inventories" / "local.yaml").rename(site / "lab.yaml")
    said = run(*PLAN)
    assert (said.code, said.err.splitlines()[0]) == (
        64,
        "error: no inventory given, and there is none in inventories/",
    )
    assert run(*PLAN, "-i", "lab.yaml").out == plain
    monkeypatch.setenv("EDGECTL_INVENTORY", "lab.yaml")
    assert run(*PLAN, "-t", "tasks").out == plain
    (site / "tasks" / "more.yaml").write_text(
        "version: 1\ntasks: {extra: {command: 'true', demand: {cpu: 0.01}}}\n"
    )
    said = run(*PLAN)
    assert said.err.splitlines()[0] == "error: no task file given, and tasks/ holds 2: demo.yaml, more.yaml"
    assert "11 to start" not in run(*PLAN, "-t", "tasks").out
    assert "extra" in run(*PLAN, "-t", "tasks/demo.yaml", "-t", "tasks/more.yaml").out
    monkeypatch.setenv("EDGECTL_TASKS", "tasks/demo.yaml")
    assert run(*PLAN).out == plain


def test_the_form_comes_from_the_environment(run: Run, site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGECTL_OUTPUT", "name")
    assert run(*PLAN).out.splitlines()[0] == "task/detection-robot1"
    assert run(*PLAN, "-o", "markdown").out.startswith("<!-- edgectl-plan -->")


def test_warnings_go_to_standard_error(run: Run, site: Path) -> None:
    tasks = site / "tasks" / "demo.yaml"
    tasks.write_text(tasks.read_text() + "  idle: {command: 'true'}\n")
    said = run("validate", "-o", "json")
    json.loads(said.out)
    assert said.err.startswith("warning[EC101]")
    assert run(*PLAN, "-o", "json").err == "", "what is known of a demand stands in the plan"


def test_a_plan_is_saved_through_a_link_and_into_a_pipe(run: Run, site: Path) -> None:
    (site / "kept").mkdir()
    (site / "latest.plan").symlink_to("kept/1.plan")
    assert run("plan", "--snapshot", "snap.json", "--out", "latest.plan").code == 0
    assert (site / "latest.plan").is_symlink()
    assert run("show", "kept/1.plan").code == 0
    assert not list(site.rglob("*.partial"))
    os.mkfifo(site / "pipe")
    reader = os.open(site / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    try:
        assert run("plan", "--snapshot", "snap.json", "--out", "pipe").code == 0
        assert json.loads(os.read(reader, 2**20))["format_version"] == 2
        assert (site / "pipe").is_fifo()
    finally:
        os.close(reader)


def test_an_unmanaged_task_that_runs_nowhere_is_not_called_left_out_or_completed(
    run: Run, site: Path
) -> None:
    with (site / "tasks" / "demo.yaml").open("a") as tasks:
        tasks.write("  pose: {managed: false, detect: {cmdline: pose_node}, demand: {cpu: 0, memory: 0}}\n")
    said = run(*PLAN).out.splitlines()
    assert [line[line.index("none:") :] for line in said if " pose " in line] == [
        "none: not managed by edgectl, and found nowhere"
    ]
    assert said[-1].endswith("1 not managed and found nowhere.")
    assert "completed before" not in said[-1]


def test_the_best_plan_says_what_is_proven(run: Run, site: Path) -> None:
    ended = run(*PLAN, "--optimal", "--out", "best.plan")
    assert ended.code == 0, ended.err
    assert "tasks are placed" in ended.err
    assert "the highest (proven)" in ended.err
    certificate = json.loads((site / "best.plan").read_text())["certificate"]
    assert certificate["placed"] == certificate["placed_bound"] == certificate["wanted"]
    assert "the highest (proven)" in run("show", "best.plan").err


@pytest.mark.parametrize("words", [("--rebalance",), ("--policy", "paper")])
def test_the_best_plan_is_of_one_policy(run: Run, site: Path, words: tuple[str, ...]) -> None:
    ended = run(*PLAN, "--optimal", *words)
    assert ended.code == 64
    assert "--optimal" in ended.err


def test_without_the_extra_the_hint_installs_it(
    run: Run, site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("edgectl.solver.highs", "highspy"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "highspy", None)
    ended = run(*PLAN, "--optimal")
    assert ended.code == 64
    assert "this needs highspy, which is not installed" in ended.err
    assert "[opt]" in ended.err
    assert "Traceback" not in ended.err


def test_plan_and_explain_say_how_far_a_noisy_host_may_be_overloaded(run: Run, site: Path) -> None:
    document = json.loads((site / "snap.json").read_text())
    document["hosts"]["edge1"]["cpu"]["used_cores"] = 0.4  # 0.058 of others; slam-robot1 fits nowhere else
    document["manager"]["noise"] = {"edge1": {"cpu": 0.06}, "edge2": {"cpu": 0.06}}
    (site / "snap.json").write_text(json.dumps(document))
    note = "note: edge1 may be up to 12.0% above its cpu capacity before a task leaves: its readings vary by 6.0%"
    assert note in " ".join(run(*PLAN).err.split())
    assert note in " ".join(run("explain", "slam-robot1", "--snapshot", "snap.json").err.split())
    assert "may be up to" not in run("explain", "slam-robot2", "--snapshot", "snap.json").err
