# SPDX-License-Identifier: Apache-2.0
"""The words for tasks that use more than they declare, and for what a fleet lacks: at 80 columns, and in JSON.

zeta is used at 283 %, of which slam-robot1, which declares 0.3, takes 1.2 cores.
"""

import json
from typing import Any

from edgectl.doctor.shortage import diagnose_shortages
from edgectl.executor.diff import plan_from_assignment
from edgectl.model.cycle import Cycle
from edgectl.model.diagnosis import Diagnosis
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.scheduler.assign import assign
from edgectl.scheduler.shortage import find_shortages
from edgectl.state.store_action_events import build_overuse_events
from edgectl.views.diagnosis import DiagnosisView
from edgectl.views.events import EventsView
from edgectl.views.output import View
from edgectl.views.output_format import OutputFormat
from edgectl.views.plan import PlanView
from edgectl.views.status import StatusView
from edgectl.views.text import RenderOptions
from edgectl.views.watch_cycle import CycleView, WatchTally, add_cycle_to_tally, render_cycle_line
from edgectl.views.watch_screen import WatchTitle, render_watch_screen
from tests.builders import (
    NOW,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import NO_MEMORY
from tests.views.fixtures import show

INVENTORY = an_inventory(an_edge("zeta"), an_edge("beta"), an_edge("alpha"), a_robot())
TASKS = some_tasks(
    a_task("slam-robot1", cpu=0.3, template="slam", hosts=a_task(pin="zeta").hosts),
    a_task("detection", cpu=1.0),
    a_task("planner", cpu=3.0),
)
SNAPSHOT = a_snapshot(
    zeta=a_sample(used=11.32, tasks={"slam-robot1": a_run(used=Usage(cpu=1.2))}),
    beta=a_sample(used=2.0),
    alpha=a_sample(used=2.5),
    memory=NO_MEMORY,
)
PLAN = plan_from_assignment(
    INVENTORY, TASKS, SNAPSHOT, NO_MEMORY, assign(INVENTORY, TASKS, SNAPSHOT, NO_MEMORY, Policy(), NOW)
)
EVENTS = build_overuse_events(PLAN)
SHORTAGES = find_shortages(INVENTORY, TASKS, SNAPSHOT)
CYCLE = Cycle(
    number=1,
    at=NOW,
    snapshot=SNAPSHOT,
    plan=PLAN,
    events=EVENTS,
    warnings=tuple(found.describe() for found in SHORTAGES),
)
AT_80 = RenderOptions(width=80)

OVERUSE = "uses 1.20 cores of cpu, declares 0.30 cores; edgectl profile slam --write"
SHORT = "the edges are short of 7.82 cores of cpu: the least that would help"
NOTES = f"""\
note: {SHORT}
note: slam-robot1 on zeta uses 1.20 cores of cpu, declares 0.30 cores; edgectl
  profile slam --write
"""


def read(view: View, form: OutputFormat = OutputFormat.JSON) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(show(view, form))
    return found


def test_the_host_that_is_full_receives_no_further_task() -> None:
    assert {step.task: step.decision.host for step in PLAN.steps} == {
        "slam-robot1": "zeta",
        "detection": "beta",
        "planner": None,
    }


def test_plan() -> None:
    assert show(PlanView(PLAN), look=AT_80).endswith("1 unplaced.\n" + NOTES)
    found = read(PlanView(PLAN))
    assert found["overuses"] == [
        {
            "task": "slam-robot1",
            "entry": "slam",
            "host": "zeta",
            "resource": "cpu",
            "used": 1.2,
            "declared": 0.3,
        }
    ]
    assert found["shortages"] == [{"resource": "cpu", "amount": 7.82}]


def test_wide_shows_what_is_used_reserved_and_declared_in_figures_that_agree() -> None:
    """In use 1.2 of 0.3 declared, so 1.2 are reserved, and the load after the plan is that of now."""
    lines = show(PlanView(PLAN, TASKS), OutputFormat.WIDE, RenderOptions(width=120)).splitlines()
    demands, loads, expected = (
        next(line.split() for line in lines[lines.index(heading) :] if line.startswith(name))
        for heading, name in (
            ("Demands:", "slam-robot1"),
            ("Load now, and what the tasks of this plan reserve and demand:", "zeta"),
            ("Expected load after this plan:", "zeta"),
        )
    )
    assert demands[:8] == ["slam-robot1", "zeta", "1.20", "in", "use,", "0.30", "declared", "0B"]
    assert loads[:4] == ["zeta", "11.32", "1.20", "0.30"]
    assert expected[:3] == ["zeta", "11.32", "(283%)"]


def test_status() -> None:
    view = StatusView(SNAPSHOT, INVENTORY, TASKS, SHORTAGES)
    shown = show(view, look=AT_80)
    assert shown.startswith(
        "Fleet unnamed, 1/3 tasks run, 3/3 hosts answer, no problem, 2 warnings below\n\nTASK "
    )
    assert shown.endswith(NOTES)
    assert read(view)["warnings"] == [SHORT, f"slam-robot1 on zeta {OVERUSE}"]


def test_watch_in_lines_and_for_programs() -> None:
    assert render_cycle_line(None, CYCLE) == (
        f"2025-11-21T01:53:20Z task-overuse slam-robot1 on zeta: {OVERUSE}; warning: {SHORT}\n"
    )
    found = read(CycleView(CYCLE), OutputFormat.JSONL)
    assert [(each["kind"], each["message"]) for each in found["events"]] == [("task-overuse", OVERUSE)]
    assert found["warnings"] == [SHORT]


def test_the_screen_of_watch_shows_each_line_of_the_past_whole() -> None:
    title, tally = (
        WatchTitle(fleet="lab", weights="all", applies=True),
        add_cycle_to_tally(WatchTally(), CYCLE),
    )
    lines = render_watch_screen(title, tally, NOW, look=AT_80).splitlines()
    assert [line.partition(" ")[2].strip() for line in lines[-6:-2]] == [
        "task-overuse slam-robot1 on zeta: uses 1.20 cores of cpu, declares 0.30",
        "cores; edgectl profile slam --write",
        "warning: the edges are short of 7.82 cores of cpu: the least that would",
        "help",
    ]
    assert max(map(len, lines[-6:-2])) <= 80
    few = render_watch_screen(title, tally, NOW, rows=16, look=AT_80).splitlines()
    assert few[-3].endswith("help")
    assert not any("declares" in line for line in few)


def test_events() -> None:
    assert show(EventsView(EVENTS), look=AT_80) == (
        """\
AT                    KIND          SUBJECT             MESSAGE
2025-11-21T01:53:20Z  task-overuse  slam-robot1 on      uses 1.20 cores of cpu,
                                    zeta                declares 0.30 cores;
                                                        edgectl profile slam
                                                        --write
"""
    )
    (found,) = read(EventsView(EVENTS))["items"]
    assert (found["kind"], found["task"], found["host"], found["message"]) == (
        "task-overuse",
        "slam-robot1",
        "zeta",
        OVERUSE,
    )


def test_doctor() -> None:
    view = DiagnosisView(Diagnosis(findings=tuple(diagnose_shortages(SHORTAGES))))
    shown = " ".join(show(view, look=AT_80).split())
    assert SHORT in shown
    assert "add an edge, or see which tasks use or demand most: edgectl plan -o wide" in shown
    (found,) = read(view)["items"]
    assert (found["check"], found["message"]) == ("room", SHORT)
