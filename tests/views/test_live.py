# SPDX-License-Identifier: Apache-2.0
"""A watch as a person sees it, and as a program does: the sum of its cycles, its lines, its objects, its screen."""

import dataclasses
import json
from typing import Any

import pytest

from edgectl.model.assignment import Reason
from edgectl.model.cycle import Cycle
from edgectl.model.event import Event, EventKind
from edgectl.model.plan import Action
from edgectl.model.policy import WEIGHT_PRESETS, Weights
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.units import format_instant
from edgectl.views import watch_cycle
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.reasons import describe_reason
from edgectl.views.text import RenderOptions
from edgectl.views.watch_cycle import CycleView, WatchTally, add_cycle_to_tally
from edgectl.views.watch_screen import WatchTitle, render_watch_screen
from tests.builders import NOW, silent
from tests.views.fixtures import fleet, plan

TITLE = WatchTitle(fleet="lab", weights="all", applies=True)
MOVED = ActionResult(
    task="slam-robot1",
    action=Action.MOVE,
    outcome=Outcome.DONE,
    host="edge2",
    previous_host="edge1",
    located="edge2",
    downtime_s=5.3,
)
EVENT = Event(at=NOW, kind=EventKind.TASK_MOVED, host="edge2", task="slam-robot1", message="from edge1", id=7)


def cycle(number: int = 1, **parts: object) -> Cycle:
    whole = Cycle(
        number=number, at=NOW + 10.0 * number, seconds=0.5, next_in=9.5, snapshot=fleet()[2], plan=plan()
    )
    return dataclasses.replace(whole, **parts)  # type: ignore[arg-type]


def steady() -> Cycle:
    """A cycle whose plan changes nothing."""
    made = plan()
    return cycle(
        plan=dataclasses.replace(
            made, steps=tuple(dataclasses.replace(step, action=Action.KEEP, stop=()) for step in made.steps)
        )
    )


def results(*actions: ActionResult) -> Results:
    return Results(revision=1, actions=actions, seconds=1.0)


def test_a_steady_cycle_has_no_line_and_trouble_is_told_when_it_begins_and_when_it_is_over() -> None:
    assert watch_cycle.render_cycle_line(None, cycle()) == ""
    warned = cycle(2, warnings=("the disk is full",), busy="lock held by ana@manager (pid 1, apply)")
    told = "warning: the disk is full; waiting: lock held by ana@manager (pid 1, apply)"
    assert watch_cycle.render_cycle_line(cycle(), warned) == f"{format_instant(NOW + 20)} {told}\n"
    assert (
        watch_cycle.render_cycle_line(
            warned, cycle(3, warnings=warned.warnings, busy="lock held by bob@manager (pid 2, apply)")
        )
        == ""
    )
    failed = cycle(4, error="cannot write the journal")
    assert watch_cycle.render_cycle_line(cycle(3), failed).endswith(" error: cannot write the journal\n")
    assert watch_cycle.render_cycle_line(failed, cycle(5, error="cannot write the journal")) == ""
    assert watch_cycle.render_cycle_line(failed, cycle(5)).endswith(" recovered\n")


def test_what_happened_is_told_by_events_or_without_a_history_by_results() -> None:
    assert watch_cycle.render_cycle_line(None, cycle(events=(EVENT,), results=results(MOVED))).endswith(
        "Z task-moved slam-robot1 on edge2: from edge1\n"
    )
    assert watch_cycle.render_cycle_line(None, cycle(results=results(MOVED))).endswith(
        "Z move slam-robot1 on edge2 done: gap 5.3s\n"
    )
    planned = Event(at=NOW, kind=EventKind.PLANNED, message="10 start", id=8)
    assert watch_cycle.render_cycle_line(None, cycle(events=(planned,))).endswith("Z planned: 10 start\n")
    assert "planned" not in watch_cycle.render_cycle_line(
        None, cycle(events=(planned, EVENT), results=results(MOVED))
    )
    assert "\x1b" not in watch_cycle.render_cycle_line(None, cycle(warnings=("\x1b[2J gone",)))


def read_cycle(value: Cycle) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(render_view(CycleView(value), OutputFormat.JSONL))
    return document


def test_the_object_of_a_cycle() -> None:
    document = read_cycle(cycle(results=results(MOVED), events=(EVENT,), resting=("detection-robot1",)))
    assert list(document) == [
        "cycle", "at", "duration_s", "next_in_s", "paused", "hosts", "placements", "pending", "actions",
        "events", "resting", "warnings",
    ]  # fmt: skip
    assert document["actions"] == [
        {
            "task": "slam-robot1",
            "action": "move",
            "outcome": "done",
            "host": "edge2",
            "previous_host": "edge1",
            "located": "edge2",
            "downtime_s": 5.3,
        }
    ]
    assert document["hosts"]["edge1"].keys() == {"status", "sample_age_s", "cpu", "memory"}
    assert document["pending"] == []
    assert (document["resting"], document["events"][0]["kind"]) == (["detection-robot1"], "task-moved")
    pending = read_cycle(cycle())["pending"]
    assert {entry["task"] for entry in pending} == {step.task for step in plan().steps if step.action.changes}
    cut = read_cycle(Cycle(number=3, at=NOW, error="no", busy="lock held"))
    assert (cut["error"], cut["lock"], cut["hosts"], "next_in_s" in cut) == ("no", "lock held", {}, False)
    assert render_view(CycleView(cycle()), OutputFormat.JSONL).count("\n") == 1


def test_the_sum_counts_moves_and_steady_cycles_and_stays_bounded() -> None:
    tally = add_cycle_to_tally(WatchTally(), cycle(results=results(MOVED), events=(EVENT,)))
    assert (tally.moves, tally.steady, tally.moved_at) == (1, 0, NOW + 10.5)
    for _ in range(300):
        tally = add_cycle_to_tally(tally, steady())
        tally = add_cycle_to_tally(tally, dataclasses.replace(steady(), error="odd"))
    assert (tally.cycles, tally.moves, tally.steady) == (601, 1, 0)
    assert all(len(values) == 60 for values in tally.shares.values())
    assert len(tally.past) == 50
    for _ in range(7):
        tally = add_cycle_to_tally(tally, steady())
    assert tally.steady == 7
    assert add_cycle_to_tally(tally, cycle(plan=None, paused=True)).steady == 7


@pytest.mark.parametrize(("width", "rows"), [(80, 24), (160, 50), (60, 12)])
@pytest.mark.parametrize("look", [RenderOptions(), RenderOptions(colour=True, unicode=True)])
def test_the_screen_fits_and_says_what_counts(width: int, rows: int, look: RenderOptions) -> None:
    look = dataclasses.replace(look, width=width)
    tally = WatchTally()
    for number in range(1, 9):
        tally = add_cycle_to_tally(tally, cycle(number, results=results(MOVED), events=(EVENT,)))
    text = render_watch_screen(TITLE, tally, NOW + 325.5, rows=rows, look=look)
    lines = text.splitlines()
    assert len(lines) <= rows
    assert "weights all" in lines[0]
    assert "moves 8 (last 4m" in lines[0]
    assert "working" in lines[0]
    assert "HOST" in lines[2]
    assert any("task-moved slam-robot1 on edge2: from edge1" in line for line in lines)
    assert ("\x1b" in text) == look.colour
    assert ("▁" in text or "█" in text) == look.unicode
    assert text.isascii() or look.unicode
    if rows >= 24:
        assert "q quit   p plan now   a pause" in lines[-1]
        assert any("edge1" in line and "%" in line for line in lines)
        assert any("slam-robot1" in line and "edge1" in line for line in lines)


def test_in_eighty_columns_decisions_that_count_are_whole_and_first() -> None:
    """A task that is kept for a calm reason has the word alone, so that it takes one line."""
    made = plan()
    assert len(made.steps) > 3
    forced = next(step for step in made.steps if step.decision.reason is Reason.FORCED_INFEASIBLE)
    moving = dataclasses.replace(made.steps[-1], action=Action.MOVE, decision=forced.decision)
    kept = [
        dataclasses.replace(
            step,
            action=Action.KEEP,
            stop=(),
            decision=dataclasses.replace(step.decision, reason=Reason.STILL_BEST),
        )
        for step in made.steps[:-1]
    ]
    tally = add_cycle_to_tally(WatchTally(), cycle(plan=dataclasses.replace(made, steps=(*kept, moving))))
    for width in (80, 160):
        look = RenderOptions(width=width)
        lines = render_watch_screen(TITLE, tally, NOW, rows=60, look=look).splitlines()
        head = next(place for place, line in enumerate(lines) if "DECISION" in line)
        assert lines[head + 1].split()[:2] == ["~", forced.task]
        shown = " ".join(" ".join(lines[head:]).split())
        assert describe_reason(moving) in shown
        assert ("keep: still the best host" in shown) == (width == 160)
        assert max(map(len, lines[head:])) <= width


def test_the_first_line_says_what_it_is_about_to_do() -> None:
    once = add_cycle_to_tally(WatchTally(), steady())
    assert (
        render_watch_screen(TITLE, WatchTally(), NOW).splitlines()[0]
        == "lab | weights all | applies | first cycle | moves 0 | steady 0 cycles"
    )
    assert (
        render_watch_screen(TITLE, once, NOW + 12.0).splitlines()[0]
        == "lab | weights all | applies | next in 8s | moves 0 | steady 1 cycle"
    )
    assert (
        " | paused | "
        in render_watch_screen(
            dataclasses.replace(TITLE, applies=False), once, NOW, paused=True
        ).splitlines()[0]
    )
    assert (
        "plans only"
        in render_watch_screen(dataclasses.replace(TITLE, applies=False), once, NOW).splitlines()[0]
    )


def test_a_silent_host_and_a_resting_task_are_shown_as_such() -> None:
    snapshot = fleet()[2]
    gone = dataclasses.replace(snapshot, hosts={**snapshot.hosts, "edge2": silent()})
    text = render_watch_screen(
        TITLE,
        add_cycle_to_tally(
            add_cycle_to_tally(WatchTally(), cycle()), cycle(snapshot=gone, resting=("slam-robot1",))
        ),
        NOW,
        rows=60,
    )
    (line,) = (line for line in text.splitlines() if line.startswith("edge2 "))
    assert "unreachable" in line
    assert "connection refused" in line
    assert "left alone for a while, because its last action failed" in text


def age_samples(value: Cycle, *, taken_at: float, **ages: float) -> Cycle:
    """The cycle with these ages of the samples of its hosts at the instant of the snapshot."""
    assert value.snapshot is not None
    hosts = {
        name: dataclasses.replace(host, sample_age_s=ages.get(name, 0.0))
        for name, host in value.snapshot.hosts.items()
    }
    return dataclasses.replace(
        value, snapshot=dataclasses.replace(value.snapshot, taken_at=taken_at, hosts=hosts)
    )


def test_each_reading_has_its_age_in_the_object_and_on_the_screen_where_it_grows() -> None:
    aged = age_samples(cycle(), taken_at=NOW, edge1=0.25, edge2=3.9)
    hosts = read_cycle(aged)["hosts"]
    assert {name: hosts[name]["sample_age_s"] for name in ("edge1", "edge2")} == {"edge1": 0.25, "edge2": 3.9}
    gone = read_cycle(cycle(snapshot=dataclasses.replace(fleet()[2], hosts={"edge1": silent()})))
    assert gone["hosts"]["edge1"] == {"status": "unreachable", "error": "connection refused"}
    tally = add_cycle_to_tally(WatchTally(), aged)
    for now, ages in ((NOW - 5.0, ("0.2s", "3.9s")), (NOW, ("0.2s", "3.9s")), (NOW + 7.0, ("7.2s", "11s"))):
        lines = render_watch_screen(TITLE, tally, now, rows=60, look=RenderOptions(width=80)).splitlines()
        for name, age in zip(("edge1", "edge2"), ages, strict=True):
            assert any(line.split()[:4] == [name, "ok,", age, "old"] for line in lines), lines


@pytest.mark.parametrize("rows", [12, 24, 50, 80])
def test_hosts_that_find_no_room_are_counted(rows: int) -> None:
    hosts = {f"edge{number}": fleet()[2].hosts["edge1"] for number in range(60)}
    snapshot = dataclasses.replace(fleet()[2], hosts=hosts)
    tally = add_cycle_to_tally(WatchTally(), cycle(snapshot=snapshot, plan=None))
    lines = render_watch_screen(TITLE, tally, NOW, rows=rows, look=RenderOptions(width=80)).splitlines()
    assert len(lines) <= rows
    shown = [line for line in lines if line.startswith("edge")]
    left = [line for line in lines[: len(shown) + 4] if line.startswith("and ")]
    assert left == ([f"and {60 - len(shown)} more"] if rows < 70 else [])
    assert len(shown) == 60 or len(shown) >= rows // 2 - 8


def test_presets_have_names() -> None:
    assert [watch_cycle.format_weights(weights) for weights in WEIGHT_PRESETS.values()] == list(
        WEIGHT_PRESETS
    )
    assert (
        watch_cycle.format_weights(Weights(cpu=3.0, memory=1.0, network=0.0, task=0.0))
        == "cpu=0.75 memory=0.25 network=0 task=0"
    )
