# SPDX-License-Identifier: Apache-2.0
"""A plan file that somebody else wrote: nothing in it doubles a task, breaks a rule or stops what should run."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.errors import StalePlanError
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy
from edgectl.model.task import HostRules, Tasks
from edgectl.usecases.apply import apply_saved_plan, check_saved_plan, plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from tests.builders import NOW, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet

POLICY = Policy()
TASKS = some_tasks(a_task("t1", cpu=1.0), a_task("t2", cpu=1.0, only=["a"]))


class Site:
    """Edges a and b; t1 and t2 run on a."""

    def __init__(self, state: Path) -> None:
        self.hosts = FakeFleet.of(["a", "b"])
        self.fleet = Fleet(
            inventory=an_inventory(an_edge("a"), an_edge("b")),
            tasks=TASKS,
            transport=self.hosts.transport,
            state=state,
            clock=lambda: NOW,
        )
        pinned = some_tasks(*(dataclasses.replace(task, hosts=_on("a")) for task in TASKS.tasks.values()))
        plan_and_apply(dataclasses.replace(self.fleet, tasks=pinned), POLICY)
        assert self.hosts.placed == {"t1": "a", "t2": "a"}

    def refuse(self, plan: Plan, tasks: Tasks = TASKS) -> str:
        """What is said of a plan that must change nothing."""
        before = list(self.hosts.changes)
        with pytest.raises(StalePlanError) as caught:
            apply_saved_plan(dataclasses.replace(self.fleet, tasks=tasks), plan)
        assert self.hosts.changes == before
        assert not self.hosts.world.overlap
        return "; ".join(caught.value.changes)


def _on(host: str) -> HostRules:
    return a_task(only=[host]).hosts


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


def craft(plan: Plan, task: str, **fields: object) -> Plan:
    """The plan with another step for one task."""
    step = Step(
        decision=Decision(
            task=task,
            verdict=fields.pop("verdict", Verdict.PLACED),  # type: ignore[arg-type]
            reason=fields.pop("reason", Reason.BEST),  # type: ignore[arg-type]
            host=fields.pop("host", None),  # type: ignore[arg-type]
            previous_host=fields.pop("previous", None),  # type: ignore[arg-type]
        ),
        **fields,  # type: ignore[arg-type]
    )
    return dataclasses.replace(plan, steps=tuple(step if each.task == task else each for each in plan.steps))


def test_a_start_of_what_runs_elsewhere_is_refused(site: Site) -> None:
    plan = craft(make_plan(site.fleet, POLICY), "t1", action=Action.START, host="b")
    assert site.refuse(plan) == "start of t1 on b does not fit what runs now: it runs on a"


def test_a_plan_without_every_host_is_refused(site: Site) -> None:
    plan = craft(make_plan(site.fleet, POLICY), "t1", action=Action.START, host="b")
    emptied = dataclasses.replace(plan, snapshot=dataclasses.replace(plan.snapshot, hosts={}))
    assert site.refuse(emptied) == "it has no sample of a; it has no sample of b"


def test_a_move_to_a_host_that_the_rules_exclude_is_refused(site: Site) -> None:
    made = make_plan(site.fleet, POLICY)
    instance = made.snapshot.hosts["a"].tasks["t2"].instance
    plan = craft(made, "t2", action=Action.MOVE, host="b", previous="a", instances={"a": instance})
    assert site.refuse(plan) == "b may not take t2 (not-in-only)"


def test_two_decisions_on_one_task_are_refused(site: Site) -> None:
    new = some_tasks(*TASKS.tasks.values(), a_task("t3"))
    fleet = dataclasses.replace(site.fleet, tasks=new)
    made = make_plan(fleet, POLICY)
    (start,) = (step for step in made.steps if step.action is Action.START)
    there = "a" if start.decision.host == "b" else "b"
    second = dataclasses.replace(start, decision=dataclasses.replace(start.decision, host=there))
    plan = dataclasses.replace(made, steps=(*made.steps, second))
    assert site.refuse(plan, new) == "it decides 2 times on t3"


@pytest.mark.parametrize(
    ("step", "said"),
    [
        ({"action": Action.STOP, "reason": Reason.LEFT_FILE, "previous": "a"}, "stop of t1 does not fit"),
        ({"action": Action.COMPLETE, "verdict": Verdict.COMPLETED, "previous": "a"}, "t1 is kept now"),
        ({"action": Action.UNPLACED, "reason": Reason.NO_FEASIBLE_HOST, "stop": ("a",)}, "unplaced of t1"),
        ({"action": Action.HOLD, "verdict": Verdict.HELD, "host": "b", "stop": ("a",)}, "t1 is kept now"),
    ],
)
def test_a_stop_of_what_should_run_is_refused(site: Site, step: dict[str, object], said: str) -> None:
    made = make_plan(site.fleet, POLICY)
    instances = {"a": made.snapshot.hosts["a"].tasks["t1"].instance}
    plan = craft(made, "t1", **{"verdict": Verdict.UNPLACED, "instances": instances, **step})
    assert site.refuse(plan).startswith(said)


def test_a_start_of_what_may_run_on_a_silent_host_is_refused(site: Site) -> None:
    site.hosts.down.add("a")
    plan = craft(make_plan(site.fleet, POLICY), "t1", action=Action.START, host="b")
    assert site.refuse(plan) == "t1 is held now (host-silent)"


@pytest.mark.parametrize("check", [apply_saved_plan, check_saved_plan])
def test_names_that_the_files_do_not_have_are_refused(
    site: Site, check: Callable[[Fleet, Plan], object]
) -> None:
    made = make_plan(site.fleet, POLICY)
    with pytest.raises(StalePlanError, match=r"edge9 \(start of t1\) is not in the inventory"):
        check(site.fleet, craft(made, "t1", action=Action.START, host="edge9"))
    ghost = Decision(task="ghost", verdict=Verdict.PLACED, reason=Reason.BEST, host="a")
    with pytest.raises(StalePlanError, match="ghost is not in the task files"):
        check(site.fleet, dataclasses.replace(made, steps=(Step(decision=ghost, action=Action.START),)))


def test_a_plan_of_edgectl_itself_is_applied(site: Site) -> None:
    """Start, restart and stop of a task that left the files, in one plan."""
    new = some_tasks(
        dataclasses.replace(TASKS.tasks["t1"], spec_hash="changed"), a_task("t3", cpu=1.0), a_task("t4")
    )
    fleet = dataclasses.replace(site.fleet, tasks=new)
    made = make_plan(fleet, POLICY)
    actions = {step.task: step.action for step in made.steps}
    assert {Action.STOP, Action.START, Action.RESTART} <= set(actions.values()), actions
    applied = apply_saved_plan(fleet, made)
    assert applied.results is not None
    assert applied.results.done
    assert not site.hosts.world.overlap
