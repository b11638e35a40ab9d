# SPDX-License-Identifier: Apache-2.0
"""Pins of operators: what they decide, and every case in which they do not count."""

from collections.abc import Mapping
from dataclasses import replace

import pytest

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Decision, Reason, RejectionRule, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Pin, Placement
from edgectl.model.plan import Action
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.predicted_latency import ServiceTime
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.standby_plan import StandbyAction
from edgectl.model.task import Task
from edgectl.scheduler.assign import assign
from edgectl.solver.highs import make_solver
from edgectl.views.reasons import describe_reason
from tests.builders import (
    GI,
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_standby_rule,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)
from tests.scheduler.fleets import decisions_by_task, hosts_by_task, run_assign, simulate_apply

# edge3 is idle and edge2 half full: without a pin a task of one core goes to edge3, and stays there.
LOADS = {"edge3": 0.0, "edge2": 2.0, "edge1": 1.0}
FLEET = an_inventory(*map(an_edge, LOADS))
SLAM = a_task("slam", cpu=1.0)
PINNED = ManagerState(managed=True, pins={"slam": Pin(host="edge2", since=NOW - 60.0)})


def look(running: Mapping[str, str] | None = None, **changed: HostSample) -> Snapshot:
    """The three edges, where ``running`` says which host each task runs on."""
    hosts = {
        edge: a_sample(
            used=used,
            tasks={
                task: a_run(spec_hash=f"hash-{task}")
                for task, host in (running or {}).items()
                if host == edge
            },
        )
        for edge, used in LOADS.items()
    }
    return a_snapshot({**hosts, **changed})


def decide(
    snapshot: Snapshot,
    *tasks: Task,
    manager: ManagerState = PINNED,
    inventory: Inventory = FLEET,
    policy: Policy | None = None,
    now: float = NOW,
) -> tuple[Decision, str]:
    """The decision on slam, and its reason in words."""
    given = some_tasks(*(tasks or (SLAM,)))
    assignment = run_assign(inventory, given, snapshot, memory=manager, policy=policy, now=now)
    steps = {step.task: step for step in diff_assignment(assignment, given, snapshot, manager)}
    return decisions_by_task(assignment)["slam"], describe_reason(steps["slam"])


def test_the_fleet_itself_prefers_another_host() -> None:
    """Otherwise no test here could fail."""
    assert decide(look(), manager=ManagerState(managed=True))[0].host == "edge3"


@pytest.mark.parametrize("running", [{}, {"slam": "edge3"}, {"slam": "edge2"}])
def test_a_pinned_task_goes_to_its_host_and_stays_there(running: Mapping[str, str]) -> None:
    found, words = decide(look(running), policy=Policy(min_dwell=1e9, max_moves=0, attended=False))
    assert (found.host, found.reason) == ("edge2", Reason.PINNED_BY_OPERATOR)
    assert words.endswith(": pinned to edge2 by edgectl move")


def test_the_reason_tells_when_a_pin_ends_and_then_it_has_ended() -> None:
    pin = Pin(host="edge2", since=NOW - 60.0, until=NOW + 60.0)
    manager = replace(PINNED, pins={"slam": pin})
    found, words = decide(look({"slam": "edge3"}), manager=manager)
    assert found.host == "edge2"
    assert words == "move: pinned to edge2 until 2025-11-21T01:54:20Z by edgectl move"
    later, _ = decide(look({"slam": "edge3"}), manager=manager, now=NOW + 60.0)
    assert (later.host, later.pin) == ("edge3", None)


def test_after_its_end_a_task_moves_back_only_for_a_gain() -> None:
    """The end of a pin moves nothing by itself: the margin holds as for every running task."""
    ended = replace(PINNED, pins={"slam": Pin(host="edge2", since=0.0, until=NOW)})
    patient, _ = decide(look({"slam": "edge2"}), manager=ended, policy=Policy(move_margin=0.9))
    assert patient.host == "edge2"
    eager, _ = decide(look({"slam": "edge2"}), manager=ended, policy=Policy(move_margin=0.01))
    assert eager.host == "edge3"


SET_ASIDE = {
    "lost": (look(edge2=silent()), PINNED, RejectionRule.UNREACHABLE, "unreachable"),
    "cordoned": (look(), replace(PINNED, cordons=frozenset({"edge2"})), RejectionRule.CORDONED, "cordoned"),
    "drained": (
        look({"slam": "edge2"}),
        replace(PINNED, cordons=frozenset({"edge2"}), draining=frozenset({"edge2"})),
        RejectionRule.CORDONED,
        "cordoned",
    ),
    "removed": (
        look(),
        replace(PINNED, pins={"slam": Pin(host="edge9", since=0.0, machine="m9")}),
        RejectionRule.NOT_LISTED,
        "not in the inventory",
    ),
    "too small": (look(edge2=a_sample(cores=0.5)), PINNED, RejectionRule.INSUFFICIENT, "too small for it"),
}


@pytest.mark.parametrize("name", SET_ASIDE)
def test_a_pin_that_cannot_be_followed_is_set_aside_and_says_why(name: str) -> None:
    snapshot, manager, rule, words = SET_ASIDE[name]
    found, said = decide(snapshot, manager=manager)
    assert found.host == "edge3"
    assert found.pin is not None
    assert found.pin.set_aside is rule
    assert said.endswith(f"; its pin does not count: {found.pin.host} is {words}")


def test_rules_of_the_task_file_that_changed_later_win() -> None:
    for task, rule in (
        (a_task("slam", cpu=1.0, never=["edge2"]), RejectionRule.NEVER),
        (a_task("slam", cpu=1.0, only=["edge1", "edge3"]), RejectionRule.NOT_ONLY),
        (a_task("slam", cpu=1.0, labels={"gpu": "yes"}), RejectionRule.LABELS),
        (a_task("slam", cpu=1.0, pin="edge1"), RejectionRule.PIN),
    ):
        found, _ = decide(look(), task)
        assert found.pin is not None
        assert found.pin.set_aside is rule
        assert found.host != "edge2"


def test_a_cordon_leaves_a_pinned_task_where_it_runs() -> None:
    """A cordon is about new work only."""
    cordoned = replace(PINNED, cordons=frozenset({"edge2"}))
    found, _ = decide(
        look({"slam": "edge2"}), manager=cordoned, policy=Policy(move_margin=0.0, min_dwell=0.0)
    )
    assert (found.host, found.reason) == ("edge2", Reason.PINNED_BY_OPERATOR)


def test_without_plans_as_if_the_pinned_host_were_gone() -> None:
    found, words = decide(look({"slam": "edge2"}), policy=Policy(without=frozenset({"edge2"})))
    assert found.host == "edge3"
    assert words.endswith("its pin does not count: edge2 is left out by --without")


def test_a_pin_follows_its_machine_to_a_new_name() -> None:
    renamed = an_inventory(an_edge("edge3"), an_edge("jetson"), an_edge("edge1"))
    hosts = {"edge3": a_sample(), "jetson": replace(a_sample(used=2.0), machine="m2"), "edge1": a_sample()}
    manager = replace(PINNED, pins={"slam": Pin(host="edge2", since=0.0, machine="m2")})
    found, words = decide(a_snapshot(hosts), manager=manager, inventory=renamed)
    assert (found.host, words) == ("jetson", "start: pinned to jetson by edgectl move")
    slices = {name: replace(sample, machine="m2") for name, sample in hosts.items()}
    unsure, _ = decide(a_snapshot(slices), manager=manager, inventory=renamed)
    assert unsure.pin is not None
    assert unsure.pin.set_aside is RejectionRule.NOT_LISTED


def test_a_pin_follows_its_machine_where_two_hosts_have_exchanged_their_names() -> None:
    """Only where it is known which machine the host of that name is, and that another one is the pinned."""
    manager = replace(PINNED, pins={"slam": Pin(host="edge2", since=0.0, machine="m2")})
    for machines, host in (
        (("m3", "m1", "m2"), "edge1"),
        (("m3", "m2", "m1"), "edge2"),
        (("m3", "m9", "m1"), "edge2"),
        (("m3", "", "m2"), "edge2"),
        (("m2", "m9", "m2"), "edge2"),
    ):
        named = zip(LOADS, machines, strict=True)
        hosts = {name: replace(a_sample(), machine=machine) for name, machine in named}
        assert decide(a_snapshot(hosts), manager=manager)[0].host == host


def test_a_task_waits_for_room_on_its_host_and_others_make_it() -> None:
    """edge2 has 2 of 4 cores left and needs 3: bulk, which may go elsewhere, makes room."""
    big = a_task("slam", cpu=3.0)
    alone, words = decide(look(edge2=a_sample(used=2.0)), big)
    assert (alone.host, alone.verdict) == (None, Verdict.UNPLACED)
    assert "; pinned to edge2 (edgectl unpin slam)" in words
    bulk = a_task("bulk", cpu=2.0)
    manager = replace(PINNED, placements={"bulk": Placement(host="edge2", since=NOW - 3600.0)})
    snapshot = look({"bulk": "edge2"})
    run = replace(snapshot.hosts["edge2"].tasks["bulk"], used=Usage(cpu=2.0))
    hosts = {**snapshot.hosts, "edge2": replace(snapshot.hosts["edge2"], tasks={"bulk": run})}
    assignment = run_assign(
        FLEET,
        some_tasks(big, bulk),
        replace(snapshot, hosts=hosts),
        memory=manager,
        policy=Policy(min_dwell=0.0),
    )
    assert hosts_by_task(assignment) == {"bulk": "edge3", "slam": "edge2"}


def test_a_full_host_leaves_a_running_task_where_it_is() -> None:
    found, words = decide(look({"slam": "edge1"}, edge2=a_sample(used=4.0)))
    assert (found.host, found.verdict) == ("edge1", Verdict.KEPT)
    assert words.endswith("it stays where it runs; pinned to edge2 (edgectl unpin slam)")


def test_a_held_task_is_not_started_at_its_pin() -> None:
    """Its host does not answer, so it may still run there."""
    manager = replace(PINNED, placements={"slam": Placement(host="edge1", since=NOW - 3600.0)})
    found, _ = decide(look(edge1=silent()), manager=manager)
    assert (found.verdict, found.reason) == (Verdict.HELD, Reason.HOST_SILENT)


def test_tasks_that_go_together_follow_the_pinned_one() -> None:
    nav, camera = a_task("nav", cpu=0.1, together=("slam",)), a_task("camera", cpu=0.1)
    for running in ({}, {"slam": "edge3", "nav": "edge3"}):
        found = hosts_by_task(
            run_assign(
                FLEET,
                some_tasks(SLAM, nav, camera),
                look(running),
                memory=PINNED,
                policy=Policy(min_dwell=0.0),
            )
        )
        assert (found["slam"], found["nav"]) == ("edge2", "edge2")
        assert found["camera"] != "edge2"


def test_a_successor_goes_by_utility() -> None:
    """needs is an order, not a place: with the weight of affinity alone it follows, without it does not."""
    nav = a_task("nav", cpu=0.1, needs=["slam"])
    given = some_tasks(SLAM, nav)
    for weights, host in (({"task": 1.0}, "edge2"), ({"cpu": 1.0}, "edge3")):
        policy = Policy(
            weights=Policy().weights.__class__({**dict.fromkeys(Policy().weights, 0.0), **weights})
        )
        assert hosts_by_task(run_assign(FLEET, given, look(), memory=PINNED, policy=policy))["nav"] == host


def test_copies_wait_elsewhere_and_one_at_the_pin_becomes_active() -> None:
    """slam starts on edge2 with a copy on edge3; pinned there, it moves to its copy, and leaves one behind."""
    given = some_tasks(a_task("slam", cpu=1.0, standby=a_standby_rule()))
    first = run_assign(FLEET, given, look(), memory=PINNED)
    assert hosts_by_task(first) == {"slam": "edge2"}
    assert [(step.host, step.action) for step in first.standbys["slam"]] == [("edge3", StandbyAction.START)]
    snapshot, manager = simulate_apply(first, given, look(), PINNED)
    manager = replace(manager, pins={"slam": Pin(host="edge3", since=NOW)})
    second = run_assign(FLEET, given, snapshot, memory=manager)
    assert hosts_by_task(second) == {"slam": "edge3"}
    assert {step.host for step in second.standbys["slam"]}.isdisjoint({None, "edge1"})
    gone = replace(snapshot, hosts={**snapshot.hosts, "edge2": look().hosts["edge2"]})
    third = decisions_by_task(run_assign(FLEET, given, gone, memory=replace(manager, placements={})))["slam"]
    assert (third.host, third.reason) == ("edge3", Reason.STANDBY_ACTIVATED)


def test_an_applied_pin_changes_nothing_more() -> None:
    given = some_tasks(SLAM, a_task("nav", cpu=0.5), a_task("camera", cpu=1.0))
    snapshot, manager = look({"slam": "edge3", "nav": "edge1"}), PINNED
    for _ in range(2):
        assignment = run_assign(FLEET, given, snapshot, memory=manager, policy=Policy(min_dwell=0.0))
        snapshot, manager = simulate_apply(assignment, given, snapshot, manager)
    steps = diff_assignment(assignment, given, snapshot, manager)
    assert {step.action for step in steps} == {Action.KEEP}


def test_a_pin_to_the_own_robot_and_not_to_another() -> None:
    robots = (a_robot("robot1", onboard=True), a_robot("robot2", onboard=True))
    fleet = an_inventory(an_edge("edge1"), *robots)
    task = a_task("slam", cpu=0.5, robots=["robot1"])
    hosts = {
        "edge1": a_sample(links={"robot1": a_link(), "robot2": a_link()}),
        "robot1": a_sample(cores=1.0, memory=GI, role=robots[0].role),
        "robot2": a_sample(role=robots[1].role),
    }
    for robot, host in (("robot1", "robot1"), ("robot2", "edge1")):
        manager = replace(PINNED, pins={"slam": Pin(host=robot, since=0.0)})
        found, _ = decide(a_snapshot(hosts), task, manager=manager, inventory=fleet)
        assert found.host == host


def test_the_baselines_static_and_paper_follow_a_pin_and_local_does_not() -> None:
    for name in (PolicyName.STATIC, PolicyName.PAPER):
        assert decide(look(), policy=Policy(name=name))[0].host == "edge2"
    assert decide(look(), policy=Policy(name=PolicyName.LOCAL))[0].pin is None


def decide_all(
    *tasks: Task, running: Mapping[str, str] | None = None, **pins: str
) -> dict[str, tuple[str | None, RejectionRule | None]]:
    """The host of every task, and what sets its pin aside; the pins as set one after the other."""
    set_pins = {
        task: Pin(host=host, since=NOW - 60.0 + turn) for turn, (task, host) in enumerate(pins.items())
    }
    found = run_assign(
        FLEET,
        some_tasks(*tasks),
        look(running, edge2=a_sample(cores=16.0)),
        memory=ManagerState(managed=True, pins=set_pins),
        policy=Policy(min_dwell=0.0),
    )
    return {
        each.task: (each.host, each.pin.set_aside if each.pin is not None else None)
        for each in found.decisions
    }


def test_of_pins_of_tasks_that_were_joined_later_the_newest_counts() -> None:
    """Their files did not say together when they were pinned; none of them may be left without a host."""
    joined = a_task("zed", cpu=1.0, together=("ant",)), a_task("ant", cpu=1.0)
    aside = RejectionRule.TOGETHER
    for running in ({}, {"zed": "edge2", "ant": "edge2"}):
        found = decide_all(*joined, running=running, zed="edge3", ant="edge1")
        assert found == {"zed": ("edge1", aside), "ant": ("edge1", None)}
        found = decide_all(*joined, running=running, ant="edge1", zed="edge3")
        assert found == {"zed": ("edge3", None), "ant": ("edge3", aside)}


def test_of_pins_of_tasks_that_are_apart_the_newest_counts() -> None:
    zed, ant, aside = a_task("zed", cpu=1.0, apart=("ant",)), a_task("ant", cpu=1.0), RejectionRule.APART
    found = decide_all(zed, ant, zed="edge3", ant="edge3")
    assert found == {"zed": ("edge2", aside), "ant": ("edge3", None)}
    found = decide_all(zed, ant, ant="edge3", zed="edge3")
    assert found == {"zed": ("edge3", None), "ant": ("edge2", aside)}


def test_the_pin_of_a_file_keeps_a_task_off_that_is_apart() -> None:
    for zed, ant in (
        (a_task("zed", cpu=1.0, apart=("ant",)), a_task("ant", cpu=1.0, pin="edge3")),
        (a_task("zed", cpu=1.0), a_task("ant", cpu=1.0, pin="edge3", apart=("zed",))),
    ):
        found = decide_all(zed, ant, zed="edge3")
        assert found == {"zed": ("edge2", RejectionRule.APART), "ant": ("edge3", None)}


def test_a_pinned_host_must_have_room_for_all_that_go_together() -> None:
    """Each fits on edge3, with 4 cores, and both only on edge2, with 16."""
    zed, ant = a_task("zed", cpu=3.0, together=("ant",)), a_task("ant", cpu=3.0)
    found = decide_all(zed, ant, zed="edge3")
    assert found == {"zed": ("edge2", RejectionRule.INSUFFICIENT), "ant": ("edge2", None)}
    assert decide_all(zed, ant, zed="edge2") == {"zed": ("edge2", None), "ant": ("edge2", None)}


@pytest.mark.parametrize("names", ["here", "there"])
def test_a_task_that_must_be_apart_leaves_the_pinned_host(names: str) -> None:
    """It would be in the way for as long as it runs; whoever of the two states the rule."""
    zed = a_task("zed", cpu=1.0, apart=("ant",) if names == "here" else ())
    ant = a_task("ant", cpu=1.0, apart=("zed",) if names == "there" else ())
    for running in ({"ant": "edge3", "zed": "edge2"}, {"ant": "edge3"}, {}):
        found = decide_all(zed, ant, running=running, zed="edge3")
        assert found["zed"] == ("edge3", None)
        assert found["ant"][0] in ("edge1", "edge2")


def test_why_a_task_leaves_the_pinned_host_and_with_whom() -> None:
    zed, ant = a_task("zed", cpu=1.0, apart=("ant",)), a_task("ant", cpu=1.0)
    mate = a_task("mate", cpu=0.5, together=("ant",))
    given, snapshot = some_tasks(zed, ant, mate), look({"ant": "edge3", "mate": "edge3", "zed": "edge1"})
    manager = ManagerState(managed=True, pins={"zed": Pin(host="edge3", since=NOW - 60.0)})
    # Neither its dwell nor max_moves keeps it there: they are about moves for a gain.
    policy = Policy(min_dwell=1e9, max_moves=0, attended=False)
    assignment = run_assign(FLEET, given, snapshot, memory=manager, policy=policy)
    steps = {step.task: step for step in diff_assignment(assignment, given, snapshot, manager)}
    assert hosts_by_task(assignment)["zed"] == "edge3"
    assert hosts_by_task(assignment)["ant"] == hosts_by_task(assignment)["mate"] != "edge3"
    assert describe_reason(steps["ant"]) == "move: made room for zed"


def test_a_task_that_can_go_nowhere_else_stays_and_the_pinned_one_names_it() -> None:
    zed, ant = a_task("zed", cpu=1.0, apart=("ant",)), a_task("ant", cpu=1.0, only=["edge3"])
    given, snapshot = some_tasks(zed, ant), look({"ant": "edge3"})
    manager = ManagerState(managed=True, pins={"zed": Pin(host="edge3", since=NOW - 60.0)})
    assignment = run_assign(FLEET, given, snapshot, memory=manager, policy=Policy(min_dwell=0.0))
    steps = {step.task: step for step in diff_assignment(assignment, given, snapshot, manager)}
    assert hosts_by_task(assignment) == {"ant": "edge3", "zed": None}
    assert "1 with a task that it is apart from" in describe_reason(steps["zed"])


def test_a_pin_to_a_host_that_never_keeps_the_hard_deadline_is_set_aside() -> None:
    slow = {"1c-16Gi": ServiceTime(p50=0.5, p95=0.6), "": ServiceTime(p50=0.01, p95=0.02)}
    for hard, aside, host in ((True, RejectionRule.DEADLINE_MISSED, "edge3"), (False, None, "edge2")):
        task = a_task("slam", cpu=0.5, deadline=0.1, hard_deadline=hard, service_time=slow)
        found, words = decide(look(edge2=a_sample(cores=1.0, memory=16 * GI)), task)
        assert found.pin is not None
        assert (found.pin.set_aside, found.host) == (aside, host), words
    assert "; its pin does not count: edge2 is too slow for its hard deadline" in words or not hard


@pytest.mark.parametrize("optimal", [False, True])
def test_a_single_full_host_neither_loses_nor_doubles_what_is_pinned_there(optimal: bool) -> None:
    """One edge, as full as it can be: what runs stays, what is new waits, and both say what is short."""
    alone = an_inventory(an_edge("edge1"))
    tasks = some_tasks(a_task("zed", cpu=2.0), a_task("ant", cpu=2.0), a_task("new", cpu=1.0))
    runs = {name: replace(a_run(spec_hash=f"hash-{name}"), used=Usage(cpu=2.0)) for name in ("zed", "ant")}
    snapshot = a_snapshot(edge1=a_sample(used=4.0, tasks=runs))
    for pins in ({}, {"zed": "edge1"}, {"new": "edge1"}, {"zed": "edge1", "ant": "edge1", "new": "edge1"}):
        manager = ManagerState(
            managed=True, pins={name: Pin(host=host, since=NOW - 9.0) for name, host in pins.items()}
        )
        policy = Policy(min_dwell=0.0, optimal=optimal)
        solve = make_solver() if optimal else None
        found = assign(alone, tasks, snapshot, manager, policy, NOW, solve)
        assert hosts_by_task(found) == {"zed": "edge1", "ant": "edge1", "new": None}
        steps = {step.task: step for step in diff_assignment(found, tasks, snapshot, manager)}
        assert {name: steps[name].action for name in runs} == dict.fromkeys(runs, Action.KEEP)
        assert "0/1 hosts fit: 1 short of cpu" in describe_reason(steps["new"])
    drained = replace(manager, cordons=frozenset({"edge1"}), draining=frozenset({"edge1"}))
    found = assign(alone, tasks, snapshot, drained, policy, NOW, make_solver() if optimal else None)
    assert hosts_by_task(found)["new"] is None
    assert {decision.pin.set_aside for decision in found.decisions if decision.pin} == {
        RejectionRule.CORDONED
    }
