# SPDX-License-Identifier: Apache-2.0
"""drain and rollback die at every failpoint; the same command again, or a plain apply, ends with exactly one
instance of each task.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.model.event import EventKind
from edgectl.state import failpoints
from edgectl.state.journal_reader import read_journal
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.drain import drain_hosts
from edgectl.usecases.history import roll_back_fleet
from edgectl.usecases.plan import make_plan
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.status import load_last_events
from tests.usecases.test_recovery import (
    ONE_BY_ONE,
    POLICY,
    ManagerKilledError,
    RecoveryScene,
    _start_tasks,
    choose_failpoints,
)

Verb = Callable[[RecoveryScene], object]


def drain_edge1(scene: RecoveryScene) -> object:
    return drain_hosts(
        scene.fleet, POLICY, ["edge1"], options=ONE_BY_ONE, timeout=5.0, pause=lambda _seconds: None
    )


def roll_back(scene: RecoveryScene) -> object:
    return roll_back_fleet(scene.fleet, POLICY, 1, options=ONE_BY_ONE)


def start_on_edge1(state: Path) -> RecoveryScene:
    return _start_tasks(state)


def start_moved_away(state: Path) -> RecoveryScene:
    scene = _start_tasks(state)
    operator_marks.cordon_hosts(scene.fleet, ["edge1"], drain=True)
    plan_and_apply(scene.fleet, POLICY, options=ONE_BY_ONE)
    operator_marks.uncordon_hosts(scene.fleet, ["edge1"])
    return scene


def run_until_failpoint(scene: RecoveryScene, verb: Verb, die_at: int | None) -> list[str]:
    """Return the failpoints that the command hits; it dies at ``die_at``."""
    seen: list[str] = []

    def note(point: str) -> None:
        seen.append(point)
        if die_at is not None and len(seen) > die_at:
            raise ManagerKilledError

    remove = failpoints.install_hook(note)
    try:
        verb(scene)
    except ManagerKilledError:
        pass
    finally:
        remove()
    return seen


@pytest.mark.parametrize(
    ("make", "verb"),
    [(start_on_edge1, drain_edge1), (start_moved_away, roll_back)],
    ids=["drain", "rollback"],
)
def test_death_at_every_point(
    make: Callable[[Path], RecoveryScene], verb: Verb, whole: bool, tmp_path: Path
) -> None:
    prepared = make(tmp_path / "prepared")
    uninterrupted = prepared.copy(tmp_path / "uninterrupted")
    names = run_until_failpoint(uninterrupted, verb, None)
    assert len(set(names)) > 15
    for number in choose_failpoints(names, verb.__name__, whole=whole):
        name = names[number]
        scene = prepared.copy(tmp_path / str(number))
        run_until_failpoint(scene, verb, number)
        verb(scene)
        assert scene.hosts.placed == uninterrupted.hosts.placed, name
        assert not scene.hosts.world.overlap, name
        applied = plan_and_apply(scene.fleet, POLICY, options=ONE_BY_ONE)
        assert applied.results is None or applied.results.done
        counts = [task for host in scene.hosts.hosts.values() for task in host.tasks]
        assert sorted(counts) == sorted(set(counts)) == sorted(uninterrupted.hosts.placed), name
        assert not make_plan(scene.fleet, POLICY).changes, name
        log = read_journal(scene.fleet.state / "journal.jsonl")
        assert (log.broken, log.unfinished) == (0, ())


def test_a_stop_by_a_killed_edgectl_is_not_told_as_a_loss(tmp_path: Path) -> None:
    """The journal has the intention, although nobody recorded its result."""
    scene = start_on_edge1(tmp_path / "killed")
    before = dict(scene.hosts.placed)
    names = run_until_failpoint(start_on_edge1(tmp_path / "whole"), drain_edge1, None)
    run_until_failpoint(scene, drain_edge1, names.index("stop acknowledged"))
    stopped = before.keys() - scene.hosts.placed.keys()
    assert len(stopped) == 1
    later = scene.fleet.clock() + 60.0
    probe_fleet(dataclasses.replace(scene.fleet, clock=lambda: later))
    events = [event for event in load_last_events(scene.fleet, 10) if event.task in stopped]
    assert events[-1].kind is EventKind.TASK_STOPPED
    assert "interrupted" in events[-1].message
