# SPDX-License-Identifier: Apache-2.0
"""Initial state of a plan: completed, unmanaged, held and doubled tasks; unreachable hosts and robots."""

from dataclasses import replace
from typing import Any

import pytest

from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.inventory import Inventory, Role
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.task import DetectRule, Need, NeedCondition, NeedRestart, Task, TaskKind
from edgectl.rules.need_runs import mark_run
from tests.builders import (
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)
from tests.scheduler.fleets import NO_MEMORY, decisions_by_task, hosts_by_task, ranking_by_host, run_assign

ONE, TWO = an_inventory(an_edge()), an_inventory(an_edge("edge1"), an_edge("edge2"))
ROBOTIC = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot())
LINKS = {"robot1": a_link()}
CPU = Policy(weights=parse_weights("cpu"))


def summarize_decision(decision: Decision) -> tuple[Verdict, Reason, str | None, str | None]:
    return decision.verdict, decision.reason, decision.host, decision.subject


def a_manager_state(task: str, host: str, **fields: object) -> ManagerState:
    return ManagerState(managed=True, placements={task: Placement(host=host, since=NOW - 900.0)}, **fields)  # type: ignore[arg-type]


# --- completed tasks


def test_a_marked_task_is_stopped_and_its_use_is_free_for_every_task_of_the_same_plan() -> None:
    snapshot = a_snapshot(edge1=a_sample(used=3.5, tasks={"zoom": a_run(used=Usage(cpu=3.0))}))
    memory = ManagerState(managed=True, done={"zoom": "hash-zoom"})
    found = run_assign(
        ONE, some_tasks(a_task("slam", cpu=2.0), a_task("zoom", cpu=3.0)), snapshot, memory=memory
    )
    # slam comes first by name, and yet sees only 3.5 - 3 = .5 in use: (4 - .5 - 2) / 4
    assert decisions_by_task(found)["slam"].ranking[0].terms["cpu"] == pytest.approx(0.375)
    assert summarize_decision(decisions_by_task(found)["zoom"]) == (
        Verdict.COMPLETED,
        Reason.DONE,
        None,
        None,
    )
    assert decisions_by_task(found)["zoom"].previous_host == "edge1"


@pytest.mark.parametrize(
    ("memory", "tasks", "completed"),
    [
        (NO_MEMORY, {"slam": a_run(TaskState.COMPLETED, pid=0)}, False),  # of which specification?
        (NO_MEMORY, {"slam": a_run(TaskState.COMPLETED, spec_hash="hash-slam")}, True),  # done_when passed
        (
            NO_MEMORY,
            {"slam": a_run(TaskState.COMPLETED, spec_hash="older")},
            False,
        ),  # the spec has changed since
        (ManagerState(done={"slam": "hash-slam"}), {}, True),
        (ManagerState(done={"slam": "older"}), {}, False),
        (NO_MEMORY, {"slam": a_run(TaskState.FAILED)}, False),
    ],
)
def test_when_a_task_is_completed(memory: ManagerState, tasks: dict[str, object], completed: bool) -> None:
    snapshot = a_snapshot(edge1=a_sample(tasks=tasks))  # type: ignore[arg-type]
    decision = run_assign(ONE, some_tasks(a_task()), snapshot, memory=memory).decisions[0]
    assert (decision.verdict is Verdict.COMPLETED) == completed
    assert decision.host == (None if completed else "edge1")


@pytest.mark.parametrize(
    ("core", "completed"),
    [
        (a_run(instance="c1"), True),
        (a_run(instance="c1", restarts=1), False),  # killed, and started again by its supervisor
        (a_run(instance="c2"), False),
        (a_run(TaskState.FAILED, instance="c1"), False),  # what comes next is another run
        (None, False),
    ],
)
@pytest.mark.parametrize("done", [{}, {"load": "hash-load"}])
def test_a_job_that_restarts_with_its_predecessor_is_completed_for_one_run_of_it(
    core: TaskSample | None, completed: bool, done: dict[str, str]
) -> None:
    follows = Need(task="core", restart=NeedRestart.WITH)
    tasks = some_tasks(a_task("core"), a_task("load", kind=TaskKind.JOB, needs=(follows,)))
    job = a_run(TaskState.COMPLETED, pid=0, spec_hash="hash-load", needed=mark_run("c1", 0))
    runs = {"load": job} | ({"core": core} if core is not None else {})
    found = run_assign(ONE, tasks, a_snapshot(edge1=a_sample(tasks=runs)), memory=ManagerState(done=done))
    decision = decisions_by_task(found)["load"]
    assert (decision.verdict is Verdict.COMPLETED) == completed
    # Where the host of the predecessor is silent, its run may be the same.
    placed = {"core": Placement(host="edge2", since=0.0)}
    unsure = run_assign(
        TWO,
        tasks,
        a_snapshot(edge1=a_sample(tasks={"load": job}), edge2=silent()),
        memory=ManagerState(done=done, placements=placed),
    )
    assert decisions_by_task(unsure)["load"].verdict is Verdict.COMPLETED


def test_a_newer_instance_that_is_alive_is_not_completed() -> None:
    old, new = a_run(TaskState.COMPLETED, pid=0, generation=1), a_run(generation=2)
    found = run_assign(
        TWO,
        some_tasks(a_task()),
        a_snapshot(edge1=a_sample(tasks={"slam": old}), edge2=a_sample(tasks={"slam": new})),
    )
    assert hosts_by_task(found) == {"slam": "edge2"}


def test_what_the_gateway_took_out_is_not_taken_out_again() -> None:
    snapshot = a_snapshot(
        edge1=a_sample(used=1.0, tasks={"slam": a_run(TaskState.COMPLETED, used=Usage(cpu=0.8))})
    )
    assert run_assign(ONE, some_tasks(a_task()), snapshot).expected["edge1"].used["cpu"] == 1.0


@pytest.mark.parametrize("until", list(NeedCondition))
def test_a_completed_predecessor_satisfies_every_need_and_draws_nobody(until: NeedCondition) -> None:
    tasks = some_tasks(a_task("map"), a_task("nav", needs=[Need(task="map", until=until)]))
    found = run_assign(
        TWO,
        tasks,
        a_snapshot(edge1=a_sample(), edge2=a_sample()),
        memory=ManagerState(done={"map": "hash-map"}),
    )
    nav = decisions_by_task(found)["nav"]
    assert nav.host == "edge1"
    assert {entry.terms["task"] for entry in nav.ranking} == {0.5}


def test_tasks_that_left_the_file_are_no_load_of_the_outcome() -> None:
    runs = {"gone": a_run(used=Usage(cpu=1.0)), "foreign": a_run(used=Usage(cpu=0.5), managed=False)}
    found = run_assign(ONE, some_tasks(a_task()), a_snapshot(edge1=a_sample(used=2.0, tasks=runs)))
    assert found.expected["edge1"].used["cpu"] == 1.0


# --- managed: false


def an_unmanaged_task(name: str = "slam") -> Task:
    return a_task(name, cpu=3.0, managed=False, detect=DetectRule(cmdline="gmapping"))


def test_an_unmanaged_task_is_load_and_predecessor_where_it_was_found() -> None:
    snapshot = a_snapshot(
        edge1=a_sample(), edge2=a_sample(used=0.4, tasks={"slam": a_run(used=Usage(cpu=0.4))})
    )
    found = run_assign(
        TWO, some_tasks(an_unmanaged_task(), a_task("nav", needs=["slam"])), snapshot, policy=Policy()
    )
    assert summarize_decision(decisions_by_task(found)["slam"]) == (
        Verdict.KEPT,
        Reason.UNMANAGED,
        "edge2",
        None,
    )
    assert hosts_by_task(found)["nav"] == "edge2"
    assert found.expected["edge2"].used["cpu"] == 0.4  # the measured value, not the demand


def test_an_unmanaged_task_that_was_not_found_is_nowhere_and_its_successor_waits() -> None:
    found = run_assign(
        ONE, some_tasks(an_unmanaged_task(), a_task("nav", needs=["slam"])), a_snapshot(edge1=a_sample())
    )
    assert summarize_decision(decisions_by_task(found)["slam"]) == (
        Verdict.KEPT,
        Reason.UNMANAGED,
        None,
        None,
    )
    assert summarize_decision(decisions_by_task(found)["nav"]) == (
        Verdict.UNPLACED,
        Reason.PREDECESSOR_MISSING,
        None,
        "slam",
    )


def test_a_task_of_ours_that_somebody_else_started_is_left_alone() -> None:
    found = run_assign(
        TWO,
        some_tasks(a_task()),
        a_snapshot(edge1=a_sample(), edge2=a_sample(tasks={"slam": a_run(managed=False)})),
    )
    assert summarize_decision(decisions_by_task(found)["slam"]) == (
        Verdict.KEPT,
        Reason.UNMANAGED,
        "edge2",
        None,
    )


# --- manager state


def test_a_task_on_a_silent_host_is_held_and_still_a_predecessor() -> None:
    tasks = some_tasks(a_task("slam"), a_task("nav", needs=["slam"]))
    found = run_assign(
        TWO, tasks, a_snapshot(edge1=silent(), edge2=a_sample()), memory=a_manager_state("slam", "edge1")
    )
    assert summarize_decision(decisions_by_task(found)["slam"]) == (
        Verdict.HELD,
        Reason.HOST_SILENT,
        "edge1",
        "edge1",
    )
    assert decisions_by_task(found)["nav"].host == "edge2"
    assert ranking_by_host(decisions_by_task(found)["nav"])["edge2"].affinity == -1


@pytest.mark.parametrize(
    ("memory", "snapshot", "host"),
    [
        # its host answers without the task: it is gone, and starts anew
        (a_manager_state("slam", "edge1"), a_snapshot(edge1=a_sample(used=1.0), edge2=a_sample()), "edge2"),
        # it was seen elsewhere, whatever the manager state says
        (
            a_manager_state("slam", "edge1"),
            a_snapshot(edge1=silent(), edge2=a_sample(tasks={"slam": a_run()})),
            "edge2",
        ),
        # it was on a host that left the inventory, where it may run on
        (
            a_manager_state("slam", "old-edge"),
            a_snapshot(edge1=a_sample(used=1.0), edge2=a_sample()),
            None,
        ),
        # an edge of the inventory that is missing in the snapshot is unreachable
        (a_manager_state("slam", "edge1"), a_snapshot(edge2=a_sample()), "edge1"),
    ],
)
def test_what_is_remembered_and_what_is_seen(
    memory: ManagerState, snapshot: Snapshot, host: str | None
) -> None:
    assert hosts_by_task(run_assign(TWO, some_tasks(a_task()), snapshot, memory=memory)) == {"slam": host}


@pytest.mark.parametrize(
    ("memory", "unseen"), [(ManagerState(), ("edge1",)), (ManagerState(managed=True), ())]
)
def test_a_new_manager_starts_what_it_does_not_see_and_names_the_silent_hosts(
    memory: ManagerState, unseen: tuple[str, ...]
) -> None:
    found = run_assign(TWO, some_tasks(a_task()), a_snapshot(edge1=silent(), edge2=a_sample()), memory=memory)
    assert hosts_by_task(found) == {"slam": "edge2"}
    assert found.unseen == unseen


def test_an_unreachable_robot_holds_its_tasks() -> None:
    tasks = some_tasks(a_task("nav", robots=["robot1"]), a_task("slam", robots=["robot1"]), a_task("web"))
    runs = {"slam": a_run(used=Usage(cpu=1.0))}
    snapshot = a_snapshot(
        edge1=a_sample(used=1.5, links=LINKS, tasks=runs),
        edge2=a_sample(links=LINKS),
        robot1=silent(Role.ROBOT),
    )
    found = run_assign(ROBOTIC, tasks, snapshot, policy=CPU)
    assert summarize_decision(decisions_by_task(found)["nav"]) == (
        Verdict.HELD,
        Reason.ROBOT_SILENT,
        None,
        "robot1",
    )
    assert summarize_decision(decisions_by_task(found)["slam"]) == (
        Verdict.HELD,
        Reason.ROBOT_SILENT,
        "edge1",
        "robot1",
    )
    assert hosts_by_task(found)["web"] == "edge2"
    assert found.expected["edge1"].used["cpu"] == 1.5


def test_a_robot_that_is_never_probed_is_taken_as_reachable() -> None:
    inventory = an_inventory(an_edge(), a_robot(probe=False))
    found = run_assign(
        inventory, some_tasks(a_task(robots=["robot1"])), a_snapshot(edge1=a_sample(links=LINKS))
    )
    assert hosts_by_task(found) == {"slam": "edge1"}


@pytest.mark.parametrize(
    ("first", "second", "memory", "winner"),
    [
        (
            {"generation": 3},
            {"generation": 2, "started_at": NOW},
            a_manager_state("slam", "edge2"),
            "edge2",
        ),  # the one that was placed, whatever the other host reports
        ({"generation": 3}, {"generation": 2, "started_at": NOW}, NO_MEMORY, "edge1"),  # then the generation
        ({"started_at": NOW}, {}, a_manager_state("slam", "edge2"), "edge2"),  # then the manager state
        ({"started_at": NOW - 10}, {"started_at": NOW - 500}, NO_MEMORY, "edge1"),  # then the later start
        ({}, {}, NO_MEMORY, "edge1"),  # then the name
    ],
)
def test_of_two_copies_the_newer_assignment_wins(
    first: dict[str, Any], second: dict[str, Any], memory: ManagerState, winner: str
) -> None:
    snapshot = a_snapshot(
        edge1=a_sample(used=1.0, tasks={"slam": a_run(used=Usage(cpu=1.0), **first)}),
        edge2=a_sample(used=1.0, tasks={"slam": a_run(used=Usage(cpu=1.0), **second)}),
    )
    found = run_assign(TWO, some_tasks(a_task(cpu=0.1)), snapshot, memory=memory)
    assert hosts_by_task(found) == {"slam": winner}
    loser = {"edge1": "edge2", "edge2": "edge1"}[winner]
    assert found.expected[loser].used["cpu"] == 0.0  # the copy is stopped by the same plan


@pytest.mark.parametrize("state", [TaskState.FAILED, TaskState.CRASHLOOP])
def test_a_failed_task_is_placed_anew(state: TaskState) -> None:
    snapshot = a_snapshot(edge1=a_sample(used=1.0, tasks={"slam": a_run(state)}), edge2=a_sample())
    decision = run_assign(TWO, some_tasks(a_task()), snapshot).decisions[0]
    assert (decision.verdict, decision.host, decision.previous_host) == (Verdict.PLACED, "edge2", None)


GIVEN_UP = a_run(TaskState.CRASHLOOP, pid=0, given_up=True, exit_code=1, spec_hash="hash-slam", generation=5)


@pytest.mark.parametrize("state", [TaskState.FAILED, TaskState.CRASHLOOP])
def test_a_task_that_was_given_up_waits_for_a_word(state: TaskState) -> None:
    """Not even the idle host gets it, although the one where it failed is busy."""
    snapshot = a_snapshot(
        edge1=a_sample(used=1.0, tasks={"slam": replace(GIVEN_UP, state=state)}), edge2=a_sample()
    )
    found = run_assign(
        TWO,
        some_tasks(a_task(), a_task("nav", needs=["slam"])),
        snapshot,
        memory=a_manager_state("slam", "edge1"),
    )
    assert summarize_decision(decisions_by_task(found)["slam"]) == (
        Verdict.UNPLACED,
        Reason.GIVEN_UP,
        None,
        "edge1",
    )
    assert decisions_by_task(found)["slam"].amount == 1.0
    assert summarize_decision(decisions_by_task(found)["nav"]) == (
        Verdict.UNPLACED,
        Reason.PREDECESSOR_MISSING,
        None,
        "slam",
    )


@pytest.mark.parametrize(
    ("ended", "memory", "told"),
    [
        ({"spec_hash": "older"}, NO_MEMORY, 0),  # it may succeed now
        ({"given_up": False}, NO_MEMORY, 0),  # it died with its host, or its supervisor was lost
        ({}, NO_MEMORY, 6),  # started and stopped on edge2 since
        (
            {},
            ManagerState(placements={"slam": Placement(host="edge2", since=NOW, generation=6)}),
            0,
        ),  # and removed from there
    ],
)
def test_when_a_task_that_ended_is_started_again(
    ended: dict[str, object], memory: ManagerState, told: int
) -> None:
    edge2 = replace(a_sample(), generations={"slam": told})
    snapshot = a_snapshot(edge1=a_sample(used=1.0, tasks={"slam": replace(GIVEN_UP, **ended)}), edge2=edge2)  # type: ignore[arg-type]
    assert hosts_by_task(run_assign(TWO, some_tasks(a_task()), snapshot, memory=memory)) == {"slam": "edge2"}


def test_the_run_of_now_counts_and_not_the_one_that_was_given_up_before() -> None:
    snapshot = a_snapshot(
        edge1=a_sample(tasks={"slam": GIVEN_UP}), edge2=a_sample(tasks={"slam": a_run(generation=6)})
    )
    decision = run_assign(TWO, some_tasks(a_task()), snapshot).decisions[0]
    assert (decision.verdict, decision.host) == (Verdict.KEPT, "edge2")


def test_hosts_that_are_not_in_the_inventory_are_not_looked_at() -> None:
    inventory: Inventory = ONE
    snapshot = a_snapshot(edge1=a_sample(), stranger=a_sample(tasks={"slam": a_run()}))
    assert hosts_by_task(run_assign(inventory, some_tasks(a_task()), snapshot)) == {"slam": "edge1"}
