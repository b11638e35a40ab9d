# SPDX-License-Identifier: Apache-2.0
"""Tasks named by their entry or by labels, and marks that are only tried."""

from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.cli.main import main
from edgectl.cli.task_names import expand_task_names, resolve_task_name, select_task_names
from edgectl.config.load import load_inventory
from edgectl.errors import UsageError
from edgectl.state.fleet_dir import ensure_fleet_dir
from edgectl.state.manager_state import load_manager_state
from tests.builders import a_task, some_tasks
from tests.cli.conftest import Run

TASKS = some_tasks(
    a_task("slam-robot2", template="slam", robots=["robot2"]),
    a_task("slam-robot1", template="slam", robots=["robot1"]),
    replace(a_task("merge", robots=["robot1", "robot2"]), labels={"robot": "all"}),
    a_task("nav-robot1", template="nav", robots=["robot1"]),
)


def test_an_entry_stands_for_its_tasks_and_a_task_for_itself() -> None:
    assert expand_task_names(["merge", "slam", "slam-robot1"], TASKS) == [
        "merge",
        "slam-robot1",
        "slam-robot2",
    ]
    assert expand_task_names(["gone"], TASKS) == ["gone"], "it may still run"
    assert resolve_task_name("nav", TASKS) == "nav-robot1"
    with pytest.raises(UsageError, match="slam stands for 2 tasks") as refused:
        resolve_task_name("slam", TASKS)
    assert refused.value.hint == "name one: slam-robot1, slam-robot2"


def test_labels_of_the_file_win_over_implied_ones() -> None:
    assert select_task_names([], "robot=robot1", TASKS) == ["nav-robot1", "slam-robot1"]
    assert select_task_names(["merge"], "robot=all", TASKS) == ["merge"]
    assert select_task_names(["nav"], "task=slam,kind=service", TASKS) == [
        "nav-robot1",
        "slam-robot1",
        "slam-robot2",
    ]
    for names, selector in (([], None), ([], "robot=robot9")):
        with pytest.raises(UsageError):
            select_task_names(list(names), selector, TASKS)


def test_entries_are_taken_wherever_a_task_is_named(run: Run, site: Path) -> None:
    said = run("done", "detection", "task/map-merge", "--dry-run")
    assert said.out.splitlines() == [
        *(f"task/detection-robot{number} marked as done (dry run)" for number in (1, 2, 3)),
        "task/map-merge marked as done (dry run)",
    ]
    assert run("explain", "detection", "--snapshot", "snap.json").err == (
        "error: detection stands for 3 tasks\n"
        "hint: name one: detection-robot1, detection-robot2, detection-robot3\n"
    )
    planned = run("plan", "--snapshot", "snap.json", "--target", "detection", "-o", "json").out
    assert planned == run(
        "plan", "--snapshot", "snap.json", *(f"--target=task/detection-robot{number}" for number in (1, 2, 3)), "-o", "json"
    ).out  # fmt: skip
    assert "did you mean detection" in run("plan", "--snapshot", "snap.json", "--target", "detektion").err


@pytest.mark.parametrize("verb", ["done", "reopen", "unpin"])
def test_marks_take_labels_where_they_take_tasks(run: Run, site: Path, verb: str) -> None:
    said = run(verb, "slam-robot1", "-l", "task=detection,robot in (robot1,robot3)", "--dry-run")
    named = [line.split()[0] for line in said.out.splitlines()]
    assert named == ["task/slam-robot1", "task/detection-robot1", "task/detection-robot3"]
    assert run(verb, "--dry-run") == (
        64,
        "",
        "error: name a task, or pass -l LABELS\nhint: list tasks: edgectl get tasks\n",
    )
    assert run(verb, "-l", "task=detektion").err.startswith("error: no task matches -l task=detektion\n")


def test_a_selector_that_matches_nothing_is_said(run: Run, site: Path) -> None:
    said = run("plan", "--snapshot", "snap.json", "-l", "task=detektion")
    assert "warning: no task matches -l task=detektion" in said.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["cordon", "edge/edge3", "edge1", "--drain"],
            ["edge/edge3 cordoned; its tasks leave at the next apply (dry run)"],
        ),
        (["uncordon", "edge2"], ["edge/edge2 already uncordoned (dry run)"]),
        (["fence", "edge1"], ["edge/edge1 fenced (dry run)"]),
        (["unfence", "edge1"], ["edge/edge1 already unfenced (dry run)"]),
        (["reopen", "slam-robot3"], ["task/slam-robot3 reopened (dry run)"]),
        (["unpin", "slam-robot3"], ["task/slam-robot3 already unpinned (dry run)"]),
    ],
)
def test_a_dry_run_of_a_mark_prints_it_and_leaves_none(
    run: Run, site: Path, words: list[str], said: list[str]
) -> None:
    done = run(*words, "--dry-run")
    assert done.code == 0, done
    assert done.out.splitlines()[: len(said)] == said
    path = next((site / "inventories").glob("*.yaml"))
    state = load_manager_state(ensure_fleet_dir(load_inventory(path).fleet, path))
    assert (state.cordons, state.draining, state.fenced, state.done, state.pins) == (
        frozenset(), frozenset(), frozenset(), {}, {},
    )  # fmt: skip
    assert main([words[0], "edge9", "--dry-run"]) == 64, "names are checked"


def test_unpin_of_a_task_that_its_file_pins_names_the_entry(run: Run, site: Path) -> None:
    done = run("unpin", "slam-robot3")
    assert "note: slam-robot3 is pinned to edge3 by hosts.pin of slam-robot3 in its task file" in done.err
    assert "note" not in run("unpin", "detection-robot1").err
