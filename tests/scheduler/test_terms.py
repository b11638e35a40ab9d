# SPDX-License-Identifier: Apache-2.0
"""Capacity, expected load and the resource terms, worked by hand."""

import pytest

from edgectl.model.assignment import RejectionRule
from edgectl.model.inventory import Capacity
from edgectl.model.resource import CPU, NETWORK, Usage
from edgectl.model.snapshot import TaskState
from tests.builders import (
    GI,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import decisions_by_task, list_terms, ranking_by_host, run_assign


def test_one_edge_one_task() -> None:
    inventory = an_inventory(an_edge(), a_robot())
    snapshot = a_snapshot(edge1=a_sample(used=1.0, used_memory=1 * GI, links={"robot1": a_link(10e6, 2e6)}))
    tasks = some_tasks(a_task("slam", cpu=0.6, memory=1 * GI, throughput=3e6, robots=["robot1"]))
    assignment = run_assign(inventory, tasks, snapshot)
    decision = decisions_by_task(assignment)["slam"]
    # cpu (4 - 1 - .6) / 4 = .6; mem (4 - 1 - 1) / 4 = .5; net (10 - 2 - 3) / 10 = .5; task .5; total (.6 + .5 + .5 + .5) / 4 = .525
    assert list_terms(ranking_by_host(decision)["edge1"]) == pytest.approx((0.6, 0.5, 0.5, 0.5, 0.525))
    assert (decision.host, decision.lead, decision.challenger) == ("edge1", None, None)
    expected = assignment.expected["edge1"]
    assert (expected.used["cpu"], expected.used["memory"], expected.links) == (1.6, 2 * GI, {"robot1": 5e6})


def test_limits_stand_in_numerator_and_denominator() -> None:
    inventory = an_inventory(an_edge(cpu_limit=0.8, memory_limit=1.2))
    snapshot = a_snapshot(edge1=a_sample(used=1.0, used_memory=1 * GI))
    entry = ranking_by_host(
        decisions_by_task(run_assign(inventory, some_tasks(a_task(cpu=0.6, memory=1 * GI)), snapshot))["slam"]
    )["edge1"]
    # cpu: Delta = 4 x .8 = 3.2, (3.2 - 1 - .6) / 3.2 = .5; mem: Delta = 4 x 1.2 = 4.8, (4.8 - 1 - 1) / 4.8 = .58333
    assert (entry.terms["cpu"], entry.terms["memory"]) == pytest.approx((0.5, 2.8 / 4.8))


def test_a_percent_demand_is_of_the_capacity_before_limits_and_of_the_link() -> None:
    inventory = an_inventory(an_edge(cpu_limit=0.5), a_robot())
    snapshot = a_snapshot(edge1=a_sample(links={"robot1": a_link(8e6)}))
    task = a_task(cpu="25%", memory="50%", throughput="25%", robots=["robot1"])
    entry = ranking_by_host(decisions_by_task(run_assign(inventory, some_tasks(task), snapshot))["slam"])[
        "edge1"
    ]
    # cpu: rho = .25 x 4 = 1 of Delta 2: (2 - 0 - 1) / 2 = .5; mem: rho = 2 Gi of 4: .5; net: rho = 2 of 8 MB/s: .75
    assert (entry.terms["cpu"], entry.terms["memory"], entry.terms["network"]) == pytest.approx(
        (0.5, 0.5, 0.75)
    )


def test_declared_capacity_and_declared_link_win() -> None:
    inventory = an_inventory(
        an_edge(capacity=Capacity(cpu=2.0, memory=2 * GI)), a_robot(), links={("edge1", "robot1"): 4e6}
    )
    snapshot = a_snapshot(edge1=a_sample(used=0.5, links={"robot1": a_link(100e6, 1e6)}))
    entry = ranking_by_host(
        decisions_by_task(
            run_assign(inventory, some_tasks(a_task(cpu=0.5, throughput=1e6, robots=["robot1"])), snapshot)
        )["slam"]
    )["edge1"]
    # cpu (2 - .5 - .5) / 2 = .5; net (4 - 1 - 1) / 4 = .5
    assert (entry.terms["cpu"], entry.terms["network"]) == pytest.approx((0.5, 0.5))


def test_the_worst_link_counts_and_demand_is_per_link() -> None:
    inventory = an_inventory(an_edge(), a_robot("robot1"), a_robot("robot2"))
    snapshot = a_snapshot(edge1=a_sample(links={"robot1": a_link(10e6), "robot2": a_link(5e6, 1e6)}))
    assignment = run_assign(
        inventory, some_tasks(a_task(throughput=1e6, robots=["robot1", "robot2"])), snapshot
    )
    # robot1 (10 - 0 - 1) / 10 = .9; robot2 (5 - 1 - 1) / 5 = .6
    assert ranking_by_host(decisions_by_task(assignment)["slam"])["edge1"].terms["network"] == pytest.approx(
        0.6
    )
    assert assignment.expected["edge1"].links == {"robot1": 1e6, "robot2": 2e6}


def test_without_a_robot_the_network_term_is_1() -> None:
    inventory = an_inventory(an_edge(), an_edge("edge2"))
    decision = decisions_by_task(
        run_assign(
            inventory, some_tasks(a_task(throughput=1e6)), a_snapshot(edge1=a_sample(), edge2=a_sample())
        )
    )["slam"]
    assert [entry.terms["network"] for entry in decision.ranking] == [1.0, 1.0]


def test_onboard_needs_no_link() -> None:
    inventory = an_inventory(an_edge(), a_robot(onboard=True))
    snapshot = a_snapshot(edge1=a_sample(used=3.5, links={"robot1": a_link()}), robot1=a_sample(cores=2.0))
    assignment = run_assign(
        inventory, some_tasks(a_task(cpu=0.5, throughput=5e6, robots=["robot1"])), snapshot
    )
    decision = decisions_by_task(assignment)["slam"]
    # robot1: (2 - .5) / 2 = .75, 1, 1, .5; edge1: 0, 1, .5, .5
    assert list_terms(ranking_by_host(decision)["robot1"]) == pytest.approx((0.75, 1.0, 1.0, 0.5, 0.8125))
    assert list_terms(ranking_by_host(decision)["edge1"]) == pytest.approx((0.0, 1.0, 0.5, 0.5, 0.5))
    assert decision.host == "robot1"
    assert assignment.expected["edge1"].links == {"robot1": 0.0}


def test_every_placement_is_expected_load_for_the_next() -> None:
    inventory = an_inventory(an_edge())
    tasks = some_tasks(a_task("a", cpu=1.0), a_task("b", cpu=1.0), a_task("c", cpu=1.0))
    found = decisions_by_task(run_assign(inventory, tasks, a_snapshot(edge1=a_sample())))
    # each sees one core more in use: a (4 - 0 - 1) / 4, then b (4 - 1 - 1) / 4, then c (4 - 2 - 1) / 4
    assert [found[name].ranking[0].terms["cpu"] for name in "abc"] == pytest.approx([0.75, 0.5, 0.25])


@pytest.mark.parametrize(
    ("used", "own", "left", "counts"),
    [
        (2.0, 0.5, 1.5, 1.0),  # gamma 2 - .5 = 1.5 of others; declared 1.0, uses less
        (2.0, 1.5, 0.5, 1.5),  # gamma 2 - 1.5 = .5 of others; uses more than declared
        (1.0, 1.5, 0.0, 1.5),  # smoothed load below the task's own: floor 0
    ],
)
def test_a_running_task_does_not_compete_with_itself(
    used: float, own: float, left: float, counts: float
) -> None:
    inventory = an_inventory(an_edge())
    snapshot = a_snapshot(edge1=a_sample(used=used, tasks={"slam": a_run(used=Usage(cpu=own))}))
    assignment = run_assign(inventory, some_tasks(a_task(cpu=1.0)), snapshot)
    assert assignment.decisions[0].ranking[0].terms["cpu"] == pytest.approx((4.0 - left - counts) / 4.0)
    assert assignment.expected["edge1"].used["cpu"] == pytest.approx(left + counts)


@pytest.mark.parametrize("state", [TaskState.STARTING, TaskState.RUNNING, TaskState.READY])
def test_every_living_state_counts_as_running(state: TaskState) -> None:
    snapshot = a_snapshot(edge1=a_sample(used=1.0, tasks={"slam": a_run(state, used=Usage(cpu=1.0))}))
    found = run_assign(an_inventory(an_edge()), some_tasks(a_task(cpu=1.5)), snapshot)
    assert found.expected["edge1"].used["cpu"] == 1.5


@pytest.mark.parametrize(
    ("links", "left"),
    [
        (None, {"robot1": 4.5e6, "robot2": 2.5e6}),  # 2 MB/s split evenly: 4 - 1 + 1.5, 2 - 1 + 1.5
        ({"robot1": 2e6}, {"robot1": 4e6, "robot2": 3.5e6}),  # as measured: 4 - 2 + 2, 2 + 1.5
    ],
)
def test_own_use_of_several_links(links: dict[str, float] | None, left: dict[str, float]) -> None:
    inventory = an_inventory(an_edge(), a_robot("robot1"), a_robot("robot2"))
    run = a_run(used=Usage(network=2e6), links=links)
    snapshot = a_snapshot(
        edge1=a_sample(links={"robot1": a_link(10e6, 4e6), "robot2": a_link(10e6, 2e6)}, tasks={"slam": run})
    )
    tasks = some_tasks(a_task(throughput=1.5e6, robots=["robot1", "robot2"]))
    assert run_assign(inventory, tasks, snapshot).expected["edge1"].links == left


def test_use_leaves_the_old_host_when_a_task_moves() -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"))
    snapshot = a_snapshot(
        edge1=a_sample(used=3.7, tasks={"slam": a_run(used=Usage(cpu=0.8))}), edge2=a_sample()
    )
    assignment = run_assign(inventory, some_tasks(a_task(cpu=0.8)), snapshot)
    # edge1 (4 - 2.9 - .8) / 4 = .075, edge2 (4 - .8) / 4 = .8: gain .725 / 4 = .18125 > .10
    assert assignment.decisions[0].host == "edge2"
    assert assignment.decisions[0].amount == pytest.approx(0.18125)
    assert {name: load.used["cpu"] for name, load in assignment.expected.items()} == pytest.approx(
        {"edge1": 2.9, "edge2": 0.8}
    )


def test_a_dead_link_and_a_missing_link() -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"), a_robot())
    snapshot = a_snapshot(
        edge1=a_sample(links={"robot1": a_link(0.0)}),
        edge2=a_sample(),
        edge3=a_sample(used=3.0, links={"robot1": a_link()}),
    )
    decision = decisions_by_task(
        run_assign(inventory, some_tasks(a_task(cpu=0.5, throughput=1e6, robots=["robot1"])), snapshot)
    )["slam"]
    found = ranking_by_host(decision)
    assert decision.host == "edge3"
    assert [(r.rule, r.resource, r.robot) for r in found["edge1"].rejections] == [
        (RejectionRule.NO_CAPACITY, NETWORK, "robot1")
    ]
    assert [(r.rule, r.resource, r.robot) for r in found["edge2"].rejections] == [
        (RejectionRule.NO_LINK, NETWORK, "robot1")
    ]
    assert (found["edge1"].terms["network"], found["edge1"].total, found["edge2"].total) == (None, None, None)
    assert found["edge1"].terms["cpu"] == pytest.approx(0.875)


def test_an_edge_with_a_limit_of_nothing_has_no_capacity() -> None:
    inventory = an_inventory(an_edge("edge1", cpu_limit=0.0), an_edge("edge2"))
    decision = decisions_by_task(
        run_assign(inventory, some_tasks(a_task()), a_snapshot(edge1=a_sample(), edge2=a_sample(used=4.0)))
    )["slam"]
    assert decision.host == "edge2"
    assert [(r.rule, r.resource) for r in ranking_by_host(decision)["edge1"].rejections] == [
        (RejectionRule.NO_CAPACITY, CPU)
    ]


def test_no_robots_at_all() -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"))
    found = decisions_by_task(
        run_assign(
            inventory,
            some_tasks(a_task("a", cpu=1.0), a_task("b", cpu=1.0)),
            a_snapshot(edge1=a_sample(), edge2=a_sample()),
        )
    )
    # a: tie -> natural order; b: edge1 (4 - 1 - 1) / 4 = .5 < edge2 .75
    assert (found["a"].host, found["b"].host) == ("edge1", "edge2")
