# SPDX-License-Identifier: Apache-2.0
"""explain as a person and as a program read it."""

import json
from dataclasses import replace

from edgectl.executor.diff import diff_assignment, plan_from_assignment
from edgectl.model.assignment import Assignment, Reason
from edgectl.model.explanation import Explanation
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Step
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.model.predicted_latency import ServiceTime
from edgectl.model.task import Task
from edgectl.scheduler.assign import assign
from edgectl.scheduler.explain import TermNoise, explain_decision
from edgectl.views.explanation import ExplanationView
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.text import RenderOptions
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks

INVENTORY: Inventory = an_inventory(an_edge("edge1"), an_edge("edge2"))
POLICY = Policy(weights=Weights(cpu=0.75, memory=0.25, network=0.0, task=0.0))
TEXT = """\
slam -> edge1
start: highest utility

TERM     WEIGHT  edge1  edge2  ADDS TO LEAD
cpu       0.750  0.650  0.400        +0.188
memory    0.250  1.000  1.000        +0.000
network   0.000  1.000  1.000        +0.000
task      0.000  0.500  0.500        +0.000
total            0.738  0.550        +0.188

edge2 would win if the cpu load of edge1 rose by more than 1.000 cores.
"""


def taken_apart(used: float = 2.0, task: Task | None = None) -> tuple[Step, Explanation]:
    """``used``: cores of edge2 that are in use; 1 is as many as of edge1."""
    world = a_snapshot(edge1=a_sample(used=1.0), edge2=a_sample(used=used))
    tasks = some_tasks(task or a_task(cpu=0.4))
    assignment: Assignment = assign(INVENTORY, tasks, world, ManagerState(), POLICY, NOW)
    noise = {"edge1": TermNoise(cpu=0.2), "edge2": TermNoise(cpu=0.2)}
    found = explain_decision(
        INVENTORY, tasks.tasks["slam"], world, assignment.decisions[0], assignment.policy, noise
    )
    return plan_from_assignment(INVENTORY, tasks, world, ManagerState(), assignment).steps[0], found


def with_latency() -> tuple[Step, Explanation]:
    """The explanation of a task with a deadline, whose service time is known of another class of hosts."""
    service = {"jetson": ServiceTime(p50=0.031, p95=0.034)}
    return taken_apart(task=a_task(cpu=0.4, deadline=0.1, service_time=service))


def test_the_table_says_milliseconds() -> None:
    text = ExplanationView(*with_latency()).table()
    assert "edge1: 34 ms at p95 of 100 ms (p50 31, p99 " in text
    assert "31 ms service at 25% load; service time of another class of hosts" in text
    assert "latency" not in ExplanationView(*taken_apart()).table()


def test_the_table_says_what_each_term_adds_and_what_would_flip_it() -> None:
    step, found = taken_apart()
    fragile = "fragile: it would change 0.188 below, and the measurements alone vary by 0.212.\n"
    assert ExplanationView(step, found).table() == TEXT + fragile
    assert max(map(len, ExplanationView(step, found).table(RenderOptions(width=60)).splitlines())) <= 60


def test_a_difference_that_rounds_to_nothing_has_no_sign() -> None:
    step, found = taken_apart()
    tiny = [replace(each, there=each.here + 0.0001) for each in found.contributions]
    text = ExplanationView(step, replace(found, contributions=tuple(tiny))).table()
    assert "-0.000" not in text
    assert text.count("+0.000") == 5


def test_equal_hosts_have_no_threshold() -> None:
    text = ExplanationView(*taken_apart(used=1.0)).wide()
    assert "edge2 would win if the cpu load of edge1 rose at all.\n" in text
    assert " by more than 0" not in text
    assert " by more than -" not in text


def test_wide_lists_every_change() -> None:
    step, found = taken_apart()
    lines = ExplanationView(step, found).wide().splitlines()
    assert "edge2 would win if the cpu load of edge2 fell by more than 1.000 cores." in lines
    assert "edge2 would win if the memory load of edge1 rose by more than 3.0Gi." in lines


def test_the_document_holds_every_number() -> None:
    document = json.loads(render_view(ExplanationView(*taken_apart()), OutputFormat.JSON))["item"]
    assert (document["host"], document["runner_up"], document["fragile"]) == ("edge1", "edge2", True)
    assert document["lead"] == sum(each["adds"] for each in document["contributions"])
    flip = document["flips"][0]
    assert (flip["change"], flip["term"], flip["unit"], flip["winner"]) == (
        "load-rises",
        "cpu",
        "cores",
        "edge2",
    )


def test_rules_between_tasks_are_said_in_words() -> None:
    tasks = some_tasks(
        a_task("a", cpu=1.0), a_task("b", cpu=1.0, apart=("a",)), a_task("c", cpu=1.0, together=("a",))
    )
    three = an_inventory(*map(an_edge, ["edge1", "edge2", "edge3"]))
    snapshot = a_snapshot({edge: a_sample() for edge in three.hosts}, memory=ManagerState(managed=True))
    found = assign(three, tasks, snapshot, ManagerState(managed=True), Policy(), NOW)
    steps = {step.task: step for step in diff_assignment(found, tasks, snapshot, ManagerState(managed=True))}

    def show(name: str) -> str:
        step = steps[name]
        explanation = explain_decision(three, tasks.tasks[name], snapshot, step.decision, found.policy)
        return ExplanationView(step, explanation).table()

    assert "Its files keep it off edge1, where a is (apart)." in show("b")
    assert "start: together with a" in show("c")
    assert "keep it with a (together), which leaves out edge2 and edge3." in show("c")


def test_what_the_totals_did_not_decide_is_said() -> None:
    """Its dwell keeps it; a load that leaves it no memory would still move it."""
    run = a_run(started_at=NOW - 30.0)
    world = a_snapshot(edge1=a_sample(used=3.0, tasks={"slam": run}), edge2=a_sample())
    tasks = some_tasks(a_task(cpu=0.4))
    assignment = assign(INVENTORY, tasks, world, ManagerState(), POLICY, NOW)
    (decision,) = assignment.decisions
    found = explain_decision(INVENTORY, tasks.tasks["slam"], world, decision, assignment.policy)
    text = ExplanationView(Step(decision=decision, action=Action.KEEP), found).wide()
    assert decision.reason is Reason.DWELL
    assert "The totals alone did not decide this, so no change of a load or a weight is named." in text


def test_a_policy_with_a_rule_of_its_own_says_so() -> None:
    world = a_snapshot(edge1=a_sample(used=3.0), edge2=a_sample())
    tasks = some_tasks(a_task(cpu=0.4))
    policy = Policy(name=PolicyName.LEAST_LOADED)
    assignment = assign(INVENTORY, tasks, world, ManagerState(), policy, NOW)
    (decision,) = assignment.decisions
    found = explain_decision(INVENTORY, tasks.tasks["slam"], world, decision, assignment.policy)
    text = ExplanationView(Step(decision=decision, action=Action.START), found).wide()
    assert "Policy least-loaded decides by a rule of its own; changes are named for utility only." in text
    assert "The totals alone" not in text
