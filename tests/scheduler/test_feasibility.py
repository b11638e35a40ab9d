# SPDX-License-Identifier: Apache-2.0
"""Feasibility: candidate hosts, capacity checks, and the reasons given where a task does not fit."""

from dataclasses import replace

import pytest

from edgectl.model.assignment import Reason, Rejection, RejectionRule, Verdict
from edgectl.model.image import ContainerEngine, ContainerImage
from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.resource import CPU, MEMORY, NETWORK, Usage
from edgectl.model.snapshot import CapacitySource, HostSample
from edgectl.model.task import Need, NeedCondition, NothingFits, OnboardRule, Task
from tests.builders import (
    GI,
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
from tests.scheduler.fleets import NO_MEMORY, decisions_by_task, ranking_by_host, run_assign

LINKS = {"robot1": a_link()}
IMAGE = ContainerImage(name="ros:jazzy")


@pytest.mark.parametrize(
    ("host", "sample", "memory", "task", "rule"),
    [
        (an_edge(), silent(), NO_MEMORY, a_task(), RejectionRule.UNREACHABLE),
        (an_edge(), a_sample(age=61.0), NO_MEMORY, a_task(), RejectionRule.STALE),
        (an_edge(), a_sample(), ManagerState(cordons=frozenset({"edge1"})), a_task(), RejectionRule.CORDONED),
        (
            an_edge(),
            a_sample(),
            ManagerState(draining=frozenset({"edge1"})),
            a_task(),
            RejectionRule.CORDONED,
        ),
        (an_edge(), a_sample(), NO_MEMORY, a_task(only=["edge2"]), RejectionRule.NOT_ONLY),
        (an_edge(), a_sample(), NO_MEMORY, a_task(never=["edge1"]), RejectionRule.NEVER),
        (an_edge(), a_sample(), NO_MEMORY, a_task(pin="edge2"), RejectionRule.PIN),
        (
            an_edge(labels={"gpu": "ampere"}),
            a_sample(),
            NO_MEMORY,
            a_task(labels={"gpu": "maxwell"}),
            RejectionRule.LABELS,
        ),
        (an_edge(), a_sample(), NO_MEMORY, a_task(labels={"gpu": "maxwell"}), RejectionRule.LABELS),
        (an_edge(), a_sample(), NO_MEMORY, a_task(onboard=OnboardRule.ONLY), RejectionRule.ONBOARD),
        (an_edge(), replace(a_sample(), engines=()), NO_MEMORY, a_task(image=IMAGE), RejectionRule.NO_ENGINE),
        (
            an_edge(),
            replace(a_sample(), engines=("docker",)),
            NO_MEMORY,
            a_task(image=replace(IMAGE, engine=ContainerEngine.PODMAN)),
            RejectionRule.NO_ENGINE,
        ),
        (
            an_edge(),
            replace(a_sample(), engines=("docker",)),
            NO_MEMORY,
            a_task(image=replace(IMAGE, engine=ContainerEngine.SWARM)),
            RejectionRule.NO_ENGINE,
        ),
    ],
)
def test_no_candidate(
    host: Host, sample: HostSample, memory: ManagerState, task: Task, rule: RejectionRule
) -> None:
    decision = run_assign(
        an_inventory(host), some_tasks(task), a_snapshot(edge1=sample), memory=memory
    ).decisions[0]
    assert (decision.verdict, decision.reason, decision.host) == (Verdict.UNPLACED, Reason.NO_CANDIDATE, None)
    assert decision.ranking[0].rejections == (Rejection(rule=rule),)
    assert (decision.ranking[0].rank, decision.ranking[0].total) == (0, None)


def test_a_fresh_enough_sample_and_matching_rules_pass() -> None:
    task = a_task(only=["edge1"], labels={"gpu": "maxwell"}, pin="edge1")
    inventory = an_inventory(an_edge(labels={"gpu": "maxwell", "rack": "2"}))
    decision = run_assign(inventory, some_tasks(task), a_snapshot(edge1=a_sample(age=60.0))).decisions[0]
    assert (decision.host, decision.reason) == ("edge1", Reason.PINNED)


def test_a_container_stays_where_the_engine_is_away_for_a_moment() -> None:
    """The containers of an engine that is restarted live on; new ones go elsewhere."""
    inventory, task = an_inventory(an_edge("edge2"), an_edge("edge1")), a_task("slam", image=IMAGE)
    runs = a_run(spec_hash=task.spec_hash)
    for tasks, host in (({"slam": runs}, "edge2"), ({}, "edge1")):
        away = replace(a_sample(used=0.0, tasks=tasks), engines=())
        there = replace(a_sample(used=3.0), engines=("docker",))
        decision = run_assign(inventory, some_tasks(task), a_snapshot(edge1=there, edge2=away)).decisions[0]
        assert decision.host == host


def test_an_engine_that_nobody_asked_for_is_not_missing() -> None:
    decision = run_assign(
        an_inventory(an_edge()), some_tasks(a_task(image=IMAGE)), a_snapshot(edge1=a_sample())
    ).decisions[0]
    assert decision.host == "edge1"


def test_without_is_what_if() -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"))
    policy = Policy(without=frozenset({"edge1"}))
    decision = run_assign(
        inventory, some_tasks(a_task()), a_snapshot(edge1=a_sample(), edge2=a_sample(used=1.0)), policy=policy
    ).decisions[0]
    assert (decision.host, decision.reason) == ("edge2", Reason.ONLY_FEASIBLE)
    assert ranking_by_host(decision)["edge1"].rejections == (Rejection(rule=RejectionRule.WITHOUT),)


@pytest.mark.parametrize(
    ("onboard", "allowed", "robots", "candidate"),
    [
        (True, OnboardRule.ALLOW, ["robot1"], True),
        (True, OnboardRule.ONLY, ["robot1"], True),
        (True, OnboardRule.NEVER, ["robot1"], False),
        (False, OnboardRule.ALLOW, ["robot1"], False),
        (True, OnboardRule.ALLOW, ["robot1", "robot2"], False),
        (True, OnboardRule.ALLOW, [], False),
    ],
)
def test_when_the_robot_is_a_candidate(
    onboard: bool, allowed: OnboardRule, robots: list[str], candidate: bool
) -> None:
    inventory = an_inventory(an_edge(), a_robot("robot1", onboard=onboard), a_robot("robot2"))
    links = {"robot1": a_link(), "robot2": a_link()}
    snapshot = a_snapshot(edge1=a_sample(used=3.0, links=links), robot1=a_sample(), robot2=a_sample())
    decision = run_assign(inventory, some_tasks(a_task(robots=robots, onboard=allowed)), snapshot).decisions[
        0
    ]
    assert decision.host == ("robot1" if candidate else "edge1")
    assert ("robot1" in ranking_by_host(decision)) == (onboard and robots == ["robot1"])


def test_an_onboard_robot_that_is_never_probed_is_no_host() -> None:
    inventory = an_inventory(an_edge(), a_robot(onboard=True, probe=False))
    decision = run_assign(
        inventory, some_tasks(a_task(robots=["robot1"])), a_snapshot(edge1=a_sample(links=LINKS))
    ).decisions[0]
    assert decision.host == "edge1"
    assert ranking_by_host(decision)["robot1"].rejections == (Rejection(rule=RejectionRule.UNREACHABLE),)


def test_a_rejection_says_what_is_lacking() -> None:
    inventory = an_inventory(an_edge(cpu_limit=0.5), a_robot())
    snapshot = a_snapshot(edge1=a_sample(used=1.5, used_memory=3 * GI, links={"robot1": a_link(10e6, 8e6)}))
    decision = run_assign(
        inventory, some_tasks(a_task(cpu=1.0, memory=2 * GI, throughput=3e6, robots=["robot1"])), snapshot
    ).decisions[0]
    rule = RejectionRule.INSUFFICIENT
    assert decision.ranking[0].rejections == (
        Rejection(rule=rule, resource=CPU, demand=1.0, used=1.5, capacity=2.0),
        Rejection(rule=rule, resource=MEMORY, demand=2 * GI, used=3 * GI, capacity=4 * GI),
        Rejection(rule=rule, resource=NETWORK, robot="robot1", demand=3e6, used=8e6, capacity=10e6),
    )
    # cpu (2 - 1.5 - 1) / 2 = -.25; mem (4 - 3 - 2) / 4 = -.25; net (10 - 8 - 3) / 10 = -.1; total (-.25 - .25 - .1 + .5) / 4 = -.025
    assert decision.ranking[0].total == pytest.approx(-0.025)
    assert (decision.verdict, decision.reason, decision.nearest) == (
        Verdict.UNPLACED,
        Reason.NO_FEASIBLE_HOST,
        "edge1",
    )


def test_exactly_full_still_fits() -> None:
    decision = run_assign(
        an_inventory(an_edge()), some_tasks(a_task(cpu=1.0)), a_snapshot(edge1=a_sample(used=3.0 + 1e-10))
    ).decisions[0]
    assert (decision.host, decision.reason) == ("edge1", Reason.ONLY_FEASIBLE)


def test_demand_larger_than_any_host_names_the_nearest_miss() -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"))
    snapshot = a_snapshot(
        edge1=a_sample(), edge2=a_sample(cores=8.0), edge3=a_sample(cores=16.0, used_memory=4 * GI)
    )
    decision = run_assign(inventory, some_tasks(a_task(cpu=10.0, memory=2 * GI)), snapshot).decisions[0]
    # worst terms: edge1 cpu (4-10)/4 = -1.5; edge2 cpu (8-10)/8 = -.25; edge3 mem (4-4-2)/4 = -.5
    assert (decision.verdict, decision.nearest, decision.host) == (Verdict.UNPLACED, "edge2", None)


@pytest.mark.parametrize("of_task", [False, True], ids=["policy", "task"])
def test_best_effort_takes_the_highest_total_all_the_same(of_task: bool) -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"), a_robot())
    snapshot = a_snapshot(
        edge1=a_sample(links=LINKS), edge2=a_sample(cores=8.0, links=LINKS), edge3=a_sample(cores=64.0)
    )
    task = a_task(
        cpu=10.0,
        robots=["robot1"],
        if_nothing_fits=NothingFits.BEST_EFFORT if of_task else NothingFits.WAIT,
    )
    others = [a_task("waits", cpu=20.0, robots=["robot1"])] if of_task else []
    policy = Policy(best_effort=not of_task)
    assignment = run_assign(inventory, some_tasks(task, *others), snapshot, policy=policy)
    decision = assignment.decisions[0]
    assert (decision.verdict, decision.reason, decision.host, decision.overcommitted) == (
        Verdict.PLACED,
        Reason.BEST_EFFORT,
        "edge2",
        True,
    )
    assert assignment.expected["edge2"].used["cpu"] == 10.0
    assert [waits.verdict for waits in assignment.decisions[1:]] == [Verdict.UNPLACED] * of_task


def test_a_running_task_that_fits_nowhere_stays_and_is_charged() -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"))
    snapshot = a_snapshot(
        edge1=a_sample(used=1.0, tasks={"slam": a_run(used=Usage(cpu=1.0))}), edge2=a_sample()
    )
    assignment = run_assign(inventory, some_tasks(a_task(cpu=5.0)), snapshot)
    decision = assignment.decisions[0]
    assert (decision.verdict, decision.reason, decision.host) == (Verdict.KEPT, Reason.NOTHING_FITS, "edge1")
    # cpu (4 - 0 - 5) / 4 = -.25; total (-.25 + 1 + 1 + .5) / 4 = .5625
    assert decision.total == pytest.approx(0.5625)
    assert decision.overcommitted
    assert assignment.expected["edge1"].used["cpu"] == 5.0


@pytest.mark.parametrize(
    ("needs", "others", "missing"),
    [
        (["slam"], [a_task("slam", cpu=9.0)], "slam"),  # unplaced
        (["slam"], [a_task("slam")], None),  # placed in this plan
        ([Need(task="slam", until=NeedCondition.RUNNING)], [a_task("slam")], None),
        (["ghost"], [], "ghost"),
        (["maps", "slam"], [a_task("maps"), a_task("slam", cpu=9.0)], "slam"),
    ],
)
def test_predecessors(needs: list[str | Need], others: list[Task], missing: str | None) -> None:
    tasks = some_tasks(a_task("nav", needs=needs), *others)
    decision = decisions_by_task(run_assign(an_inventory(an_edge()), tasks, a_snapshot(edge1=a_sample())))[
        "nav"
    ]
    if missing is None:
        assert decision.host == "edge1"
    else:
        assert (decision.verdict, decision.reason, decision.subject) == (
            Verdict.UNPLACED,
            Reason.PREDECESSOR_MISSING,
            missing,
        )


def test_a_predecessor_that_must_complete_is_not_called_missing_once_it_is_placed() -> None:
    tasks = some_tasks(
        a_task("nav", needs=[Need(task="slam", until=NeedCondition.COMPLETED)]), a_task("slam")
    )
    decision = decisions_by_task(run_assign(an_inventory(an_edge()), tasks, a_snapshot(edge1=a_sample())))[
        "nav"
    ]
    assert (decision.verdict, decision.reason, decision.subject) == (
        Verdict.UNPLACED,
        Reason.PREDECESSOR_INCOMPLETE,
        "slam",
    )


def test_a_running_task_does_not_lose_its_host_to_a_missing_predecessor() -> None:
    tasks = some_tasks(a_task("nav", needs=["slam"]), a_task("slam", cpu=9.0))
    decision = decisions_by_task(
        run_assign(an_inventory(an_edge()), tasks, a_snapshot(edge1=a_sample(tasks={"nav": a_run()})))
    )["nav"]
    assert (decision.verdict, decision.host) == (Verdict.KEPT, "edge1")


@pytest.mark.parametrize("throughput", [3e6, "30%"], ids=["amount", "share of the nominal capacity"])
@pytest.mark.parametrize("declared", [None, 10e6])
def test_a_link_that_carries_less_now_than_at_best_is_too_slow(
    throughput: float | str, declared: float | None
) -> None:
    """edge1: (2 - 0 - 3) / 2 MB/s < 0. edge2: (10 - 0 - 3) / 10 = .7. A share of 30 % is 3 MB/s at both."""
    live = replace(a_link(2e6), nominal=10e6, capacity_source=CapacitySource.TCP, capacity_age_s=1.0)
    links = {} if declared is None else {(edge, "robot1"): declared for edge in ("edge1", "edge2")}
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot(), links=links)
    snapshot = a_snapshot(
        edge1=a_sample(cores=64.0, links={"robot1": live}), edge2=a_sample(links={"robot1": a_link(10e6)})
    )
    task = a_task(throughput=throughput, robots=["robot1"])
    decision = run_assign(inventory, some_tasks(task), snapshot).decisions[0]
    assert (decision.reason, decision.host) == (Reason.ONLY_FEASIBLE, "edge2")
    terms = {each.host: each.terms["network"] for each in decision.ranking}
    assert terms == {"edge1": pytest.approx(-0.5), "edge2": pytest.approx(0.7)}
