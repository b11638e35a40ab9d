# SPDX-License-Identifier: Apache-2.0
"""Replays checked by hand: loads move with their tasks, and each scheme keeps its own placement."""

from dataclasses import replace

import pytest

from edgectl.experiments.commands.scheme_options import parse_weight_sets
from edgectl.experiments.model.schemes import Scheme, build_schemes
from edgectl.experiments.recorded_snapshots import snapshots_from_points
from edgectl.experiments.replay import relocate_tasks, replay_snapshots
from edgectl.model.point import HostPoint, LinkPoint, TaskPoint
from edgectl.model.policy import WEIGHT_PRESETS, Policy, PolicyName, Weights
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostStatus, Snapshot, TaskState
from tests.builders import (
    GI,
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)

INVENTORY = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1", probe=False))
TASKS = some_tasks(a_task("slam", cpu=1.0, memory=GI, throughput=1e6, robots=["robot1"]))
RUN = a_run(used=Usage(cpu=1.5, memory=GI, network=2e6), spec_hash="hash-slam")
CPU = Policy(weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0), min_dwell=0.0)


def recorded(used1: float, used2: float, at: float = NOW) -> Snapshot:
    """slam on edge1, of whose load it makes 1.5 cores."""
    return a_snapshot(
        taken_at=at,
        edge1=a_sample(
            used=used1, used_memory=2 * GI, links={"robot1": a_link(used=3e6)}, tasks={"slam": RUN}
        ),
        edge2=a_sample(used=used2, links={"robot1": a_link()}),
    )


def test_a_task_takes_its_measured_use_along() -> None:
    moved = relocate_tasks(recorded(2.0, 0.5), TASKS, {"slam": "edge2"}).hosts
    assert moved["edge1"].measured
    assert moved["edge2"].measured
    assert (moved["edge1"].usage["cpu"].used, moved["edge2"].usage["cpu"].used) == (0.5, 2.0)
    assert (
        moved["edge1"].links["robot1"].used_bytes_per_s,
        moved["edge2"].links["robot1"].used_bytes_per_s,
    ) == (1e6, 2e6)
    assert list(moved["edge2"].tasks) == ["slam"]
    assert not moved["edge1"].tasks


def test_a_task_that_is_not_recorded_uses_what_it_demands() -> None:
    shown = relocate_tasks(a_snapshot(edge1=a_sample(), edge2=a_sample()), TASKS, {"slam": "edge2"}).hosts[
        "edge2"
    ]
    assert shown.measured
    assert shown.usage["cpu"].used == 1.0
    assert shown.tasks["slam"].state is TaskState.READY


def test_a_variant_that_moves_once_lives_on_the_other_host() -> None:
    """edge1: 4 - 2.5 + 1.5 - 1 = 2 of 4 left, edge2: 3 of 4. Moving pays once; then it stays although the record stays."""
    world = [recorded(2.5, 0.0, NOW + 60.0 * cycle) for cycle in range(5)]
    mover = replay_snapshots(INVENTORY, TASKS, world, Scheme(name="cpu", policy=CPU))
    stayer = replay_snapshots(
        INVENTORY, TASKS, world, Scheme(name="static", policy=replace(CPU, name=PolicyName.STATIC))
    )
    assert (mover.cycles, mover.handoffs, mover.unplaced) == (5, 1, 0)
    assert stayer.handoffs == 0
    assert stayer.utilisation["cpu"].peak == pytest.approx(2.5 / 4)
    assert mover.utilisation["cpu"].peak == pytest.approx(1.5 / 4)
    assert mover.utilisation["cpu"].mean == stayer.utilisation["cpu"].mean == pytest.approx(2.5 / 8)


def test_what_was_never_seen_running_is_named() -> None:
    idle = a_sample(links={"robot1": a_link()})
    empty = [a_snapshot(taken_at=NOW + cycle, edge1=idle, edge2=idle) for cycle in range(2)]
    variant = Scheme(name="cpu", policy=CPU)
    assert replay_snapshots(INVENTORY, TASKS, empty, variant).assumed == ("slam",)
    assert replay_snapshots(INVENTORY, TASKS, [*empty, recorded(2.0, 0.5, NOW + 5)], variant).assumed == ()


def test_a_task_that_nothing_takes_is_counted_in_each_cycle() -> None:
    empty = a_snapshot(edge1=a_sample(used=3.9), edge2=silent())
    result = replay_snapshots(
        INVENTORY, TASKS, [empty, replace(empty, taken_at=NOW + 60)], Scheme(name="u", policy=CPU)
    )
    assert result.unplaced == 2


def test_the_same_history_gives_the_same_numbers() -> None:
    world = [recorded(2.5, 0.0, NOW + 60.0 * cycle) for cycle in range(3)]
    assert replay_snapshots(INVENTORY, TASKS, world, Scheme(name="u", policy=CPU)) == replay_snapshots(
        INVENTORY, TASKS, world, Scheme(name="u", policy=CPU)
    )


def test_snapshots_come_back_from_the_rows_of_the_history() -> None:
    rows = [
        HostPoint(
            at=at,
            host="edge1",
            status=HostStatus.OK,
            usage=a_sample(used=2.0, used_memory=GI).usage,
        )
        for at in (60.0, 0.0)
    ]
    lost = HostPoint(at=60.0, host="edge2", status=HostStatus.UNREACHABLE)
    gone = HostPoint(
        at=60.0,
        host="edge9",
        status=HostStatus.OK,
        usage=a_sample(used=2.0, used_memory=GI).usage,
    )
    link = LinkPoint(at=60.0, edge="edge1", robot="robot1", capacity_bytes_per_s=1e7, used_bytes_per_s=1e6)
    task = TaskPoint(
        at=60.0,
        task="slam",
        host="edge1",
        state=TaskState.READY,
        used=Usage(cpu=1.0, memory=1e6, network=1e3),
        age_s=30.0,
    )
    first, second = snapshots_from_points(INVENTORY, [*rows, lost, gone], [link], [task])
    assert (first.taken_at, list(first.hosts)) == (0.0, ["edge1"])
    assert (second.taken_at, list(second.hosts)) == (60.0, ["edge1", "edge2"])
    assert second.hosts["edge1"].links["robot1"].used_bytes_per_s == 1e6
    assert second.hosts["edge1"].tasks["slam"].started_at == 30.0
    assert not second.hosts["edge2"].ok


def test_variants_are_every_combination_that_makes_a_difference() -> None:
    found = build_schemes(
        Policy(),
        [PolicyName.STATIC, PolicyName.PAPER, PolicyName.UTILITY],
        {name: WEIGHT_PRESETS[name] for name in ("cpu", "all")},
        [0.0, 0.1],
    )
    assert [each.name for each in found] == [
        "static", "paper cpu", "paper all", "utility cpu margin 0", "utility cpu margin 0.1", "utility all margin 0", "utility all margin 0.1",
    ]  # fmt: skip
    assert [each.name for each in build_schemes(Policy(), [], {}, [])] == ["utility all"]
    assert list(parse_weight_sets("cpu=.5,task=1")) == ["cpu=.5,task=1"]
    with pytest.raises(ValueError, match="unknown weights 'ram'"):
        parse_weight_sets("cpu,ram")
