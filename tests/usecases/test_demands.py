# SPDX-License-Identifier: Apache-2.0
"""Measured demand from the history into the snapshot, and from the snapshot alone into the decision."""

import dataclasses
from pathlib import Path

import pytest

from edgectl.formats.kinds import SNAPSHOT_KIND
from edgectl.model.assignment import DemandSource
from edgectl.model.manager_state import MeasuredDemand
from edgectl.model.policy import Policy
from edgectl.model.resource import CPU, MEMORY, Usage
from edgectl.model.snapshot import Snapshot
from edgectl.state.manager_state import load_manager_state
from edgectl.state.store import Store
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.measured_demand import load_class_profiles, load_measured_demands
from edgectl.usecases.plan import make_plan
from edgectl.usecases.probe import probe_fleet
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

SLAM = a_task("slam", cpu=None, memory=GI, robots=["robot1"])


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    hosts = FakeFleet.of(["edge1", "edge2", "robot1"])
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"))
    return Fleet(
        inventory=inventory,
        tasks=some_tasks(SLAM),
        transport=hosts.transport,
        state=tmp_path,
        clock=lambda: NOW,
    )


def record_samples(fleet: Fleet, *, samples: int = 100, cores: float = 4.0, host: str = "edge1") -> None:
    """Record samples before now, 10 s apart, of which the n-th used n hundredths of a core."""
    with Store.open(fleet.state) as store:
        for n in range(samples):
            run = a_run(
                spec_hash=SLAM.spec_hash,
                started_at=NOW - 5000,
                used=Usage(cpu=(n + 1) / 100, memory=GI, network=1e5),
            )
            sample = a_sample(cores=cores, memory=8 * GI, links={"robot1": a_link()}, tasks={"slam": run})
            store.record_snapshot(a_snapshot({host: sample}, taken_at=NOW - 10 * (samples - n)))


def a_seen_snapshot(fleet: Fleet) -> Snapshot:
    """Two hosts of one size, of which edge2 does not answer."""
    return a_snapshot(edge1=a_sample(cores=4.0, memory=8 * GI, links={"robot1": a_link()}), edge2=silent())


def test_p95_of_the_class_is_loaded(fleet: Fleet) -> None:
    record_samples(fleet)
    found = load_measured_demands(fleet, a_seen_snapshot(fleet))
    assert found == {
        ("slam", "4c-8Gi"): MeasuredDemand(
            samples=100,
            span_s=990.0,
            used={"cpu": 0.95, "memory": GI, "network": 1e5},
            spec_hash=SLAM.spec_hash,
        )
    }


def test_a_silent_host_counts_by_its_last_answer(fleet: Fleet) -> None:
    record_samples(fleet, host="edge2", cores=8.0)
    with Store.open(fleet.state) as store:
        store.record_snapshot(a_snapshot(taken_at=NOW - 1, edge2=silent()))
    assert list(load_measured_demands(fleet, a_seen_snapshot(fleet))) == [("slam", "8c-8Gi")]


def test_nothing_is_read_where_all_is_declared_or_nothing_is_kept(fleet: Fleet) -> None:
    assert load_measured_demands(fleet, a_seen_snapshot(fleet)) == {}
    assert not list(fleet.state.iterdir())
    record_samples(fleet, samples=1)
    (fleet.state / "history.db").write_bytes(b"no database at all")
    declared = dataclasses.replace(fleet, tasks=some_tasks(a_task("slam", cpu=1.0)), warn=pytest.fail)
    assert load_measured_demands(declared, a_seen_snapshot(fleet)) == {}


def test_another_command_begins_a_new_history(fleet: Fleet) -> None:
    record_samples(fleet)
    changed = dataclasses.replace(fleet, tasks=some_tasks(dataclasses.replace(SLAM, spec_hash="another")))
    assert load_measured_demands(changed, a_seen_snapshot(fleet)) == {}
    assert load_class_profiles(changed, changed.tasks.tasks.values()) == []


def test_a_probe_carries_it_and_the_snapshot_alone_decides_the_same(fleet: Fleet) -> None:
    first = probe_fleet(fleet)
    sample = first.hosts["edge1"]
    assert sample.measured
    with Store.open(fleet.state) as store:
        for n in range(60):
            run = a_run(spec_hash=SLAM.spec_hash, started_at=NOW - 5000, used=Usage(cpu=1.25, memory=GI))
            store.record_snapshot(
                dataclasses.replace(
                    first,
                    taken_at=NOW - 6 * n - 6,
                    hosts={"edge1": dataclasses.replace(sample, tasks={"slam": run})},
                )
            )
    snapshot = probe_fleet(fleet)
    assert snapshot.manager is not None
    assert {found.used["cpu"] for found in snapshot.manager.measured.values()} == {1.25}
    decided = make_plan(fleet, Policy())
    rho = {rho.resource: rho for rho in decided.steps[0].decision.demand}
    assert (rho[CPU].value, rho[CPU].source, rho[CPU].samples) == (
        1.25,
        DemandSource.MEASURED,
        60,
    )
    assert rho[MEMORY].source is DemandSource.DECLARED
    again = make_plan(
        dataclasses.replace(fleet, state=Path("/nowhere")),
        Policy(),
        snapshot=SNAPSHOT_KIND.decode(SNAPSHOT_KIND.encode(decided.snapshot)),
    )
    assert again.steps == decided.steps
    assert again.expected == decided.expected


def test_the_memory_file_does_not_keep_what_the_history_has(fleet: Fleet) -> None:
    record_samples(fleet)
    applied = plan_and_apply(fleet, Policy())
    assert applied.plan.snapshot.manager is not None
    assert applied.plan.snapshot.manager.measured
    assert load_manager_state(fleet.state).measured == {}


def test_profiles_are_by_class_without_asking_a_host(fleet: Fleet) -> None:
    record_samples(fleet)
    record_samples(fleet, host="edge2", cores=8.0, samples=7)
    small, large = load_class_profiles(fleet, fleet.tasks.tasks.values())
    assert (
        small.kind,
        small.hosts,
        small.enough,
        small.profile.used["cpu"].p95,
        small.profile.used["cpu"].most,
    ) == (
        "4c-8Gi",
        ("edge1",),
        True,
        0.95,
        1.0,
    )
    assert (large.kind, large.hosts, large.enough, large.profile.samples) == ("8c-8Gi", ("edge2",), False, 7)
