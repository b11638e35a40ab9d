# SPDX-License-Identifier: Apache-2.0
"""The source of every demand, in the forms for people."""

from dataclasses import replace

import pytest

from edgectl.executor.diff import plan_from_assignment
from edgectl.model.demand import Quantity
from edgectl.model.manager_state import ManagerState, MeasuredDemand
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy
from edgectl.model.profile import ClassProfile, UsagePercentiles, UsageProfile
from edgectl.model.resource import Usage
from edgectl.scheduler.assign import assign
from edgectl.views.demands import render_demands, render_reservations
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.plan import PlanView
from edgectl.views.profile import ProfileView
from edgectl.views.status import StatusView
from edgectl.views.text import RenderOptions
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
    some_tasks,
)
from tests.views.fixtures import show

LINKS = {"robot1": a_link()}
SNAPSHOT = a_snapshot(
    edge1=a_sample(links=LINKS), edge2=a_sample(cores=8.0, memory=8 * GI, used_memory=6 * GI, links=LINKS)
)
MEMORY = ManagerState(
    managed=True,
    measured={
        ("slam", "4c-4Gi"): MeasuredDemand(
            samples=412, span_s=900.0, used={"cpu": 1.0, "memory": 100 * 2.0**20}
        ),
        ("map", "4c-4Gi"): MeasuredDemand(samples=12, span_s=60.0, used={"cpu": 1.0, "memory": GI}),
    },
)
TASKS = some_tasks(
    a_task("slam", cpu=None, memory=None, throughput=3e5, robots=["robot1"]), a_task("map", cpu=None, memory=GI), a_task("old", cpu="35.2%")
)  # fmt: skip


def a_plan() -> Plan:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot())
    return plan_from_assignment(
        inventory, TASKS, SNAPSHOT, MEMORY, assign(inventory, TASKS, SNAPSHOT, MEMORY, Policy(), NOW)
    )


def test_wide_tells_every_source() -> None:
    section = PlanView(a_plan()).wide().split("Demands:\n")[1].split("\n\n")[0]
    assert [line.split() for line in section.splitlines()] == [
        ["TASK", "HOST", "CPU", "DEMAND", "MEMORY", "DEMAND", "NETWORK", "DEMAND"],
        ["map", "edge1", "0m", "none", "(12", "of", "60", "samples)", "1.0Gi", "declared", "-"],
        ["old", "edge1", "1.41", "declared", "0B", "declared", "-"],
        [
            "slam",
            "edge1",
            "1.00",
            "measured",
            "n=412",
            "100.0Mi",
            "measured",
            "n=412",
            "300.0kB/s",
            "declared",
        ],
        ["edge2", "1.00", "measured-elsewhere", "100.0Mi", "measured-elsewhere", "300.0kB/s", "declared"],
    ]


def test_the_table_has_a_note_for_each_thing_to_know() -> None:
    notes = [line for line in show(PlanView(a_plan())).splitlines() if line.startswith("note: ")]
    assert notes == [
        "note: demand measured (p95): slam cpu and memory (n=412)",
        "note: demand unknown, 0 until it is measured: map cpu (n=12)",
        "note: percent demands mean different amounts on unlike hosts: old cpu 35.2% is 1.41 cores on edge1, 2.82 cores on edge2",
    ]
    assert "<details><summary>Demands</summary>" in render_view(PlanView(a_plan()), OutputFormat.MARKDOWN)


def test_a_plan_with_declared_demands_alone_has_no_note() -> None:
    plan = a_plan()
    steps = tuple(replace(step, decision=replace(step.decision, demand=())) for step in plan.steps)
    silent = replace(plan, steps=steps, demand_spreads=())
    assert "note:" not in show(PlanView(silent))
    assert "Demands" not in PlanView(replace(silent, steps=())).wide()


def test_long_lists_are_cut_and_fit_the_terminal() -> None:
    plan = a_plan()
    many = replace(plan, demand_spreads=plan.demand_spreads * 9)
    text = show(PlanView(many), look=RenderOptions(width=80))
    assert "and 5 more" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 80


def test_reservations_have_one_line_for_each_host_on_a_narrow_terminal() -> None:
    section = render_reservations(a_plan(), RenderOptions(width=80)).splitlines()
    assert [line.split() for line in section[1:]] == [
        ["HOST", "CPU", "NOW", "CPU", "CPU", "DEMAND", "MEMORY", "NOW", "MEMORY", "MEMORY", "DEMAND"],
        ["RESERVED", "RESERVED"],
        ["edge1", "0m", "2.41", "2.41", "0B", "1.1Gi", "1.1Gi"],
        ["edge2", "0m", "0m", "0m", "6.0Gi", "0B", "0B"],
    ]
    assert max(map(len, section)) <= 80


def test_status_sets_the_measured_demand_beside_the_use() -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot())
    hosts = {"edge1": replace(SNAPSHOT.hosts["edge1"], tasks={"slam": a_run(used=Usage(cpu=1.25))})}
    text = show(StatusView(replace(SNAPSHOT, hosts=hosts, manager=MEMORY), inventory, TASKS))
    assert text.splitlines()[3].split()[4:] == ["1.25", "1.00", "0B", "100.0Mi", "0B/s", "300.0kB/s"]


def a_profile(name: str = "slam-of-the-second-robot") -> ClassProfile:
    spread = UsagePercentiles(p50=0.5, p95=123.456, most=1234.5)
    found = UsageProfile(samples=12, span_s=990.0, used={"cpu": spread, "memory": spread, "network": spread})
    task = a_task(
        name,
        cpu=Quantity(value=1.2, measured=True),
        memory="2.5%",
        throughput=Quantity(value=0.0, measured=True),
        robots=["robot1"],
    )
    return ClassProfile(task=task, kind="4c-8Gi", hosts=("edge1", "edge2"), profile=found, enough=False)


@pytest.mark.parametrize("width", [80, 160])
def test_profiles_and_demands_pass_no_edge(width: int) -> None:
    for text in (
        ProfileView([a_profile()]).table(RenderOptions(width=width)),
        render_demands(a_plan(), RenderOptions(width=width)),
    ):
        assert max(map(len, text.splitlines())) <= width


def test_a_profile_says_how_a_demand_is_declared() -> None:
    rows = [line.split() for line in ProfileView([a_profile()]).table().splitlines()]
    assert rows[1][2:] == [
        "cpu",
        "until:",
        "1.20",
        "0.50",
        "123.46",
        "1234.50",
        "12",
        "of",
        "60",
        "16m30s",
        "edge1,",
        "edge2",
    ]
    assert rows[2] == ["memory", "2.5%", "0B", "123B", "1.2Ki"]
    assert rows[3] == ["throughput", "measured", "0B/s", "123B/s", "1.2kB/s"]
    assert render_view(ProfileView([a_profile()]), OutputFormat.YAML).startswith(
        "format_version: 2\nkind: profile\nitems:\n- task: slam-of-the-second-robot\n  class: 4c-8Gi\n"
    )
