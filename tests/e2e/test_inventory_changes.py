# SPDX-License-Identifier: Apache-2.0
"""An inventory that changes while tasks run, over real sshd on three hosts: one instance before and after."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.agent.supervise import records
from edgectl.errors import UsageError
from edgectl.model.inventory import Host, Inventory
from edgectl.model.plan import Action
from edgectl.usecases import operator_marks
from edgectl.usecases.logs import read_log
from edgectl.usecases.plan import make_plan
from edgectl.views.reasons import describe_reason
from tests.builders import a_task, an_inventory
from tests.e2e.bench import (
    EAGER,
    Bench,
    a_mark,
    a_sleeper,
    a_slice,
    list_sleepers,
    open_bench,
    wait_for_sleepers,
)
from tests.sshd import Lab

EDGES = {"edge1": "edge1", "edge2": "edge2", "edge3": "robot1"}


def list_edges(lab: Lab) -> list[Host]:
    """Three edges that answer: one that does not would hold what another test's manager may have placed."""
    return [replace(a_slice(lab.host(name)), name=edge) for edge, name in EDGES.items()]


@pytest.fixture
def bench(lab: Lab, tmp_path: Path) -> Iterator[Bench]:
    with open_bench(an_inventory(*list_edges(lab)), tmp_path / "manager", lab) as made:
        yield made


def start_pinned(bench: Bench) -> tuple[Bench, str]:
    """Start ``slam`` on edge1; the mark of its sleepers. Afterwards it may run anywhere."""
    mark = a_mark()
    slam = a_sleeper("slam", mark)
    bench.using(replace(slam, hosts=replace(slam.hosts, pin="edge1"))).apply()
    wait_for_sleepers(mark)
    return bench.using(slam), mark


def with_hosts(bench: Bench, *hosts: Host) -> Bench:
    inventory: Inventory = an_inventory(*hosts)
    return bench.using(*bench.fleet.tasks.tasks.values(), inventory=inventory)


@pytest.mark.parametrize("change", ["remove", "address", "user"])
def test_a_changed_inventory_starts_no_second_copy(lab: Lab, bench: Bench, change: str) -> None:
    bench, mark = start_pinned(bench)
    running = list_sleepers(mark)
    edge1, edge2, edge3 = list_edges(lab)
    changed = {
        "remove": [edge2, edge3],
        # The same name for another machine: edge1 is now what edge2 was, edge2 is gone.
        "address": [replace(edge1, host="edge2"), edge3],
        "user": [replace(edge1, user="nobody-here"), edge2, edge3],
    }[change]
    edited = with_hosts(bench, *changed)
    (step,) = edited.apply().plan.steps
    assert step.action is Action.HOLD
    assert "edgectl fence edge1" in describe_reason(step)
    assert sorted(list_sleepers(mark)) == sorted(running)
    # The edit is taken back: everything is as before, and nothing was lost on the way.
    assert bench.actions() == {"slam": Action.KEEP}
    bench.stop("slam")
    assert list_sleepers(mark) == []
    # Its old place was seen empty: the edited inventory may start it.
    (step,) = edited.plan().steps
    assert step.action is Action.START


def test_a_renamed_host_keeps_its_tasks_and_stops_them_by_their_former_name(lab: Lab, bench: Bench) -> None:
    bench, mark = start_pinned(bench)
    edge1, edge2, edge3 = list_edges(lab)
    edited = with_hosts(bench, replace(edge1, name="jetson-a"), edge2, edge3)
    (step,) = edited.apply().plan.steps
    assert (step.action, step.decision.host) == (Action.KEEP, "jetson-a")
    assert bench.apply().plan.steps[0].action is Action.KEEP
    assert edited.actions() == {"slam": Action.KEEP}
    edited.stop("slam")
    assert list_sleepers(mark) == []
    # The directories of its place were seen without it.
    (step,) = edited.plan().steps
    assert step.action is Action.START


def test_a_renamed_host_measures_its_tasks_shows_their_logs_and_keeps_them_from_fencing(
    lab: Lab, bench: Bench
) -> None:
    mark, (edge1, *others) = a_mark(), list_edges(lab)
    slam = replace(a_task("slam", command=f"sleep {mark} & echo up; while :; do :; done"), self_fence=600.0)
    bench = bench.using(replace(slam, hosts=replace(slam.hosts, pin="edge1")))
    bench.apply()
    edited = with_hosts(bench.using(slam), replace(edge1, name="jetson-a"), *others)
    sample = edited.sample("slam")
    assert sample.used["cpu"] > 0.01
    assert sample.used["memory"] > 0
    usage = edited.probe().hosts["jetson-a"].usage
    assert usage["memory"].used >= sample.used["memory"] / 2
    assert read_log(edited.fleet, "slam", tail=1) == "up\n"
    # What the supervisor of the task reads is written by every request to the host under its new name.
    (record,) = lab["edge1"].home.rglob("hosts/edge1/contact")
    before = records.read_record(str(record))["at"]
    edited.probe()
    assert records.read_record(str(record))["at"] > before
    edited.stop()
    assert list_sleepers(mark) == []


def test_a_fence_frees_the_tasks_of_a_host_that_left(lab: Lab, bench: Bench) -> None:
    bench, _ = start_pinned(bench)
    edited = with_hosts(bench, *list_edges(lab)[1:])
    with pytest.raises(UsageError, match="edge7"):
        operator_marks.fence_hosts(edited.fleet, ["edge7"])
    operator_marks.fence_hosts(edited.fleet, ["edge1"])
    (step,) = edited.plan().steps
    assert (step.action, step.decision.previous_host) == (Action.START, "edge1")
    operator_marks.unfence_hosts(edited.fleet, ["edge1"])
    assert edited.actions() == {"slam": Action.HOLD}


def test_one_machine_under_two_names_is_refused(lab: Lab, bench: Bench) -> None:
    whole = [replace(host, capacity=None) for host in list_edges(lab)[:2]]
    with pytest.raises(UsageError, match="edge1 and edge2 are one machine"):
        make_plan(with_hosts(bench, *whole).fleet, EAGER)
