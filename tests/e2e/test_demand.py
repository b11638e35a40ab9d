# SPDX-License-Identifier: Apache-2.0
"""A real task is measured by real probes, and the next plan uses the measured demand."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.model.assignment import DemandSource
from edgectl.model.resource import CPU
from edgectl.model.snapshot import Snapshot
from edgectl.state.store import Store
from edgectl.usecases.measured_demand import load_class_profiles
from edgectl.usecases.probe import probe_fleet
from tests.builders import a_task, an_edge, an_inventory
from tests.e2e.bench import GENTLE, QUICK, Bench, a_local, open_bench

PROBES, REPEATED = 3, 30
# Three tenths of a core by its own clock: 30 ms of work, 70 ms of sleep.
BURN = """import time
while True:
    end = time.process_time() + 0.03
    while time.process_time() < end: pass
    time.sleep(0.07)
"""
SLAM = a_task(
    "slam", command=f"exec {sys.executable} -c '{BURN}'", cpu=None, memory=None, throughput=None, stop=GENTLE
)


@pytest.fixture
def bench(tmp_path: Path, isolated: Path) -> Iterator[Bench]:
    with open_bench(
        an_inventory(a_local(an_edge("edge1"), "127.0.0.33")), tmp_path / "manager", isolated
    ) as running:
        yield running.using(SLAM)


def shift_back(snapshot: Snapshot, seconds: float) -> Snapshot:
    """Return the same samples so many seconds earlier, of a task that had run for a quarter of an hour by
    then.
    """
    host = snapshot.hosts["edge1"]
    tasks = {
        name: replace(task, started_at=task.started_at - 900.0 - seconds) for name, task in host.tasks.items()
    }
    return replace(
        snapshot, taken_at=snapshot.taken_at - seconds, hosts={"edge1": replace(host, tasks=tasks)}
    )


def test_what_a_task_burns_is_what_the_next_plan_charges(bench: Bench) -> None:
    bench.apply()
    unknown = bench.plan().steps[0].decision.demand
    assert [(rho.value, rho.source) for rho in unknown] == [(0.0, DemandSource.NONE)] * 2
    seen = [probe_fleet(bench.fleet, QUICK) for _ in range(PROBES)]
    with Store.open(
        bench.fleet.state
    ) as store:  # repeat the measured samples: a test cannot take a quarter of an hour
        for number in range(1, REPEATED):
            for snapshot in seen:
                store.record_snapshot(shift_back(snapshot, 20.0 * number))
    plan = bench.plan()
    (found,) = load_class_profiles(bench.fleet, [SLAM])  # of the samples that the plan used
    assert found.enough
    assert found.profile.samples >= PROBES * (REPEATED - 1)
    assert 0.02 < found.profile.used["cpu"].p95 < 1.0, (
        "it burns 0.3 cores, less where the machine has little to give"
    )
    cpu, memory = plan.steps[0].decision.demand
    assert (cpu.resource, cpu.value, cpu.source) == (
        CPU,
        found.profile.used["cpu"].p95,
        DemandSource.MEASURED,
    )
    assert (memory.value, memory.source) == (found.profile.used["memory"].p95, DemandSource.MEASURED)
    assert memory.value > 1e6
    assert plan.expected["edge1"].used["cpu"] == pytest.approx(cpu.value)
