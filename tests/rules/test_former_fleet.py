# SPDX-License-Identifier: Apache-2.0
"""A fleet without a stated name beside what it was before: whose tasks it would start again."""

from dataclasses import replace

from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.plan import Action, Step
from edgectl.model.snapshot import OtherTask, TaskState
from edgectl.rules.former_fleet import find_former_fleet
from tests.builders import a_sample, a_snapshot, an_edge, an_inventory

ME = "ana@desk"
UNNAMED = replace(an_inventory(an_edge("edge2"), an_edge("edge1")), fleet="hall-2", is_fleet_named=False)


def steps(**actions: Action) -> list[Step]:
    return [
        Step(
            decision=Decision(task=task, verdict=Verdict.PLACED, reason=Reason.BEST, host="edge1"),
            action=action,
        )
        for task, action in actions.items()
    ]


def theirs(task: str, *, fleet: str = "lab-1", by: str = ME) -> OtherTask:
    return OtherTask(fleet=fleet, host="edge1", task=task, state=TaskState.READY, started_by=by)


def test_who_would_be_started_a_second_time() -> None:
    look = a_snapshot(
        edge2=replace(a_sample(), foreign_tasks=(theirs("zeta"), theirs("yak"), theirs("xu", fleet="arm"))),
        edge1=a_sample(),
    )
    starting = steps(zeta=Action.START, yak=Action.START, xu=Action.KEEP)
    found = find_former_fleet(UNNAMED, starting, look, ME)
    assert found is not None
    assert (found.fleet, found.host, found.tasks) == ("lab-1", "edge2", ("yak", "zeta"))
    assert found.message.endswith("they would be started a second time")
    assert found.hint.startswith("add fleet: lab-1 to the inventory")


def test_who_states_a_name_and_what_others_started_is_left_alone() -> None:
    look = a_snapshot(edge1=replace(a_sample(), foreign_tasks=(theirs("zeta"),)))
    starting = steps(zeta=Action.START)
    assert find_former_fleet(UNNAMED, starting, look, ME) is not None
    assert find_former_fleet(replace(UNNAMED, is_fleet_named=True), starting, look, ME) is None
    assert find_former_fleet(UNNAMED, starting, look, "paula@desk") is None
    assert find_former_fleet(UNNAMED, steps(zeta=Action.KEEP), look, ME) is None
    before_fleets = a_snapshot(edge1=replace(a_sample(), foreign_tasks=(theirs("zeta", fleet=""),)))
    assert find_former_fleet(UNNAMED, starting, before_fleets, ME) is None
