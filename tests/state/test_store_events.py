# SPDX-License-Identifier: Apache-2.0
"""Events derived from consecutive snapshots and an apply between them, worked out by hand."""

import dataclasses
from typing import Any

import pytest

from edgectl.model.event import Event
from edgectl.model.plan import Action
from edgectl.model.resource import Usage
from edgectl.model.result import ActionResult, Outcome, Phase, PhaseResult, Results
from edgectl.model.snapshot import (
    DeviceSample,
    HostSample,
    HostStatus,
    InterfaceSample,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.state.store_action_events import detect_result_events
from edgectl.state.store_events import KnownFleet, KnownHost, KnownTask, detect_events
from tests.builders import NOW, a_sample, silent

NOTHING = KnownFleet()


def a_task(**changes: object) -> TaskSample:
    """A ready task, started 100 s ago."""
    ready = TaskSample(state=TaskState.READY, started_at=NOW - 100, instance="i1", spec_hash="s1")
    return dataclasses.replace(ready, **changes)  # type: ignore[arg-type]


def a_host(boot: str = "boot1", **tasks: TaskSample) -> HostSample:
    """A host that answers, and its tasks."""
    return dataclasses.replace(a_sample(tasks=tasks), device=DeviceSample(boot_id=boot))


def list_told_events(
    *pictures: Snapshot, known: KnownFleet = NOTHING, changing: bool = False
) -> tuple[list[tuple[str, ...]], KnownFleet]:
    """Return the events of the last snapshot after those before it: (kind, task or -, host or -, message)."""
    events: tuple[Event, ...] = ()
    for picture in pictures:
        events, known = detect_events(known, picture, changing=changing)
    return [
        (event.kind.value, event.task or "-", event.host or "-", event.message) for event in events
    ], known


def at(second: float, **hosts: HostSample) -> Snapshot:
    return Snapshot(taken_at=NOW + second, hosts=hosts)


# -- hosts -------------------------------------------------------------------------------------------------------------------------------


def test_the_first_picture_tells_only_what_is_wrong() -> None:
    first = at(
        0, edge1=a_host(slam=a_task(), camera=a_task(state=TaskState.FAILED, exit_code=3)), edge2=silent()
    )
    assert list_told_events(first)[0] == [
        ("host-lost", "-", "edge2", "connection refused"),
        ("task-failed", "camera", "edge1", "exit code 3"),
    ]


def test_a_host_is_lost_once_and_comes_back_once() -> None:
    pictures = [
        at(0, edge1=a_host()),
        at(10, edge1=silent()),
        at(20, edge1=silent()),
        at(75, edge1=a_host()),
        at(80, edge1=a_host()),
    ]
    each = [list_told_events(*pictures[: count + 1])[0] for count in range(len(pictures))]
    assert each == [
        [],
        [("host-lost", "-", "edge1", "connection refused")],
        [],
        [("host-back", "-", "edge1", "after 1m05s")],
        [],
    ]


def test_a_host_that_started_anew_is_told_with_and_without_a_silence() -> None:
    rebooted = ("host-rebooted", "-", "edge1", "the machine has rebooted since")
    assert list_told_events(at(0, edge1=a_host()), at(10, edge1=a_host("boot2")))[0] == [rebooted]
    assert list_told_events(at(0, edge1=a_host()), at(10, edge1=silent()), at(20, edge1=a_host("boot2")))[
        0
    ] == [
        ("host-back", "-", "edge1", "after 10s"),
        rebooted,
    ]
    assert list_told_events(at(0, edge1=a_host()), at(10, edge1=a_host("")))[0] == []


def a_robot(point: str, joined_s: float | None = 3.0) -> HostSample:
    """A host with a radio that has joined this access point; empty for none."""
    radio = InterfaceSample(
        rx_bytes_per_s=0.0, tx_bytes_per_s=0.0, access_point=point, joined_s=joined_s, level_dbm=-61.0
    )
    cable = InterfaceSample(rx_bytes_per_s=0.0, tx_bytes_per_s=0.0)
    device = DeviceSample(boot_id="boot1", interfaces={"eth0": cable, "wlan0": radio})
    return dataclasses.replace(a_sample(tasks={}), device=device)


def test_a_radio_that_joined_another_access_point_has_roamed() -> None:
    first, second = at(0, robot1=a_robot("02:00:00:00:00:0a")), at(10, robot1=a_robot("02:00:00:00:00:0b"))
    text = "wlan0 joined 02:00:00:00:00:0b 3.0s ago, after 02:00:00:00:00:0a, -61 dBm"
    assert list_told_events(first)[0] == []
    assert list_told_events(first, second)[0] == [("roamed", "-", "robot1", text)]
    assert list_told_events(first, second, at(20, robot1=a_robot("02:00:00:00:00:0b", 13.0)))[0] == []


@pytest.mark.parametrize("between", [a_robot("", None), silent()])
def test_a_radio_has_roamed_after_it_had_none_or_its_host_was_silent(between: HostSample) -> None:
    """And has not where it joined the same one again."""
    first = at(0, robot1=a_robot("02:00:00:00:00:0a"))
    for point, kinds in (("02:00:00:00:00:0a", []), ("02:00:00:00:00:0b", ["roamed"])):
        told = list_told_events(first, at(10, robot1=between), at(20, robot1=a_robot(point)))[0]
        assert [kind for kind, *_ in told if kind != "host-back"] == kinds


# -- tasks -------------------------------------------------------------------------------------------------------------------------------


def list_events_after(
    now: TaskSample | None, *, before: TaskSample | None = None, host: str = "edge1"
) -> list[tuple[str, ...]]:
    """Return the events of a second snapshot with ``now`` on ``host``, after ``before`` (a ready task) on
    edge1.
    """
    there: dict[str, Any] = {"slam": now} if now is not None else {}
    hosts = {"edge1": a_host(), "edge2": a_host()} | {host: a_host(**there)}
    return list_told_events(at(0, edge1=a_host(slam=before or a_task()), edge2=a_host()), at(10, **hosts))[0]


def test_a_task_that_is_as_it_was_tells_nothing() -> None:
    assert list_events_after(a_task()) == []
    assert list_events_after(a_task(used=Usage(cpu=3.0), pid=7)) == []


def test_how_a_task_ends() -> None:
    assert list_events_after(a_task(state=TaskState.COMPLETED, exit_code=0)) == [
        ("task-completed", "slam", "edge1", "exit code 0")
    ]
    assert list_events_after(a_task(state=TaskState.FAILED, exit_code=1, detail="killed")) == [
        ("task-failed", "slam", "edge1", "exit code 1; killed")
    ]
    gone_wrong = a_task(state=TaskState.CRASHLOOP, restarts=5, last_exit=7)
    assert list_events_after(gone_wrong) == [
        ("task-restarted", "slam", "edge1", "by its supervisor 5 times, after exit code 7"),
        ("task-crashloop", "slam", "edge1", ""),
    ]
    assert list_events_after(gone_wrong, before=gone_wrong) == []


def test_a_task_becomes_ready_once() -> None:
    starting = a_task(state=TaskState.STARTING)
    assert list_events_after(a_task(), before=starting) == [("task-ready", "slam", "edge1", "")]
    assert list_events_after(starting, before=starting) == []


def test_a_restart_by_the_supervisor_and_one_by_somebody_else() -> None:
    assert list_events_after(a_task(restarts=1, last_exit=-9)) == [
        ("task-restarted", "slam", "edge1", "by its supervisor once, after exit code -9")
    ]
    assert list_events_after(a_task(instance="i2")) == [
        ("task-restarted", "slam", "edge1", "found restarted")
    ]


def test_a_task_that_vanished_or_moved_without_us() -> None:
    assert list_events_after(None) == [
        ("task-lost", "slam", "edge1", "gone, and not stopped by this manager")
    ]
    assert list_events_after(None, before=a_task(state=TaskState.COMPLETED)) == []
    assert list_events_after(a_task(instance="i2"), host="edge2") == [
        ("task-moved", "slam", "edge2", "found there; it was on edge1")
    ]


def test_a_task_on_a_silent_host_is_not_lost_until_it_is_seen_elsewhere() -> None:
    first, dark = at(0, edge1=a_host(slam=a_task()), edge2=a_host()), at(10, edge1=silent(), edge2=a_host())
    assert list_told_events(first, dark)[0] == [("host-lost", "-", "edge1", "connection refused")]
    moved = at(20, edge1=silent(), edge2=a_host(slam=a_task(instance="i2")))
    assert list_told_events(first, dark, moved)[0] == [
        ("task-moved", "slam", "edge2", "found there; it was on edge1")
    ]
    assert list_told_events(first, dark, at(20, edge1=a_host(slam=a_task()), edge2=a_host()))[0] == [
        ("host-back", "-", "edge1", "after 10s")
    ]


def test_a_task_found_on_a_known_host_was_started_by_somebody() -> None:
    assert list_told_events(at(0, edge1=a_host()), at(10, edge1=a_host(slam=a_task())))[0] == [
        ("task-started", "slam", "edge1", "found running")
    ]
    over = at(10, edge1=a_host(slam=a_task(state=TaskState.COMPLETED)))
    assert list_told_events(at(0, edge1=a_host()), over)[0] == [("task-completed", "slam", "edge1", "")]


def test_of_two_places_the_one_where_it_lives_counts() -> None:
    dead = a_task(state=TaskState.FAILED)
    both = at(10, edge1=a_host(slam=dead), edge2=a_host(slam=a_task(instance="i2")))
    assert list_told_events(at(0, edge1=a_host(slam=a_task()), edge2=a_host()), both)[0] == [
        ("task-moved", "slam", "edge2", "found there; it was on edge1")
    ]
    twice = at(10, edge1=a_host(slam=a_task()), edge2=a_host(slam=a_task(instance="i2", started_at=NOW)))
    assert list_told_events(at(0, edge1=a_host(slam=a_task()), edge2=a_host()), twice)[0] == []


def test_what_is_left_of_an_old_run_tells_nothing() -> None:
    first = at(0, edge1=a_host(), edge2=a_host(slam=a_task()))
    left = a_task(state=TaskState.FAILED, instance="i0")
    assert list_told_events(first, at(10, edge1=a_host(slam=left), edge2=silent()))[0] == [
        ("host-lost", "-", "edge2", "connection refused")
    ]
    gone = at(10, edge1=a_host(), edge2=a_host())
    assert (
        list_told_events(
            first, gone, at(20, edge1=a_host(), edge2=a_host(slam=a_task(state=TaskState.FAILED)))
        )[0]
        == []
    )


def test_an_older_picture_and_the_same_one_tell_nothing_but_a_clock_set_back_does() -> None:
    first, lost = at(0, edge1=a_host()), at(10, edge1=silent())
    assert list_told_events(first, lost, at(5, edge1=a_host()))[0] == []
    assert list_told_events(first, lost, lost)[0] == []
    assert list_told_events(first, lost, at(-86400, edge1=a_host()))[0] == [
        ("host-back", "-", "edge1", "after 0.0s")
    ]


# -- an apply ----------------------------------------------------------------------------------------------------------------------------


def a_result(action: Action, outcome: Outcome = Outcome.DONE, **changes: object) -> ActionResult:
    """One action on slam that took 2 s and left it ready on edge2."""
    phases = (
        PhaseResult(phase=Phase.START, host="edge2", seconds=1.5, ok=True),
        PhaseResult(phase=Phase.READY, host="edge2", seconds=0.5, ok=True),
    )
    result = ActionResult(
        task="slam", action=action, outcome=outcome, host="edge2", phases=phases, located="edge2"
    )
    return dataclasses.replace(result, **changes)  # type: ignore[arg-type]


def list_events_after_apply(
    *results: ActionResult, known: KnownFleet = NOTHING, second: float = 20.0
) -> tuple[list[tuple[str, ...]], KnownFleet]:
    events, after = detect_result_events(
        known, Results(revision=1, actions=results, seconds=3.0), NOW + second
    )
    return [
        (event.kind.value, event.task or "-", event.host or "-", event.message) for event in events
    ], after


def test_what_an_apply_did() -> None:
    assert list_events_after_apply(a_result(Action.START))[0] == [
        ("task-started", "slam", "edge2", "took 2.0s")
    ]
    move = a_result(Action.MOVE, previous_host="edge1", downtime_s=1.25)
    assert list_events_after_apply(move)[0] == [("task-moved", "slam", "edge2", "from edge1, gap 1.2s")]
    assert list_events_after_apply(a_result(Action.RESTART, downtime_s=1.0))[0] == [
        ("task-restarted", "slam", "edge2", "gap 1.0s")
    ]
    stop = a_result(Action.STOP, host=None, previous_host="edge1", located=None)
    assert list_events_after_apply(stop)[0] == [("task-stopped", "slam", "edge1", "took 2.0s")]
    assert list_events_after_apply(a_result(Action.COMPLETE, host=None, previous_host="edge1", located=None))[
        0
    ] == [("task-stopped", "slam", "edge1", "it has completed, took 2.0s")]
    assert list_events_after_apply(a_result(Action.MOVE, Outcome.FAILED, error="no route"))[0] == [
        ("action-failed", "slam", "edge2", "move: no route")
    ]
    assert list_events_after_apply(a_result(Action.START, Outcome.DEFERRED, phases=(), error="later"))[0] == [
        ("task-deferred", "slam", "edge2", "start: later")
    ]
    assert list_events_after_apply(a_result(Action.START, Outcome.SKIPPED, phases=()))[0] == []


def test_the_picture_after_an_apply_tells_nothing_of_what_it_did() -> None:
    before = list_told_events(at(0, edge1=a_host(slam=a_task()), edge2=a_host()))[1]
    _, known = list_events_after_apply(
        a_result(Action.MOVE, previous_host="edge1", downtime_s=1.0), known=before
    )
    moved = at(30, edge1=a_host(), edge2=a_host(slam=a_task(instance="i2")))
    assert list_told_events(moved, known=known)[0] == []
    _, known = list_events_after_apply(
        a_result(Action.STOP, host=None, previous_host="edge1", located=None), known=before
    )
    assert list_told_events(at(30, edge1=a_host(), edge2=a_host()), known=known)[0] == []
    assert list_told_events(at(30, edge1=a_host(slam=a_task(instance="i2")), edge2=a_host()), known=known)[
        0
    ] == [("task-started", "slam", "edge1", "found running")]


def test_a_picture_from_within_an_apply_leaves_its_work_to_it() -> None:
    before = list_told_events(at(0, edge1=a_host(slam=a_task(), camera=a_task()), edge2=a_host()))[1]
    half = at(15, edge1=a_host(camera=a_task(restarts=1)), edge2=silent())
    assert list_told_events(half, known=before, changing=True)[0] == [
        ("host-lost", "-", "edge2", "connection refused"),
        ("task-restarted", "camera", "edge1", "by its supervisor once"),
    ]
    # The same snapshot, recorded after the apply had ended, is older than the result of the apply.
    _, known = list_events_after_apply(
        a_result(Action.MOVE, previous_host="edge1", downtime_s=1.0), known=before
    )
    assert ("task-lost", "slam", "edge1", "gone, and not stopped by this manager") not in list_told_events(
        half, known=known
    )[0]


def test_a_failed_action_that_touched_nothing_leaves_what_was_known() -> None:
    known = list_told_events(at(0, edge1=a_host(slam=a_task())))[1]
    assert (
        list_events_after_apply(
            a_result(Action.MOVE, Outcome.FAILED, phases=(), error="no route", located="edge1"), known=known
        )[1]
        == known
    )


def test_all_that_is_known_is_that_of_the_last_picture() -> None:
    known = list_told_events(
        at(0, edge1=a_host(slam=a_task())),
        at(10, edge1=a_host(slam=a_task(restarts=1))),
        at(20, edge1=a_host()),
    )[1]
    assert known == KnownFleet(
        hosts={"edge1": KnownHost(at=NOW + 20, since=NOW, status=HostStatus.OK, boot_id="boot1")},
        tasks={"slam": KnownTask(at=NOW + 20, host=None, instance="i1")},
    )
