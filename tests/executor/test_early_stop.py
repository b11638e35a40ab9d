# SPDX-License-Identifier: Apache-2.0
"""Stopping early: no new action after a failure with --fail-fast or after the deadline; running actions are
finished.
"""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.errors import HostError
from edgectl.executor.cancellation import INTERRUPTED, Cancellation
from edgectl.executor.run_options import RunOptions
from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.state.journal import Journal
from edgectl.state.journal_reader import read_journal
from tests.builders import a_task
from tests.executor.fake_fleet import FakeFleet
from tests.executor.test_run import EDGES, a_plan, a_step, run_steps
from tests.state.journal_files import read_entries


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with Journal.open(tmp_path) as opened:
        yield opened


def run_three_starts(fleet: FakeFleet, journal: Journal, **options: object) -> Results:
    """Three starts, one after the other; the first fails."""
    fleet["edge1"].faults["start:one"] = HostError("no space left")
    steps = [
        a_step(name, Action.START, host=host)
        for name, host in zip(("one", "two", "three"), EDGES, strict=True)
    ]
    tasks = [a_task(name) for name in ("one", "two", "three")]
    return run_steps(fleet, journal, a_plan(*steps), *tasks, max_parallel=1, **options)


def list_outcomes(results: Results) -> list[tuple[str, Outcome, str]]:
    return [(result.task, result.outcome, result.error) for result in results.actions]


def test_after_a_failure_nothing_new_begins(journal: Journal, tmp_path: Path) -> None:
    fleet = FakeFleet.of(EDGES)
    reason = "not begun, because one failed (--fail-fast)"
    results = run_three_starts(fleet, journal, fail_fast=True)
    assert list_outcomes(results) == [
        ("one", Outcome.FAILED, "no space left"), ("two", Outcome.SKIPPED, reason), ("three", Outcome.SKIPPED, reason),
    ]  # fmt: skip
    assert (results.interrupted, fleet.changes) == (False, [])
    path = tmp_path / "journal.jsonl"
    assert [entry["error"] for entry in read_entries(path) if entry["event"] == "skipped"] == [reason, reason]
    assert read_journal(path).unfinished == ()


def test_without_fail_fast_the_others_go_on(journal: Journal) -> None:
    results = run_three_starts(FakeFleet.of(EDGES), journal)
    assert [outcome for _, outcome, _ in list_outcomes(results)] == [
        Outcome.FAILED,
        Outcome.DONE,
        Outcome.DONE,
    ]


def test_what_was_begun_beside_the_failure_is_finished(journal: Journal) -> None:
    fleet, begun = FakeFleet.of(EDGES), threading.Event()

    def fails(_request: dict[str, object]) -> dict[str, object]:
        assert begun.wait(30)
        raise HostError("no space left")

    def goes_on(_request: dict[str, object]) -> dict[str, object]:
        begun.set()
        time.sleep(0.3)
        return {"state": "running"}

    fleet["edge1"].faults["start:one"] = fails
    fleet["edge2"].faults["wait:two"] = goes_on
    steps = [
        a_step(name, Action.START, host=host)
        for name, host in zip(("one", "two", "three"), EDGES, strict=True)
    ]
    tasks = [a_task(name) for name in ("one", "two")] + [a_task("three", needs=["two"])]
    results = run_steps(fleet, journal, a_plan(*steps), *tasks, fail_fast=True)
    assert [outcome for _, outcome, _ in list_outcomes(results)] == [
        Outcome.FAILED,
        Outcome.DONE,
        Outcome.SKIPPED,
    ]


def test_a_stop_that_fails_keeps_the_starts_from_beginning(journal: Journal) -> None:
    fleet = FakeFleet.of(EDGES)
    fleet["edge1"].runs("old")
    fleet["edge1"].faults["stop:old"] = HostError("refused")
    made = a_plan(a_step("old", Action.STOP, previous="edge1"), a_step("new", Action.START, host="edge2"))
    results = run_steps(fleet, journal, made, a_task("old"), a_task("new"), fail_fast=True)
    assert [outcome for _, outcome, _ in list_outcomes(results)] == [Outcome.FAILED, Outcome.SKIPPED]


def test_nothing_begins_after_the_deadline(journal: Journal) -> None:
    fleet = FakeFleet.of(EDGES)
    deadline = time.monotonic() + 3.0

    def late(_request: dict[str, object]) -> dict[str, object]:
        time.sleep(max(0.0, deadline - time.monotonic()))
        return {"state": "running"}

    fleet["edge1"].faults["wait:one"] = late
    steps = [a_step(name, Action.START, host="edge1") for name in ("one", "two")]
    results = run_steps(
        fleet, journal, a_plan(*steps), a_task("one"), a_task("two"), max_parallel=1, deadline=deadline
    )
    assert list_outcomes(results) == [
        ("one", Outcome.DONE, ""),
        ("two", Outcome.SKIPPED, "not begun before the deadline (--timeout)"),
    ]
    assert not results.interrupted


def test_an_interruption_is_named_before_everything_else() -> None:
    stop = threading.Event()
    brake = Cancellation(RunOptions(stop_requested=stop, fail_fast=True, deadline=0.0))
    assert brake.reason().startswith("not begun before the deadline")
    brake.note_result(ActionResult(task="slam", action=Action.START, outcome=Outcome.FAILED))
    assert brake.reason() == "not begun, because slam failed (--fail-fast)"
    stop.set()
    assert brake.reason() == INTERRUPTED
