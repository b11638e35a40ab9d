# SPDX-License-Identifier: Apache-2.0
"""The gap of a move as the robot hears it, against what a robot recorded every 10 ms; fixture of the handoffs."""

import time
from pathlib import Path

import pytest

from edgectl.model.latency import HeardRule
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.task import HandoffOrder, Task
from edgectl.state.store import Store
from edgectl.usecases.history import list_revisions
from tests.e2e import robot
from tests.e2e.test_handoff import Scene, compute_gap_s, exclude_host, scene
from tests.pace import patience

__all__ = ["scene"]
# A question takes a process, on this machine beside all others: so long at either end of the gap.
SLACK_S = patience(0.4)


def heard_by_record(made: Scene) -> HeardRule:
    """A command that succeeds while the robot's newest sample has an instance that steers."""
    return HeardRule(command=f'tail -n1 {made.record} | grep -q \'"steer": \\["\'', within=patience(20.0))


def move(made: Scene, task: Task) -> ActionResult:
    result = made.apply(exclude_host(task, made.running(task)))
    assert result is not None
    assert result.outcome is Outcome.DONE, result
    return result


def test_the_gap_of_stop_first_is_what_the_robot_recorded(scene: Scene) -> None:
    task = scene.task(HandoffOrder.STOP_FIRST, heard=heard_by_record(scene))
    old = scene.running(task)
    begin = scene.now()
    result = scene.apply(exclude_host(task, old))
    assert result is not None
    assert result.gap_s is not None, result
    recorded = compute_gap_s(scene.since(begin))
    assert recorded > 0
    assert recorded - 2 * robot.PERIOD_S <= result.gap_s <= recorded + SLACK_S
    phases = [phase.phase for phase in result.phases]
    assert phases.index(Phase.HEARD) < phases.index(Phase.STOP), "before the old instance stops"
    assert phases[-1] is Phase.HEARD, "until the new one is heard; the robot is released before"
    state = scene.bench.probe().manager
    assert state is not None
    assert state.downtimes["steer", str(result.located)] == (result.gap_s,), "the cost of a move uses it"
    revision = list_revisions(scene.bench.fleet)[-1]
    assert revision.actions[0].gap_s == pytest.approx(result.gap_s)
    with Store.open(scene.bench.fleet.state) as store:
        assert store.handoffs()[-1].gap_s == pytest.approx(result.gap_s)


def test_start_first_is_heard_all_the_time(scene: Scene) -> None:
    result = move(scene, scene.task(HandoffOrder.START_FIRST, heard=heard_by_record(scene)))
    assert result.downtime_s == 0.0
    assert result.gap_s is not None
    assert result.gap_s <= SLACK_S


def test_a_new_instance_that_is_not_heard_leaves_the_gap_unknown(scene: Scene, tmp_path: Path) -> None:
    """A command that succeeds for the old host alone."""
    task = scene.task(HandoffOrder.STOP_FIRST)
    old = scene.running(task)
    deaf = HeardRule(command=f"tail -n1 {scene.record} | grep -q '\\[\"{old}\"'", within=0.5)
    result = scene.apply(exclude_host(scene.task(HandoffOrder.STOP_FIRST, heard=deaf), old))
    assert result is not None
    assert (result.outcome, result.gap_s) == (Outcome.DONE, None)
    assert result.downtime_s is not None
    assert result.phases[-1].detail.startswith("gap not known: the command failed")


def test_a_move_that_fails_ends_its_watcher(scene: Scene) -> None:
    count = scene.bench.fleet.state.parent / "count"
    beat = HeardRule(command=f"echo >>{count}", within=5.0)
    task = scene.task(HandoffOrder.STOP_FIRST, heard=beat)
    old = scene.running(task)
    scene.broken("edge1" if old == "edge2" else "edge2")
    result = scene.apply(exclude_host(task, old))
    assert result is not None
    assert (result.outcome, result.gap_s) == (Outcome.FAILED, None)
    size = count.stat().st_size
    time.sleep(0.3)
    assert count.stat().st_size == size, "nothing asks any more"
