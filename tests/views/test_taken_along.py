# SPDX-License-Identifier: Apache-2.0
"""State that moves transfer of the memory of a task, in explanations and wide plans."""

import json
from dataclasses import replace

import pytest

from edgectl.model.explanation import Explanation
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import ActionResult, CarriedState, Outcome
from edgectl.model.standby import SaveMoment, StateRule
from edgectl.model.task import Task
from edgectl.views.explanation import ExplanationView
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.plan import PlanView
from edgectl.views.taken_along import explain_taken_along
from edgectl.views.text import RenderOptions
from tests.builders import a_snapshot, a_standby_rule, a_task, some_tasks
from tests.executor.test_run import a_plan, a_step
from tests.views.test_standbys import POLICY

SLAM = a_task("slam", state=StateRule())
WARM = replace(SLAM, standby=a_standby_rule())
LAST = ActionResult(
    task="slam",
    action=Action.MOVE,
    outcome=Outcome.DONE,
    host="edge3",
    previous_host="edge1",
    located="edge3",
    phases=(),
    state=CarriedState(
        size_bytes=10_000_000,
        sha256="a" * 64,
        save_s=0.1,
        sent_bytes=9_000_000,
        transfer_s=2.0,
        load_s=0.3,
        age_s=2.5,
        host="edge3",
    ),
)


def a_move() -> Step:
    return a_step("slam", Action.MOVE, host="edge1", previous="edge3")


def tell(step: Step, task: Task, last: ActionResult | None = None) -> list[str]:
    return list(explain_taken_along(step, task, last))


@pytest.mark.parametrize(
    ("task", "said"),
    [
        (
            SLAM,
            (
                "This move to edge1 transfers its state (what save prints, while the old instance runs); "
                "what changes between save and its stop is lost."
            ),
        ),
        (
            WARM,
            (
                "This move to edge1 transfers its state (what save prints, while no instance is active); "
                "none of its output is lost."
            ),
        ),
        (
            replace(WARM, state=StateRule(topic="/map", moment=SaveMoment.ACTIVE)),
            (
                "This move to edge1 transfers its state (the last message of /map, while the old instance is "
                "active); what changes between save and its deactivation is lost."
            ),
        ),
        (
            replace(SLAM, state=None),
            "This move transfers nothing: the file of the task states no state.",
        ),
    ],
    ids=["cold", "warm", "early", "without"],
)
def test_a_move_says_what_goes_along_and_what_stays_behind(task: Task, said: str) -> None:
    assert tell(a_move(), task) == [said]


def test_other_steps_take_nothing() -> None:
    keep, restart = a_step("slam", Action.KEEP, host="edge1"), a_step("slam", Action.RESTART, host="edge1")
    assert tell(keep, SLAM)[0].startswith("A move transfers its state (what save prints")
    assert tell(restart, SLAM)[0].startswith("A move, unlike this restart, transfers its state")
    assert tell(keep, replace(SLAM, state=None)) == tell(a_move(), replace(SLAM, managed=False)) == []


def test_the_last_time_has_size_age_way_and_durations() -> None:
    said = "9.5Mi from edge1 to edge3, 2.5s old when loaded; save 0.1s, transfer 2.0s, load 0.3s"
    assert tell(a_move(), SLAM, LAST)[1] == f"Last time: {said}."
    view = ExplanationView(
        a_move(), Explanation(decision=a_move().decision, weights=POLICY.weights), task=SLAM, carried=LAST
    )
    assert said in view.table().replace("\n", " ")
    item = json.loads(render_view(view, OutputFormat.JSON))["item"]
    assert (item["carried"]["size_bytes"], item["carried"]["age_s"]) == (10_000_000, 2.5)
    assert max(map(len, view.table(RenderOptions(width=80)).splitlines())) <= 80


def a_fleet_plan() -> Plan:
    steps = (a_move(), a_step("nav", Action.MOVE, host="edge2", previous="edge1"), a_step("map", Action.KEEP))
    return a_plan(*steps, snapshot=a_snapshot({}))


def test_a_wide_plan_lists_what_moves_take_along() -> None:
    tasks = some_tasks(WARM, a_task("nav"), a_task("map"))
    look = RenderOptions(width=80)
    text = PlanView(a_fleet_plan(), tasks, {"slam": LAST}).wide(look)
    section = text[text.index("State that moves transfer") :]
    joined = " ".join(section.split())
    assert "nav edge1 edge2 nothing: its file states no state -" in joined
    assert "2.5s old" in joined
    rows = [line.split()[0] for line in section.splitlines()[2:] if line and not line.startswith(" ")]
    assert rows[:2] == ["slam", "nav"]
    assert max(map(len, section.splitlines())) <= 80
    # Without the files nothing is known of it; and the table of changes stays as it is.
    assert "State that moves transfer" not in PlanView(a_fleet_plan()).wide()
    assert "State that moves transfer" not in PlanView(a_fleet_plan(), tasks).table()
