# SPDX-License-Identifier: Apache-2.0
"""Noise of readings from the history into the snapshot, and from the snapshot alone into the decision."""

from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from edgectl.formats.kinds import SNAPSHOT_KIND
from edgectl.model.assignment import Reason
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.state.manager_state import load_manager_state
from edgectl.state.store import Store
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from edgectl.usecases.reading_noise import load_reading_noise
from edgectl.views.plan_sections import list_plan_notes
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
from tests.executor.fake_fleet import FakeFleet

RUNS = {"slam": a_run(started_at=NOW - 3600.0)}


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    return Fleet(
        inventory=an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1")),
        tasks=some_tasks(a_task(cpu=2.0)),
        transport=FakeFleet.of(["edge1", "edge2", "robot1"]).transport,
        state=tmp_path,
        clock=lambda: NOW,
    )


def record_readings(
    fleet: Fleet, *, cpu: float = 0.0, memory: float = 0.0, link: float = 0.0, count: int = 60
) -> None:
    """Record readings of edge1 that vary by these shares of the capacity; edge2 does the same without a task."""
    dice = Random(1)
    with Store.open(fleet.state) as store:
        for n in range(count):
            sample = a_sample(
                used=4.0 * (0.5 + dice.gauss(0.0, cpu)),
                memory=8 * GI,
                used_memory=8 * GI * (0.5 + dice.gauss(0.0, memory)),
                links={"robot1": a_link(10e6, 10e6 * (0.5 + dice.gauss(0.0, link))), "robot2": a_link()},
            )
            hosts = {"edge1": replace(sample, tasks=RUNS), "edge2": sample}
            store.record_snapshot(a_snapshot(hosts, taken_at=NOW - 10.0 * (count - n)))
        store.record_snapshot(a_snapshot(taken_at=NOW - 1.0, edge1=silent()))


def a_busy_snapshot(used: float) -> Snapshot:
    return a_snapshot(edge1=a_sample(used=used, tasks=RUNS), edge2=a_sample())


def test_the_noise_of_full_hosts_is_measured_where_it_widens_the_slack(fleet: Fleet) -> None:
    record_readings(fleet, cpu=0.05, memory=0.005, link=0.06)
    found = load_reading_noise(fleet, a_busy_snapshot(used=2.3))
    assert found == {"edge1": {"cpu": pytest.approx(0.05, rel=0.3), "network": pytest.approx(0.06, rel=0.3)}}
    assert load_reading_noise(fleet, a_busy_snapshot(used=1.7)) == {}  # 1.7 + 2 of 4 cores: there is room
    assert load_reading_noise(fleet, a_snapshot(edge1=a_sample(used=4.0), edge2=a_sample())) == {}


def test_few_readings_are_none(fleet: Fleet) -> None:
    record_readings(fleet, cpu=0.1, count=9)
    assert load_reading_noise(fleet, a_busy_snapshot(used=2.3)) == {}


def test_the_snapshot_alone_decides_the_same_and_the_plan_says_why_the_task_stays(fleet: Fleet) -> None:
    """edge1 is 7.5 % above its 4 cores, more than the slack of a quiet host."""
    record_readings(fleet, cpu=0.05)
    snapshot = a_busy_snapshot(used=2.3)
    quiet = make_plan(fleet, Policy(move_margin=2.0), snapshot=replace(snapshot, manager=ManagerState()))
    assert quiet.steps[0].decision.reason is Reason.FORCED_INFEASIBLE
    noise = load_reading_noise(fleet, snapshot)
    snapshot = replace(snapshot, manager=ManagerState(managed=True, noise=noise))
    made = make_plan(fleet, Policy(move_margin=2.0), snapshot=snapshot)
    assert made.steps[0].decision.reason is Reason.BELOW_MARGIN
    saved = SNAPSHOT_KIND.decode(SNAPSHOT_KIND.encode(snapshot))
    assert make_plan(fleet, Policy(move_margin=2.0), snapshot=saved) == made
    cpu = noise["edge1"]["cpu"]
    assert (
        f"edge1 may be up to {2 * cpu:.1%} above its cpu capacity before a task leaves: its readings vary by "
        f"{cpu:.1%}"
    ) in list_plan_notes(made)


def test_a_probe_carries_it_and_the_memory_file_does_not_keep_it(fleet: Fleet) -> None:
    fleet = replace(fleet, tasks=some_tasks(a_task(cpu=None)))  # a measured demand may be anything
    (host,) = {step.decision.host for step in plan_and_apply(fleet, Policy()).plan.steps}
    assert host == "edge1"
    record_readings(fleet, cpu=0.05)
    applied = plan_and_apply(fleet, Policy()).plan.snapshot.manager
    assert applied is not None
    assert applied.noise["edge1"]["cpu"] > 0.03
    assert load_manager_state(fleet.state).noise == {}
