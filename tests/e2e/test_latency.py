# SPDX-License-Identifier: Apache-2.0
"""Latency of a task over real sshd: from the values that it writes to tables, metrics and the history."""

import time
from pathlib import Path

from edgectl.model.latency import LatencyRule, LatencySample
from edgectl.state import store_rows as rows
from edgectl.state.store import Store
from edgectl.views.describe_task import TaskDetailsView
from edgectl.views.status import StatusView
from edgectl.views.top_tasks import TopTasksView
from tests.agent.conftest import eventually
from tests.builders import a_task, an_inventory
from tests.e2e.bench import GENTLE, a_slice, open_bench
from tests.sshd import Lab

# 10, 20 .. 1000 ms.
WRITE = 'for each in $(seq 10 10 1000); do echo "age_ms $each" >>"$EDGECTL_METRICS"; done; exec sleep 600'


def test_percentiles_and_misses_are_shown_and_kept(lab: Lab, tmp_path: Path) -> None:
    name = f"cmd-{time.time_ns()}"
    inventory = an_inventory(a_slice(lab.host("edge1")))
    task = a_task(name, command=WRITE, stop=GENTLE, latency=LatencyRule(metric="age_ms"), deadline=0.9)
    with open_bench(inventory, tmp_path / "manager", lab) as made:
        bench = made.using(task)
        bench.apply()

        def read() -> LatencySample | None:
            sample = bench.probe().hosts["edge1"].tasks[name].latency
            return sample if sample is not None and sample.count == 100 else None

        found: LatencySample = eventually(read, seconds=60)
        assert (found.misses, found.bound_ms, found.sum_ms, found.max_ms) == (10, 900.0, 50500.0, 1000.0)
        for value, exact in ((found.p50_ms, 500.0), (found.p95_ms, 950.0), (found.p99_ms, 990.0)):
            assert value is not None
            assert abs(value - exact) <= 0.01 * exact
        snapshot, tasks = bench.probe(), bench.fleet.tasks
        status = StatusView(snapshot, inventory, tasks)
        top = TopTasksView(snapshot, inventory, tasks, ())
        for view in (status, top):
            heading = next(line for line in view.table().splitlines() if "P99" in line)
            row = view.table().split(heading + "\n")[1].splitlines()[0].split()
            assert row[:2] == [name, "edge1"]
            assert row[-5:] == ["900", "ms", "10", "10", "100"]
            assert view.items()[0]["latency"]["misses"] == 10  # type: ignore[index]
        details = TaskDetailsView(name, snapshot, inventory, tasks, None, None).table()
        assert "10 recently, 10 of this instance above 900 ms" in details
        with Store.open(bench.fleet.state) as store:
            kept = {
                point.name: point.value
                for point in store.stream(rows.METRICS, "metric_samples", "at, name")
                if point.task == name
            }
        assert (kept["latency/values"], kept["latency/misses"]) == (100.0, 10.0)
        assert kept["latency/p95_ms"] == found.p95_ms
