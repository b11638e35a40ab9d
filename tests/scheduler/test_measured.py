# SPDX-License-Identifier: Apache-2.0
"""Measured demand by hand: the value used on each host, the charged load, and the explanation."""

from collections.abc import Sequence
from dataclasses import replace

import pytest

from edgectl.model.assignment import DemandSource, ResourceDemand
from edgectl.model.demand import Demand, Quantity
from edgectl.model.manager_state import ManagerState, MeasuredDemand
from edgectl.model.resource import CPU, MEMORY, NETWORK, TASK_RESOURCES
from edgectl.model.task import Tasks
from tests.builders import (
    GI,
    a_link,
    a_robot,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import decisions_by_task, ranking_by_host, run_assign

SMALL, LARGE = "4c-4Gi", "8c-8Gi"
INVENTORY = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot())
LINKS = {"robot1": a_link(10e6)}
SNAPSHOT = a_snapshot(
    edge1=a_sample(cores=4, memory=4 * GI, links=LINKS),
    edge2=a_sample(cores=8, memory=7.4 * GI, links={"robot1": a_link(5e6)}),
)
LEFT_OUT = a_task(cpu=None, memory=None, throughput=None, robots=["robot1"])
DECLARED = a_task(cpu=3.0, memory=GI, throughput=1e6, robots=["robot1"])


def a_measured_state(**of: MeasuredDemand) -> ManagerState:
    kinds = {"small": SMALL, "large": LARGE}
    return ManagerState(managed=True, measured={("slam", kinds[name]): found for name, found in of.items()})


def a_history(
    cpu: float = 2.0,
    memory: float = GI,
    throughput: float | None = 1e6,
    *,
    samples: int = 412,
    span: float = 900.0,
) -> MeasuredDemand:
    return MeasuredDemand(
        samples=samples,
        span_s=span,
        used={"cpu": cpu, "memory": memory, **({} if throughput is None else {"network": throughput})},
    )


def cpu_terms(tasks: Tasks, memory: ManagerState) -> dict[str, float | None]:
    return {
        host: entry.terms["cpu"]
        for host, entry in ranking_by_host(
            decisions_by_task(run_assign(INVENTORY, tasks, SNAPSHOT, memory=memory))["slam"]
        ).items()
    }


def select_measurable(demand: Sequence[ResourceDemand]) -> tuple[ResourceDemand, ...]:
    """The demands that can be measured: not those of a declared budget."""
    return tuple(rho for rho in demand if rho.resource in TASK_RESOURCES)


def test_the_demand_of_the_class_that_is_looked_at_counts_and_is_charged() -> None:
    memory = a_measured_state(
        small=a_history(cpu=2.0), large=a_history(cpu=5.0, throughput=2e6, samples=60, span=300.0)
    )
    found = run_assign(INVENTORY, some_tasks(LEFT_OUT), SNAPSHOT, memory=memory)
    entries = ranking_by_host(decisions_by_task(found)["slam"])
    assert entries["edge1"].terms["cpu"] == (4 - 2) / 4
    assert entries["edge2"].terms["cpu"] == (8 - 5) / 8
    assert entries["edge1"].terms["network"] == (10 - 1) / 10
    assert entries["edge2"].terms["network"] == (5 - 2) / 5
    # all .25 each, the only task: edge1 0.5+0.75+0.9+0.5, edge2 0.375+0.8649+0.6+0.5
    assert decisions_by_task(found)["slam"].host == "edge1"
    assert found.expected["edge1"].used["cpu"] == 2.0
    assert found.expected["edge1"].links == {"robot1": 1e6}
    assert select_measurable(entries["edge2"].demand) == (
        ResourceDemand(resource=CPU, value=5.0, source=DemandSource.MEASURED, samples=60),
        ResourceDemand(resource=MEMORY, value=GI, source=DemandSource.MEASURED, samples=60),
        ResourceDemand(resource=NETWORK, value=2e6, source=DemandSource.MEASURED, samples=60),
    )
    assert decisions_by_task(found)["slam"].demand == entries["edge1"].demand


@pytest.mark.parametrize(("samples", "span"), [(59, 900.0), (412, 299.0), (0, 0.0)])
def test_too_few_samples_count_as_nothing(samples: int, span: float) -> None:
    memory = a_measured_state(small=a_history(cpu=2.0, samples=samples, span=span))
    found = decisions_by_task(run_assign(INVENTORY, some_tasks(LEFT_OUT), SNAPSHOT, memory=memory))["slam"]
    assert {entry.terms["cpu"] for entry in found.ranking} == {1.0}
    assert [(rho.value, rho.source) for rho in select_measurable(found.demand)] == [
        (0.0, DemandSource.NONE)
    ] * 3
    assert {rho.samples for rho in select_measurable(found.demand)} == {
        samples if found.host == "edge1" else 0
    }


def test_the_history_of_another_command_counts_not() -> None:
    """As when yesterday's snapshot meets today's files."""
    memory = a_measured_state(small=replace(a_history(cpu=2.0), spec_hash="another"))
    found = decisions_by_task(run_assign(INVENTORY, some_tasks(LEFT_OUT), SNAPSHOT, memory=memory))["slam"]
    assert [(rho.value, rho.source, rho.samples) for rho in select_measurable(found.demand)] == [
        (0.0, DemandSource.NONE, 0)
    ] * 3
    same = a_measured_state(small=replace(a_history(cpu=2.0), spec_hash=LEFT_OUT.spec_hash))
    assert cpu_terms(some_tasks(LEFT_OUT), same)["edge1"] == 0.5


def test_what_is_declared_is_never_replaced() -> None:
    memory = a_measured_state(small=a_history(cpu=2.0), large=a_history(cpu=5.0))
    assert cpu_terms(some_tasks(DECLARED), memory) == {"edge1": (4 - 3) / 4, "edge2": (8 - 3) / 8}
    found = decisions_by_task(run_assign(INVENTORY, some_tasks(DECLARED), SNAPSHOT, memory=memory))["slam"]
    assert [(rho.value, rho.source, rho.samples) for rho in select_measurable(found.demand)] == [
        (3.0, DemandSource.DECLARED, None), (GI, DemandSource.DECLARED, None), (1e6, DemandSource.DECLARED, None),
    ]  # fmt: skip


def test_until_it_is_measured_the_declared_value_counts() -> None:
    task = a_task(cpu=Quantity(value=3.0, measured=True), robots=["robot1"])
    assert cpu_terms(some_tasks(task), a_measured_state()) == {"edge1": (4 - 3) / 4, "edge2": (8 - 3) / 8}
    assert cpu_terms(some_tasks(task), a_measured_state(small=a_history(cpu=2.0))) == {
        "edge1": (4 - 2) / 4,
        "edge2": (8 - 3) / 8,
    }
    share = replace(
        task, demand=Demand({**task.demand, "cpu": Quantity(value=0.5, relative=True, measured=True)})
    )
    assert cpu_terms(some_tasks(share), a_measured_state(large=a_history(cpu=2.0))) == {
        "edge1": 0.5,
        "edge2": (8 - 2) / 8,
    }


def test_a_class_without_history_is_no_bait() -> None:
    """Nothing is declared and edge2 is unknown: the greatest demand measured elsewhere counts there, not 0."""
    found = run_assign(
        INVENTORY,
        some_tasks(LEFT_OUT),
        SNAPSHOT,
        memory=a_measured_state(small=a_history(cpu=2.0), large=a_history(samples=3)),
    )
    entries = ranking_by_host(decisions_by_task(found)["slam"])
    assert entries["edge2"].terms["cpu"] == (8 - 2) / 8
    assert entries["edge2"].demand[0] == ResourceDemand(
        resource=CPU, value=2.0, source=DemandSource.MEASURED_ELSEWHERE, samples=3
    )


def test_no_traffic_seen_is_no_figure() -> None:
    task = replace(
        DECLARED, demand=Demand({**DECLARED.demand, "network": Quantity(value=1e6, measured=True)})
    )
    found = decisions_by_task(
        run_assign(
            INVENTORY, some_tasks(task), SNAPSHOT, memory=a_measured_state(small=a_history(throughput=None))
        )
    )["slam"]
    assert {entry.host: entry.demand[2].source for entry in found.ranking} == {
        "edge1": DemandSource.DECLARED,
        "edge2": DemandSource.DECLARED,
    }
    assert ranking_by_host(found)["edge1"].terms["network"] == (10 - 1) / 10


def test_a_label_makes_a_class() -> None:
    labelled = an_inventory(
        *(an_edge(name, labels={"class": "jetson"}) for name in ("edge1", "edge2")), a_robot()
    )
    memory = ManagerState(managed=True, measured={("slam", "jetson"): a_history(cpu=2.0)})
    found = decisions_by_task(run_assign(labelled, some_tasks(LEFT_OUT), SNAPSHOT, memory=memory))["slam"]
    assert {entry.host: entry.terms["cpu"] for entry in found.ranking} == {"edge1": 0.5, "edge2": 0.75}


def test_a_percent_demand_of_unlike_hosts_is_told_once_with_the_figures() -> None:
    tasks = some_tasks(
        a_task("a-robot1", cpu="35%", memory="10%", template="a"), a_task("a-robot2", cpu="35%", memory="10%", template="a"),
        a_task("b", cpu=1.4, memory=GI), a_task("c", cpu="35%", memory=GI, only=["edge1"]),
    )  # fmt: skip
    found = run_assign(INVENTORY, tasks, SNAPSHOT).demand_spreads
    assert [(each.task, each.resource, each.hosts) for each in found] == [
        ("a", CPU, ("edge1", "edge2")), ("a", MEMORY, ("edge1", "edge2")),
    ]  # fmt: skip
    assert (found[0].least, found[0].most, found[0].share) == (1.4, 2.8, 0.35)


@pytest.mark.parametrize(("cores", "told"), [(5.0, False), (5.1, True)])
def test_hosts_up_to_a_quarter_apart_are_alike(cores: float, told: bool) -> None:
    snapshot = a_snapshot(edge1=a_sample(cores=4), edge2=a_sample(cores=cores))
    assert bool(run_assign(INVENTORY, some_tasks(a_task(cpu="35%")), snapshot).demand_spreads) == told
