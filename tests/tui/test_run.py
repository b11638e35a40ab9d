# SPDX-License-Identifier: Apache-2.0
"""What the view asks of a fleet: probes, history, logs and marks, for real over simulated hosts."""

from pathlib import Path

import pytest

from edgectl.state.manager_state import load_manager_state
from edgectl.tui.run import build_fleet_backend
from edgectl.usecases.fleet import Fleet
from tests.builders import NOW, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    hosts = FakeFleet.of(["edge1", "edge2"])
    now = [NOW]

    def clock() -> float:
        now[0] += 1.0
        return now[0]

    return Fleet(
        inventory=an_inventory(an_edge("edge1"), an_edge("edge2")), tasks=some_tasks(a_task("slam")), transport=hosts.transport,
        state=tmp_path, clock=clock,
    )  # fmt: skip


def test_each_picture_has_the_samples_before_it(fleet: Fleet) -> None:
    ends = iter([False, False, True])
    frames = list(build_fleet_backend(fleet).frames(lambda: next(ends)))
    assert [len(frame.host_points["edge1"]) for frame in frames] == [1, 2, 3]
    assert frames[-1].host_points["edge1"][-1].at == frames[-1].snapshot.taken_at
    assert list(frames[0].tasks.tasks) == ["slam"]


def test_cordon_and_back(fleet: Fleet) -> None:
    cordon = build_fleet_backend(fleet).cordon
    assert cordon is not None
    cordon("edge1", True)
    assert load_manager_state(fleet.state).cordons == {"edge1"}
    cordon("edge1", False)
    assert load_manager_state(fleet.state).cordons == set()


def test_readonly_has_no_way_to_cordon(fleet: Fleet) -> None:
    assert build_fleet_backend(fleet, readonly=True).cordon is None
