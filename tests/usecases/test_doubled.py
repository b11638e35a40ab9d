# SPDX-License-Identifier: Apache-2.0
"""Two living instances of a task: said after a change and by status, and resolved by the newest generation."""

import dataclasses
from pathlib import Path

import pytest

from edgectl.cli import exit_codes
from edgectl.errors import ExitCode
from edgectl.model.policy import Policy
from edgectl.state.manager_state import MANAGER_STATE_FILE_NAME
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.probe import probe_fleet
from edgectl.views.status import StatusView
from tests.executor.fake_fleet import FakeHost, Request
from tests.usecases.test_usecases import Bench

POLICY = Policy()


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def run_second(host: FakeHost, first: FakeHost, *, generation: int) -> None:
    """An instance of slam as another manager would have started it."""
    host.tasks["slam"] = {**first.tasks["slam"], "instance": "second", "generation": generation}


@pytest.mark.parametrize("recorded", [True, False])
def test_status_says_it_first_and_the_next_apply_keeps_one(bench: Bench, *, recorded: bool) -> None:
    """The recorded instance, whatever another host claims; the newest where no record is left."""
    plan_and_apply(bench.fleet, POLICY)
    first = bench.hosts[bench.hosts.placed["slam"]]
    other = bench.hosts["edge1" if first.name == "edge2" else "edge2"]
    generation = first.tasks["slam"]["generation"]
    assert isinstance(generation, int)
    run_second(other, first, generation=generation + 5)
    if not recorded:
        (bench.fleet.state / MANAGER_STATE_FILE_NAME).unlink()
    snapshot = probe_fleet(bench.fleet)
    view = StatusView(snapshot, bench.fleet.inventory, bench.fleet.tasks)
    assert (
        view.table().splitlines()[1]
        == "DOUBLED: slam runs on edge1 and edge2; edgectl apply stops all but one"
    )
    assert view.warnings()[0].startswith("DOUBLED: slam")
    assert exit_codes.of_snapshot(snapshot, bench.fleet.inventory, allow_unreachable=True) is ExitCode.PARTLY
    applied = plan_and_apply(bench.fleet, POLICY)
    assert bench.hosts.placed["slam"] == (first.name if recorded else other.name)
    assert "slam" not in (other if recorded else first).tasks
    assert exit_codes.of_applied(applied) is ExitCode.DONE


def test_an_apply_after_which_a_task_runs_twice_says_so_and_exits_with_4(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    first = bench.hosts[bench.hosts.placed["slam"]]
    other = bench.hosts["edge1" if first.name == "edge2" else "edge2"]

    def stop_and_double(request: Request) -> Request:
        run_second(other, first, generation=1)
        return first._stop(request)

    first.faults["stop:navigation"] = stop_and_double
    other.faults["stop:navigation"] = stop_and_double
    without = dataclasses.replace(
        bench.fleet.tasks,
        tasks={"slam": bench.fleet.tasks.tasks["slam"]},
    )
    applied = plan_and_apply(bench.with_tasks(without), POLICY)
    assert applied.results is not None
    assert applied.results.done
    assert applied.doubled == {"slam": ("edge1", "edge2")}
    assert exit_codes.of_applied(applied) is ExitCode.PARTLY
    assert "DOUBLED: slam runs on edge1 and edge2; edgectl apply stops all but one" in bench.said
