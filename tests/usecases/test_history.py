# SPDX-License-Identifier: Apache-2.0
"""History read back from the journal, and plans towards an earlier revision."""

import dataclasses
import json
from pathlib import Path

import pytest

from edgectl.errors import HostError, UsageError
from edgectl.model.check import Check
from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from edgectl.model.result import Outcome, Phase
from edgectl.model.revision import Revision, RevisionOutcome
from edgectl.state import failpoints
from edgectl.state.journal import Journal
from edgectl.state.revisions import load_revisions
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.history import get_revision, list_revisions, plan_rollback, roll_back_fleet
from edgectl.usecases.stop import stop_tasks
from tests.builders import NOW, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet

POLICY = Policy(min_dwell=0.0)
SLAM = a_task("slam", cpu=0.5, ready=Check(command="ready"))
CAMERA = a_task("camera", cpu=0.5)


class Bench:
    """Two edges, two tasks; every reading of the clock takes a second."""

    def __init__(self, state: Path) -> None:
        self.hosts = FakeFleet.of(["edge1", "edge2"])
        self.said: list[str] = []
        self.now = NOW
        self.fleet = Fleet(
            inventory=an_inventory(an_edge("edge1"), an_edge("edge2")), tasks=some_tasks(SLAM), transport=self.hosts.transport, state=state,
            clock=self._tick, warn=self.said.append,
        )  # fmt: skip

    def _tick(self) -> float:
        self.now += 1.0
        return self.now

    def apply(self, *tasks: object) -> None:
        plan_and_apply(self.files(*tasks), POLICY)

    def files(self, *tasks: object) -> Fleet:
        return dataclasses.replace(self.fleet, tasks=some_tasks(*tasks))  # type: ignore[arg-type]

    @property
    def past(self) -> list[Revision]:
        return list(list_revisions(self.fleet))


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def exclude_host(task: object, host: str) -> object:
    return dataclasses.replace(task, hosts=dataclasses.replace(SLAM.hosts, never=(host,)))  # type: ignore[type-var]


def test_each_change_is_a_revision_with_its_phases_and_where_everything_stood(bench: Bench) -> None:
    bench.apply(SLAM)
    first = bench.hosts.placed["slam"]
    bench.apply(exclude_host(SLAM, first), CAMERA)
    stop_tasks(bench.files(SLAM, CAMERA), ["camera"])
    one, two, three = bench.past
    assert [(each.number, each.verb, each.ending) for each in (one, two, three)] == [
        (1, "apply", RevisionOutcome.DONE), (2, "apply", RevisionOutcome.DONE), (3, "stop", RevisionOutcome.DONE),
    ]  # fmt: skip
    assert one.began_at > NOW
    assert one.user
    assert one.placements == {"slam": first}
    assert two.counts == {"move": 1, "start": 1}
    moved = next(action for action in two.actions if action.task == "slam")
    assert [phase.phase for phase in moved.phases] == [Phase.STOP, Phase.START, Phase.READY]
    assert all(phase.ok and phase.seconds >= 0.0 for phase in moved.phases)
    assert moved.downtime_s is not None
    assert (moved.previous_host, moved.host, moved.located) == (
        first,
        bench.hosts.placed["slam"],
        bench.hosts.placed["slam"],
    )
    assert three.placements == bench.hosts.placed
    assert get_revision(bench.fleet, 2) == two


def test_a_revision_that_does_not_exist_names_those_that_do(bench: Bench) -> None:
    with pytest.raises(UsageError) as caught:
        get_revision(bench.fleet, 1)
    assert caught.value.hint == "nothing was applied yet"
    bench.apply(SLAM)
    with pytest.raises(UsageError, match="no revision 7") as caught:
        get_revision(bench.fleet, 7)
    assert caught.value.hint == "the last one is 1; list them: edgectl history"


def test_failures_skips_and_cut_offs_are_told_apart(bench: Bench) -> None:
    failing = a_task("slam", cpu=0.5, ready=Check(command="ready"))
    after = a_task("camera", cpu=0.5, needs=["slam"])
    for host in bench.hosts.hosts.values():
        host.faults["start:slam"] = HostError("no space left")
    bench.apply(failing, after)
    (past,) = bench.past
    assert past.ending is RevisionOutcome.FAILED
    assert {action.task: (action.outcome, action.error) for action in past.actions} == {
        "slam": (Outcome.FAILED, "no space left"), "camera": (Outcome.SKIPPED, "needs slam, which did not start"),
    }  # fmt: skip
    for host in bench.hosts.hosts.values():
        host.faults.clear()

    def die(point: str) -> None:
        if point == "start acknowledged":
            raise KeyboardInterrupt

    remove = failpoints.install_hook(die)
    try:
        with pytest.raises(KeyboardInterrupt):
            bench.apply(failing)
    finally:
        remove()
    cut = bench.past[-1]
    assert (cut.ending, cut.seconds, cut.placements) == (RevisionOutcome.CUT_OFF, None, None)
    assert [(action.task, action.error) for action in cut.actions] == [
        ("slam", "interrupted before it ended")
    ]


def test_a_rollback_without_a_number_undoes_the_last_revision(bench: Bench) -> None:
    bench.apply(SLAM)
    first = bench.hosts.placed["slam"]
    bench.apply(exclude_host(SLAM, first), CAMERA)
    applied = roll_back_fleet(bench.files(SLAM, CAMERA), POLICY)
    assert {step.task: step.action for step in applied.plan.steps} == {
        "slam": Action.MOVE,
        "camera": Action.STOP,
    }
    assert bench.hosts.placed == {"slam": first}
    assert not bench.hosts.world.overlap
    assert (bench.past[-1].verb, bench.past[-1].placements) == ("rollback", {"slam": first})
    roll_back_fleet(bench.files(SLAM, CAMERA), POLICY, 2)
    assert bench.hosts.placed == bench.past[1].placements


def test_a_rollback_to_what_already_is_changes_nothing(bench: Bench) -> None:
    bench.apply(SLAM)
    bench.apply(SLAM, CAMERA)
    assert roll_back_fleet(bench.files(SLAM, CAMERA), POLICY, 2).results is None
    assert len(bench.past) == 2


def test_a_rollback_obeys_the_files_and_cordons_of_today(bench: Bench) -> None:
    bench.apply(SLAM)
    first = bench.hosts.placed["slam"]
    bench.apply(exclude_host(SLAM, first), CAMERA)
    forbidden = bench.files(exclude_host(SLAM, first), CAMERA)
    plan = plan_rollback(forbidden, POLICY, 1, ApplyOptions())
    assert {step.task: step.action for step in plan.steps}["slam"] is Action.KEEP
    operator_marks.cordon_hosts(bench.fleet, [first])
    plan = plan_rollback(bench.files(SLAM, CAMERA), POLICY, 1, ApplyOptions())
    assert {step.task: step.action for step in plan.steps}["slam"] is Action.KEEP


def test_tasks_and_hosts_that_are_gone_are_said(bench: Bench) -> None:
    bench.apply(SLAM, CAMERA)
    place = bench.hosts.placed["slam"]
    other = next(name for name in bench.hosts.hosts if name != place)
    stop_tasks(bench.files(SLAM, CAMERA), None)
    smaller = dataclasses.replace(bench.files(SLAM), inventory=an_inventory(an_edge(other)))
    plan = plan_rollback(smaller, POLICY, 1, ApplyOptions())
    assert {step.task: (step.action, step.decision.host) for step in plan.steps} == {
        "slam": (Action.START, other)
    }
    gone = "which is no longer in the inventory; it is placed as by apply"
    assert f"slam ran on {place} then, {gone}" in bench.said
    assert any(
        text.startswith("camera ran on") and text.endswith("no longer in the task files; it is not started")
        for text in bench.said
    )


def test_without_a_record_there_is_nothing_to_go_back_to(bench: Bench) -> None:
    with pytest.raises(UsageError, match="no revision before the last one"):
        roll_back_fleet(bench.fleet, POLICY)
    with Journal.open(bench.fleet.state, clock=lambda: NOW) as journal:
        journal.append("begin", revision=1, plan="old", actions=1)
        journal.append("intent", task="slam", action="start", host="edge1", previous_host=None, generation=1)
        journal.append("commit", task="slam", outcome="done", located="edge1", error="")
        journal.append("end", revision=1, interrupted=False)
    (old,) = bench.past
    assert (old.ending, old.counts, old.verb, old.seconds) == (RevisionOutcome.DONE, {"start": 1}, "", 0.0)
    with pytest.raises(
        UsageError, match="after revision 1 is not known here: it was interrupted, made by an older edgectl"
    ):
        roll_back_fleet(bench.fleet, POLICY, 1)


def test_journals_that_were_put_away_are_read_too(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.apply(SLAM)
    size = (bench.fleet.state / "journal.jsonl").stat().st_size
    monkeypatch.setattr("edgectl.state.journal._ROTATE_BYTES", size - 1)
    bench.apply(SLAM, CAMERA)
    assert (bench.fleet.state / "journal-1.jsonl").exists()
    assert [each.number for each in bench.past] == [1, 2]


def test_entries_of_any_shape_are_read(tmp_path: Path) -> None:
    odd = [None, 3, -1, "x", [], {}, [3], {"a": None}, True, 1e400]
    with Journal.open(tmp_path, clock=lambda: NOW) as journal:
        journal.append("begin", revision=1)
        for value in odd[:-1]:
            for event in ("intent", "commit", "end", "placed", "skipped", "begin"):
                journal.append(
                    event, task=value, action=value, outcome=value, phases=[value, {"phase": value, "seconds": value}], placements=value,
                    located=value, seconds=value, counts=value, downtime_s=value, error=value, host=value, verb=value, user=value,
                    revision=value, interrupted=value,
                )  # fmt: skip
    assert load_revisions(tmp_path)[0].number == 1
    assert json.dumps(odd[-1]) == "Infinity"
