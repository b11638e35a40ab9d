# SPDX-License-Identifier: Apache-2.0
"""Places of inactive copies, with the arithmetic: the runner-up hosts, room, patience, and the failover."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Assignment, Reason
from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Step
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, TaskSample, TaskState
from edgectl.model.standby import StateRule
from edgectl.model.standby_plan import StandbyAction, StandbyReason, StandbyStep
from edgectl.model.task import Need, NeedCondition, OnboardRule, Task
from edgectl.scheduler.assign import assign
from edgectl.solver.highs import make_solver
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
from tests.scheduler.fleets import NO_MEMORY, hosts_by_task, run_assign

MI = 2.0**20
PAGE = Path(__file__).parents[2] / "docs/concepts/handoff.md"
CPU_ONLY = Policy(weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0))
SLAM = a_task("slam", cpu=1.0, memory=GI, standby=a_standby_rule(memory=400 * MI))


def a_copy(task: str = "slam", **fields: Any) -> TaskSample:
    """A copy that is ready and has waited for an hour."""
    return replace(a_run(instance="copy-1", spec_hash=f"hash-{task}", used=Usage(memory=300 * MI)), **fields)


def a_task_run(task: str = "slam", **fields: Any) -> TaskSample:
    return replace(a_run(spec_hash=f"hash-{task}", used=Usage(cpu=1.0, memory=GI)), **fields)


def decide(
    *tasks: Task,
    samples: Mapping[str, HostSample],
    hosts: Mapping[str, Host] | None = None,
    memory: ManagerState = NO_MEMORY,
    policy: Policy = CPU_ONLY,
) -> Assignment:
    inventory = an_inventory(*({name: an_edge(name) for name in samples} | dict(hosts or {})).values())
    return run_assign(inventory, some_tasks(*tasks), a_snapshot(samples), memory=memory, policy=policy)


def tell(assignment: Assignment, task: str = "slam") -> list[tuple[str | None, str, str]]:
    """Return host, action and reason of each copy."""
    return [(step.host, step.action.value, step.reason.value) for step in assignment.standbys.get(task, ())]


def test_the_runner_up_keeps_the_copy_and_its_memory_is_reserved() -> None:
    """Totals by CPU alone: edge1 (4-0-1)/4 = .75, edge2 (4-1-1)/4 = .5, edge3 (4-2-1)/4 = .25."""
    found = decide(
        SLAM, samples={"edge1": a_sample(), "edge2": a_sample(used=1.0), "edge3": a_sample(used=2.0)}
    )
    assert hosts_by_task(found) == {"slam": "edge1"}
    (step,) = found.standbys["slam"]
    assert step == StandbyStep(
        host="edge2",
        action=StandbyAction.START,
        reason=StandbyReason.RUNNER_UP,
        total=0.5,
        demand=Usage(memory=400 * MI),
    )
    assert found.expected["edge1"].used["memory"] == GI
    assert found.expected["edge2"].used["memory"] == 400 * MI
    assert found.expected["edge2"].used["cpu"] == 1.0


def test_the_example_of_the_page() -> None:
    """docs/concepts/handoff.md: the placement, and the failover to a host that is not the best one."""
    policy = Policy(weights=Weights(cpu=1.0, memory=1.0, network=0.0, task=0.0))
    samples = {
        "edge1": a_sample(used=0.2, used_memory=0.5 * GI),
        "edge2": a_sample(used=1.0, used_memory=GI),
        "edge3": a_sample(used=0.5, used_memory=3.2 * GI),
    }
    found = decide(SLAM, samples=samples, policy=policy)
    (decision,) = found.decisions
    totals = {entry.host: entry.total for entry in decision.ranking}
    assert totals == pytest.approx({"edge1": 0.6625, "edge2": 0.5, "edge3": 0.2875})
    assert tell(found) == [("edge2", "start", "runner-up")]
    assert found.expected["edge2"].used["memory"] / GI == pytest.approx(1.390625)
    page = PAGE.read_text()
    assert all(f"| {total:.4f} |" in page for total in totals.values() if total is not None)
    full = {**samples, "edge2": a_sample(used=1.0, used_memory=(4 - 0.46) * GI)}
    assert tell(decide(SLAM, samples=full, policy=policy)) == [("edge3", "start", "runner-up")]
    later = {
        "edge1": silent(),
        "edge2": a_sample(
            used=1.0, used_memory=1.25 * GI, standbys={"slam": a_copy(used=Usage(memory=0.25 * GI))}
        ),
        "edge3": a_sample(used=0.5, used_memory=GI),
    }
    gone = decide(SLAM, samples=later, policy=policy)
    assert gone.decisions[0].host == "edge2"
    assert gone.decisions[0].lead == pytest.approx(-0.0625)
    assert tell(gone) == [("edge2", "activate", "task-here"), ("edge3", "start", "runner-up")]


def test_several_copies_are_on_as_many_hosts() -> None:
    slam = replace(SLAM, standby=a_standby_rule(hosts=2, memory=400 * MI))
    samples = {"edge1": a_sample(), "edge2": a_sample(used=1.0), "edge3": a_sample(used=2.0)}
    assert [host for host, _, _ in tell(decide(slam, samples=samples))] == ["edge2", "edge3"]
    found = decide(replace(SLAM, standby=a_standby_rule(hosts=3)), samples=samples)
    assert tell(found)[2] == (None, "none", "no-host")


def test_room_is_asked_for_the_copy_and_not_for_the_task() -> None:
    """edge2 has 4 - 3.3 = .7 GiB free: none for the task (1 GiB), enough for a copy of 400 MiB."""
    samples = {"edge1": a_sample(), "edge2": a_sample(used_memory=3.3 * GI)}
    assert tell(decide(SLAM, samples=samples)) == [("edge2", "start", "runner-up")]


def test_a_host_with_room_for_the_task_comes_first() -> None:
    """By CPU edge2 (.75) is better than edge3 (.25), but only edge3 could take the task in a failover."""
    samples = {
        "edge1": a_sample(),
        "edge2": a_sample(used_memory=3.3 * GI),
        "edge3": a_sample(used=2.0),
    }
    assert tell(decide(SLAM, samples=samples)) == [("edge3", "start", "runner-up")]


def test_a_copy_that_fits_nowhere_is_told() -> None:
    """A copy that starts leaves the slack of memory free: 2 % of 4 GiB besides its 400 MiB."""
    free = 400 * MI + 0.02 * 4 * GI
    for spare, expected in ((-MI, (None, "none", "no-room")), (MI, ("edge2", "start", "runner-up"))):
        samples = {"edge1": a_sample(), "edge2": a_sample(used_memory=4 * GI - free - spare)}
        assert tell(decide(SLAM, samples=samples)) == [expected]
    (step,) = decide(SLAM, samples={"edge1": a_sample(), "edge2": a_sample(used_memory=3.9 * GI)}).standbys[
        "slam"
    ]
    assert step.subject == "edge2"


def test_a_present_copy_stays_until_the_memory_is_really_short() -> None:
    for used, expected in ((3.6 * GI, "keep"), (3.8 * GI, "stop")):
        samples = {
            "edge1": a_sample(used=1.0, used_memory=GI, tasks={"slam": a_task_run()}),
            "edge2": a_sample(used_memory=used + 300 * MI, standbys={"slam": a_copy()}),
        }
        found = decide(SLAM, samples=samples)
        assert found.standbys["slam"][0].action.value == expected
    assert tell(found) == [("edge2", "stop", "no-room"), (None, "none", "no-room")]


def test_a_full_processor_does_not_matter_to_a_copy_that_needs_none() -> None:
    samples = {"edge1": a_sample(), "edge2": a_sample(used=4.5)}
    assert tell(decide(SLAM, samples=samples)) == [("edge2", "start", "runner-up")]
    needs_cpu = replace(SLAM, standby=a_standby_rule(cpu=0.1))
    assert tell(decide(needs_cpu, samples=samples)) == [(None, "none", "no-room")]


def test_a_copy_counts_for_what_it_uses_if_that_is_more() -> None:
    copy = a_copy(used=Usage(cpu=0.2, memory=600 * MI))
    samples = {
        "edge1": a_sample(used=1.0, used_memory=GI, tasks={"slam": a_task_run()}),
        "edge2": a_sample(used=0.7, used_memory=1000 * MI, standbys={"slam": copy}),
    }
    found = decide(SLAM, samples=samples)
    assert found.standbys["slam"][0].demand == Usage(cpu=0.2, memory=600 * MI)
    assert found.expected["edge2"].used["memory"] == 1000 * MI
    # The terms of the task itself are those of a fleet without copies: (4 - .5 - 1) / 4.
    ranking = {entry.host: entry.terms["cpu"] for entry in found.decisions[0].ranking}
    assert ranking == {"edge1": 0.75, "edge2": pytest.approx(0.625)}
    young = decide(
        SLAM,
        samples={
            **samples,
            "edge2": replace(samples["edge2"], standbys={"slam": replace(copy, started_at=NOW - 5)}),
        },
    )
    assert young.standbys["slam"][0].demand == Usage(memory=600 * MI)


def test_memory_that_is_not_stated_is_that_of_the_task() -> None:
    samples = {"edge1": a_sample(), "edge2": a_sample()}
    (step,) = decide(replace(SLAM, standby=a_standby_rule()), samples=samples).standbys["slam"]
    assert step.demand == Usage(memory=GI)
    (step,) = decide(replace(SLAM, standby=a_standby_rule(memory=0.0)), samples=samples).standbys["slam"]
    assert step.demand == Usage()


def test_a_copy_follows_the_ranking_beyond_the_margin_and_after_its_dwell() -> None:
    """edge3 leads by (4-u-1)/4 - .25; the margin is .1, and the dwell 2 min."""

    def place(used: float, age: float, policy: Policy = CPU_ONLY) -> list[tuple[str | None, str, str]]:
        samples = {
            "edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}),
            "edge2": a_sample(used=2.0, standbys={"slam": a_copy(started_at=NOW - age)}),
            "edge3": a_sample(used=used),
        }
        return tell(decide(SLAM, samples=samples, policy=policy))

    assert place(2.0, 3600.0) == [("edge2", "keep", "still-best")]
    assert place(1.7, 3600.0) == [("edge2", "keep", "below-move-margin")]
    assert place(1.0, 60.0) == [("edge2", "keep", "dwell")]
    assert place(1.0, 3600.0) == [("edge2", "stop", "outranked"), ("edge3", "start", "runner-up")]
    # Copies are no moves: what limits these leaves them alone.
    unattended = replace(CPU_ONLY, attended=False, max_moves=0)
    assert place(1.0, 3600.0, unattended)[1] == ("edge3", "start", "runner-up")


def test_an_old_copy_is_told_why_it_stays() -> None:
    samples = {
        "edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}),
        "edge2": a_sample(used=2.0, standbys={"slam": a_copy(started_at=NOW - 60.0)}),
        "edge3": a_sample(used=1.0),
    }
    (step,) = decide(SLAM, samples=samples).standbys["slam"]
    assert (step.subject, step.amount) == ("edge3", 60.0)
    samples["edge3"] = a_sample(used=1.8)
    (step,) = decide(SLAM, samples=samples).standbys["slam"]
    assert step.subject == "edge3"
    assert step.amount == pytest.approx(0.05)


def test_a_copy_never_takes_the_room_of_a_task() -> None:
    """edge2 has 1 GiB but for the copy; the task that starts takes it, and the copy ends."""
    nav = a_task("nav", cpu=1.0, memory=GI, only=["edge2"])
    samples = {
        "edge1": a_sample(used=1.0, used_memory=GI, tasks={"slam": a_task_run()}),
        "edge2": a_sample(used_memory=3 * GI + 300 * MI, standbys={"slam": a_copy()}),
        "edge3": a_sample(used=3.5),
    }
    found = decide(SLAM, nav, samples=samples)
    assert hosts_by_task(found)["nav"] == "edge2"
    assert tell(found) == [("edge2", "stop", "no-room"), ("edge3", "start", "runner-up")]


def test_of_two_that_compete_the_one_that_stands_keeps_its_room() -> None:
    early = a_task("early", cpu=0.5, priority=5.0, pin=None, standby=a_standby_rule(memory=500 * MI))
    samples = {
        "edge1": a_sample(used=1.5, tasks={"slam": a_task_run(), "early": a_task_run("early")}),
        "edge2": a_sample(used_memory=4 * GI - 600 * MI, standbys={"slam": a_copy()}),
    }
    found = decide(SLAM, early, samples=samples)
    assert tell(found) == [("edge2", "keep", "still-best")]
    assert tell(found, "early") == [(None, "none", "no-room")]


def test_rules_of_the_task_hold_for_its_copy() -> None:
    samples = {"edge1": a_sample(), "edge2": a_sample(), "edge3": a_sample(used=2.0)}
    assert tell(decide(replace(SLAM, hosts=replace(SLAM.hosts, never=("edge2",))), samples=samples)) == [
        ("edge3", "start", "runner-up")
    ]
    apart = a_task("map", cpu=0.1, only=["edge2"], apart=["slam"])
    assert tell(decide(SLAM, apart, samples=samples)) == [("edge3", "start", "runner-up")]


def test_a_host_without_a_link_to_the_robot_keeps_no_copy() -> None:
    slam = replace(SLAM, robots=("robot1",))
    links = {"robot1": a_link()}
    samples = {
        "edge1": a_sample(links=links),
        "edge2": a_sample(),
        "edge3": a_sample(used=2.0, links=links),
        "robot1": a_sample(),
    }
    hosts = {"robot1": a_robot("robot1")}
    assert tell(decide(slam, samples=samples, hosts=hosts)) == [("edge3", "start", "runner-up")]


@pytest.mark.parametrize(("onboard", "expected"), [(True, "robot1"), (False, None)])
def test_a_robot_keeps_a_copy_only_where_it_may_run_the_task(onboard: bool, expected: str | None) -> None:
    slam = replace(SLAM, robots=("robot1",))
    samples = {"edge1": a_sample(links={"robot1": a_link()}), "robot1": a_sample(used=2.0)}
    hosts = {"robot1": a_robot("robot1", onboard=onboard)}
    assert tell(decide(slam, samples=samples, hosts=hosts))[0][0] == expected
    never = replace(slam, onboard=OnboardRule.NEVER)
    assert tell(decide(never, samples=samples, hosts=hosts)) == [(None, "none", "no-host")]


def test_a_cordon_closes_a_host_to_new_copies_and_a_drain_sends_them_away() -> None:
    there = {
        "edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}),
        "edge2": a_sample(standbys={"slam": a_copy()}),
        "edge3": a_sample(used=2.9),
    }
    cordoned = replace(NO_MEMORY, cordons=frozenset({"edge2"}))
    draining = replace(NO_MEMORY, draining=frozenset({"edge2"}))
    assert tell(decide(SLAM, samples=there, memory=cordoned)) == [("edge2", "keep", "still-best")]
    assert tell(decide(SLAM, samples=there, memory=draining)) == [
        ("edge2", "stop", "host-excluded"),
        ("edge3", "start", "runner-up"),
    ]
    without = replace(CPU_ONLY, without=frozenset({"edge2"}))
    assert tell(decide(SLAM, samples=there, policy=without))[0] == ("edge2", "stop", "host-excluded")
    empty = {**there, "edge2": a_sample()}
    assert tell(decide(SLAM, samples=empty, memory=cordoned)) == [("edge3", "start", "runner-up")]


def test_the_host_that_a_move_leaves_keeps_the_old_instance() -> None:
    """edge2 leads by .75 - .25: the task moves there, and edge1 is the best host besides."""
    samples = {
        "edge1": a_sample(used=3.0, tasks={"slam": a_task_run(instance="old")}),
        "edge2": a_sample(standbys={"slam": a_copy()}),
    }
    found = decide(SLAM, samples=samples)
    assert hosts_by_task(found) == {"slam": "edge2"}
    assert tell(found) == [("edge2", "activate", "task-here"), ("edge1", "deactivate", "runner-up")]
    assert [step.instance for step in found.standbys["slam"]] == ["copy-1", "old"]
    changed = replace(SLAM, spec_hash="other")
    assert tell(decide(changed, samples=samples)) == [
        ("edge2", "stop", "task-here"),
        ("edge1", "start", "runner-up"),
    ]


def test_a_drained_host_keeps_nothing_of_what_leaves_it() -> None:
    samples = {
        "edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}),
        "edge2": a_sample(standbys={"slam": a_copy()}),
        "edge3": a_sample(used=2.0),
    }
    found = decide(SLAM, samples=samples, memory=replace(NO_MEMORY, draining=frozenset({"edge1"})))
    assert hosts_by_task(found) == {"slam": "edge2"}
    assert tell(found) == [("edge2", "activate", "task-here"), ("edge3", "start", "runner-up")]


def test_a_task_that_is_gone_is_activated_where_its_copy_waits() -> None:
    """edge3 (.75) is better than edge2 (.5), where the copy is: the gap counts more."""
    samples = {
        "edge1": silent(),
        "edge2": a_sample(used=1.0, standbys={"slam": a_copy()}),
        "edge3": a_sample(),
    }
    found = decide(SLAM, samples=samples)
    (decision,) = found.decisions
    assert (decision.host, decision.reason, decision.lead) == ("edge2", Reason.STANDBY_ACTIVATED, -0.25)
    assert tell(found) == [("edge2", "activate", "task-here"), ("edge3", "start", "runner-up")]
    assert found.settled


@pytest.mark.parametrize(
    ("sample", "host"),
    [
        (a_sample(used=3.5, standbys={"slam": a_copy()}), "edge3"),
        (a_sample(used=1.0, standbys={"slam": a_copy(spec_hash="older")}), "edge3"),
        (a_sample(used=1.0, standbys={"slam": a_copy(orphaned=True)}), "edge3"),
        (a_sample(used=1.0, standbys={"slam": a_copy(state=TaskState.FAILED)}), "edge3"),
        (a_sample(used=1.0, standbys={"slam": a_copy(state=TaskState.STARTING)}), "edge2"),
    ],
    ids=["no-room", "older-spec", "orphaned", "failed", "starting"],
)  # fmt: skip
def test_a_copy_is_activated_only_if_it_can_be_the_task(sample: HostSample, host: str) -> None:
    found = decide(SLAM, samples={"edge2": sample, "edge3": a_sample()})
    assert hosts_by_task(found) == {"slam": host}


def test_a_copy_that_is_ready_goes_before_a_better_one_that_is_not() -> None:
    samples = {
        "edge2": a_sample(used=1.0, standbys={"slam": a_copy()}),
        "edge3": a_sample(standbys={"slam": a_copy(state=TaskState.STARTING)}),
    }
    slam = replace(SLAM, standby=a_standby_rule(hosts=2))
    assert hosts_by_task(decide(slam, samples=samples)) == {"slam": "edge2"}


@pytest.mark.parametrize(("state", "host"), [(StateRule(topic="/map"), "edge2"), (None, "edge3")])
def test_the_copy_that_was_active_last_goes_before_a_better_one(state: StateRule | None, host: str) -> None:
    """Where a move was interrupted it has the state; of a task without one it is as good as any other."""
    samples = {
        "edge1": a_sample(used=0.5, standbys={"slam": a_copy(deactivated=6)}),
        "edge2": a_sample(used=1.0, standbys={"slam": a_copy(deactivated=7)}),
        "edge3": a_sample(standbys={"slam": a_copy()}),
    }
    slam = replace(SLAM, standby=a_standby_rule(hosts=3), state=state)
    assert hosts_by_task(decide(slam, samples=samples)) == {"slam": host}


def test_a_held_task_keeps_its_copies_and_gets_no_other() -> None:
    placements = {"slam": Placement(host="edge1", since=NOW - 3600.0)}
    samples = {"edge1": silent(), "edge2": a_sample(standbys={"slam": a_copy()}), "edge3": a_sample()}
    memory = replace(NO_MEMORY, placements=placements)
    found = decide(replace(SLAM, standby=a_standby_rule(hosts=2, memory=GI)), samples=samples, memory=memory)
    assert tell(found) == [("edge2", "keep", "task-held")]
    assert found.expected["edge2"].used["memory"] == GI


def test_a_task_without_a_place_keeps_no_copy() -> None:
    samples = {"edge2": a_sample(standbys={"slam": a_copy()})}
    late = replace(SLAM, needs=(Need(task="map", until=NeedCondition.READY),))
    found = decide(late, a_task("map", only=["edge9"]), samples=samples)
    assert tell(found) == [("edge2", "stop", "task-not-placed")]
    done = decide(SLAM, samples=samples, memory=replace(NO_MEMORY, done={"slam": "hash-slam"}))
    assert tell(done) == [("edge2", "stop", "task-not-placed")]


@pytest.mark.parametrize(
    ("task", "policy"),
    [
        (replace(SLAM, standby=None), CPU_ONLY),
        *((SLAM, replace(CPU_ONLY, name=name)) for name in (PolicyName.STATIC, PolicyName.PAPER)),
    ],
)  # fmt: skip
def test_a_copy_that_nobody_asks_for_ends(task: Task, policy: Policy) -> None:
    samples = {
        "edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}),
        "edge2": a_sample(used=2.0, standbys={"slam": a_copy()}),
    }
    assert tell(decide(task, samples=samples, policy=policy)) == [("edge2", "stop", "not-wanted")]


@pytest.mark.parametrize(
    ("fields", "reason"), [({"spec_hash": "older"}, "spec-changed"), ({"orphaned": True}, "orphaned")]
)
def test_a_copy_that_cannot_become_the_task_is_started_again(fields: dict[str, Any], reason: str) -> None:
    samples = {
        "edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}),
        "edge2": a_sample(standbys={"slam": a_copy(**fields)}),
    }
    assert tell(decide(SLAM, samples=samples)) == [("edge2", "restart", reason)]


def test_a_copy_that_has_failed_is_tried_on_another_host() -> None:
    failed = a_copy(state=TaskState.CRASHLOOP, given_up=True)
    samples = {
        "edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}),
        "edge2": a_sample(standbys={"slam": failed}),
        "edge3": a_sample(used=2.0),
    }
    found = decide(SLAM, samples=samples)
    assert tell(found) == [("edge3", "start", "runner-up"), ("edge2", "none", "failed-there")]
    other = {**samples, "edge2": a_sample(standbys={"slam": replace(failed, spec_hash="older")})}
    assert tell(decide(SLAM, samples=other)) == [("edge2", "start", "runner-up")]


def test_nothing_is_done_with_copies_while_most_edges_are_silent() -> None:
    samples = {
        "edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}, standbys={}),
        "edge2": silent(),
        "edge3": silent(),
    }
    found = decide(SLAM, samples=samples)
    assert found.frozen
    assert tell(found) == [(None, "none", "moves-frozen")]


def list_steps(assignment: Assignment, *tasks: Task, samples: Mapping[str, HostSample]) -> tuple[Step, ...]:
    return diff_assignment(assignment, some_tasks(*tasks), a_snapshot(samples), NO_MEMORY)


def test_copies_of_a_task_that_left_the_file_end() -> None:
    samples = {
        "edge1": a_sample(tasks={"gone": a_task_run("gone")}),
        "edge2": a_sample(standbys={"gone": a_copy("gone"), "alone": a_copy("alone", instance="i")}),
        "edge3": a_sample(standbys={"other": a_copy("other", file="other.yaml")}),
    }
    found = decide(SLAM, samples=samples)
    steps = {step.task: step for step in list_steps(found, SLAM, samples=samples)}
    assert (steps["gone"].action, steps["alone"].action) == (Action.STOP, Action.NONE)
    assert all(steps[name].changes for name in ("gone", "alone"))
    (copy,) = steps["alone"].standbys
    assert (copy.host, copy.action, copy.instance) == ("edge2", StandbyAction.STOP, "i")
    assert "other" not in steps


def test_a_step_that_only_starts_a_copy_changes_something() -> None:
    samples = {"edge1": a_sample(used=1.0, tasks={"slam": a_task_run()}), "edge2": a_sample()}
    (step,) = list_steps(decide(SLAM, samples=samples), SLAM, samples=samples)
    assert step.action is Action.KEEP
    assert step.changes
    samples["edge2"] = a_sample(standbys={"slam": a_copy()})
    (step,) = list_steps(decide(SLAM, samples=samples), SLAM, samples=samples)
    assert not step.changes


@pytest.mark.parametrize("better", [{"rebalance": True}, {"optimal": True}], ids=["rebalance", "optimal"])
def test_better_plans_of_tasks_leave_copies_to_the_end(better: dict[str, Any]) -> None:
    """The task is activated where its copy waits, whatever the sum of utilities; and copies are placed."""
    nav = a_task("nav", cpu=2.0, standby=a_standby_rule(memory=GI))
    samples = {
        "edge1": a_sample(used=1.0, standbys={"slam": a_copy()}),
        "edge2": a_sample(used=2.0, tasks={"nav": a_task_run("nav", used=Usage(cpu=2.0))}),
        "edge3": a_sample(),
    }
    policy = replace(CPU_ONLY, **better)
    inventory = an_inventory(*map(an_edge, samples))
    solve = make_solver() if policy.optimal else None
    found = assign(inventory, some_tasks(SLAM, nav), a_snapshot(samples), NO_MEMORY, policy, NOW, solve)
    assert hosts_by_task(found)["slam"] == "edge1"
    assert tell(found)[0] == ("edge1", "activate", "task-here")
    assert [action for _, action, _ in tell(found, "nav")] == ["start"]
    plain = decide(SLAM, nav, samples=samples)
    assert found.standbys == plain.standbys
