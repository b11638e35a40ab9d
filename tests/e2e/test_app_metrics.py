# SPDX-License-Identifier: Apache-2.0
"""Metrics and files of a job over real sshd: shown while it runs and after its end, and fetched."""

import random
import time
from pathlib import Path

import pytest

from edgectl.gateway.fetch import fetch_file
from edgectl.model.inventory import Connection, Role
from edgectl.model.snapshot import TaskSample, TaskState
from edgectl.model.task import TaskKind
from edgectl.state import store_rows as rows
from edgectl.state.store import Store
from tests.agent.conftest import eventually
from tests.builders import a_task, an_inventory
from tests.e2e.bench import GENTLE, Bench, a_slice, open_bench
from tests.sshd import Lab


def wait_for_metrics(bench: Bench, task: str, values: dict[str, float], state: TaskState) -> TaskSample:
    """Return its sample once it has this state and exactly these metrics."""

    def seen() -> TaskSample | None:
        found = bench.probe().hosts["edge1"].tasks.get(task)
        return found if found is not None and (found.metrics, found.state) == (values, state) else None

    found: TaskSample = eventually(seen, seconds=60)
    return found


@pytest.mark.parametrize("connection", [Connection.SSH, Connection.OPENSSH])
def test_a_mapper_says_how_it_does_and_its_map_is_fetched(
    lab: Lab, tmp_path: Path, connection: Connection
) -> None:
    work, name = tmp_path / "work", f"mapper-{connection.value}-{time.time_ns()}"
    work.mkdir()
    picture = random.Random(1).randbytes(1_500_000)
    (work / "drawn").write_bytes(picture)
    command = 'echo "map/fps 29.97" >>"$EDGECTL_METRICS"; until [ -e go ]; do sleep 0.05; done; cp drawn map.pgm; echo "loss 1e-3" >>"$EDGECTL_METRICS"'
    inventory = an_inventory(
        a_slice(lab.host("edge1", connection=connection)), a_slice(lab.host("robot1", role=Role.ROBOT))
    )
    task = a_task(name, command=command, workdir=str(work), kind=TaskKind.JOB, stop=GENTLE)
    with open_bench(inventory, tmp_path / "manager", lab) as made:
        bench = made.using(task)
        bench.apply()
        wait_for_metrics(bench, name, {"map/fps": 29.97}, TaskState.RUNNING)
        (work / "go").touch()
        wait_for_metrics(bench, name, {"loss": 0.001, "map/fps": 29.97}, TaskState.COMPLETED)
        assert (
            fetch_file(bench.fleet.transport, inventory.hosts["edge1"], task, "map.pgm", timeout=60.0)
            == picture
        )
        with Store.open(bench.fleet.state) as store:
            kept = [
                (point.name, point.value)
                for point in store.stream(rows.METRICS, "metric_samples", "at, name")
                if point.task == name
            ]
        assert kept == [("map/fps", 29.97), ("loss", 0.001)]
