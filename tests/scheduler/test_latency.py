# SPDX-License-Identifier: Apache-2.0
"""The term UT_latency and hard deadlines: the example of the docs, properties, both scans."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.config.weights import parse_weights
from edgectl.executor.diff import plan_from_assignment
from edgectl.formats.kinds import PLAN_KIND
from edgectl.model.assignment import Assignment, RankedHost, Reason, RejectionRule, Verdict
from edgectl.model.demand import Demand
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.model.predicted_latency import JobSize, ServiceTime
from edgectl.model.resource import LATENCY, Usage
from edgectl.model.snapshot import LinkSample, Snapshot
from edgectl.model.task import Task
from edgectl.scheduler.explain import explain_decision
from edgectl.views.explanation import ExplanationView
from edgectl.views.plan import PlanView
from tests.builders import (
    NOW,
    a_quantity,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import NO_MEMORY, decisions_by_task, ranking_by_host, run_assign
from tests.scheduler.test_properties import Case, cases

ONLY_LATENCY = Policy(weights=parse_weights("latency"))
SERVICE = {"": ServiceTime(p50=0.031, p95=0.031)}
FLEET = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"))


def a_detection(**fields: object) -> Task:
    task = a_task(
        "detection", deadline=0.1, service_time=SERVICE, job=JobSize(received=200e3), robots=["robot1"]
    )
    return replace(task, **fields)  # type: ignore[arg-type]


def a_fleet(*, rate: float = 2.5e6, used: float = 0.0) -> Snapshot:
    """edge1 idle behind a link of ``rate``; edge2 with ``used`` of one core behind one of 25 MB/s, a third used."""
    return a_snapshot(
        edge1=a_sample(cores=1.0, links={"robot1": LinkSample(capacity_bytes_per_s=rate, used_bytes_per_s=0.0, rtt_ms=4.0)}),
        edge2=a_sample(
            cores=1.0,
            used=used,
            links={"robot1": LinkSample(capacity_bytes_per_s=25e6, used_bytes_per_s=25e6 / 3, rtt_ms=4.0)},
        ),
    )  # fmt: skip


def rank(task: Task, snapshot: Snapshot, policy: Policy = ONLY_LATENCY) -> dict[str, RankedHost]:
    assignment = run_assign(FLEET, some_tasks(task), snapshot, policy=policy)
    return ranking_by_host(decisions_by_task(assignment)[task.name])


def test_the_example_of_the_page() -> None:
    """docs/concepts/predicted-latency.md: edge1 31 + 80 + 4 ms; edge2 31 + 12 + 4 ms."""
    ranking = rank(a_detection(), a_fleet())
    assert ranking["edge1"].terms[LATENCY] == pytest.approx((100.0 - 115.0) / 100.0)
    assert ranking["edge2"].terms[LATENCY] == pytest.approx((100.0 - 47.0) / 100.0)
    assert ranking["edge2"].total == ranking["edge2"].terms[LATENCY], "its weight is 1"
    assert ranking["edge2"].rank == 1


def test_the_load_of_others_counts_and_its_own_does_not() -> None:
    predicted = rank(a_detection(), a_fleet(used=0.6))["edge2"].predicted_latency
    assert predicted is not None
    assert predicted.host_load == pytest.approx(0.6)
    assert predicted.waiting_ms == pytest.approx(31.0 * 0.6 / 0.4)
    snapshot = a_fleet(used=0.6)
    runs = replace(snapshot.hosts["edge2"], tasks={"detection": a_run(used=Usage(cpu=0.6))})
    moved = replace(snapshot, hosts={**snapshot.hosts, "edge2": runs})
    same = rank(a_detection(), moved)["edge2"].predicted_latency
    assert same is not None
    assert same.host_load == pytest.approx(0.0)


def test_nothing_is_predicted_without_deadline_or_service_time() -> None:
    for task in (a_detection(deadline=None), a_detection(service_time={})):
        ranking = rank(task, a_fleet())
        assert {entry.predicted_latency for entry in ranking.values()} == {None}
        assert {entry.terms[LATENCY] for entry in ranking.values()} == {1.0}


def test_a_hard_deadline_excludes_a_host_whatever_the_weights() -> None:
    hard = rank(a_detection(hard_deadline=True), a_fleet(), Policy())
    assert not hard["edge1"].feasible
    rejection = hard["edge1"].rejections[0]
    assert (rejection.rule, rejection.capacity) == (RejectionRule.DEADLINE_MISSED, 100.0)
    assert rejection.demand == pytest.approx(115.0)
    assert hard["edge2"].feasible
    assert rank(a_detection(), a_fleet(), Policy())["edge1"].feasible


def test_a_task_that_keeps_its_deadline_nowhere_waits_and_says_why() -> None:
    task = a_detection(hard_deadline=True, deadline=0.04)
    decision = run_assign(FLEET, some_tasks(task), a_fleet()).decisions[0]
    assert (decision.verdict, decision.reason) == (Verdict.UNPLACED, Reason.NO_FEASIBLE_HOST)
    assert decision.nearest == "edge2", "it misses by less"
    text = PlanView(make_plan(task, a_fleet(), Policy())).table()
    assert "0/2 hosts fit: 2 misses the deadline" in " ".join(text.split())


def test_a_running_task_that_misses_its_deadline_moves_once_its_dwell_has_passed() -> None:
    task = a_detection(hard_deadline=True)
    snapshot = a_fleet()
    runs = replace(snapshot.hosts["edge1"], tasks={"detection": a_run(spec_hash=task.spec_hash)})
    snapshot = replace(snapshot, hosts={**snapshot.hosts, "edge1": runs})
    for since, reason, host in (
        (NOW - 3600, Reason.FORCED_INFEASIBLE, "edge2"),
        (NOW - 1, Reason.DWELL, "edge1"),
    ):
        memory = ManagerState(managed=True, placements={"detection": Placement(host="edge1", since=since)})
        decision = run_assign(FLEET, some_tasks(task), snapshot, memory=memory).decisions[0]
        assert (decision.reason, decision.host) == (reason, host)


def test_a_class_of_hosts_that_is_not_named_counts_as_the_slowest() -> None:
    by_class = {"fast": ServiceTime(p50=0.01, p95=0.01), "slow": ServiceTime(p50=0.05, p95=0.06)}
    fleet = an_inventory(an_edge("edge1", labels={"class": "fast"}), an_edge("edge2"), a_robot("robot1"))
    assignment = run_assign(fleet, some_tasks(a_detection(service_time=by_class)), a_fleet())
    ranking = ranking_by_host(assignment.decisions[0])
    named, other = ranking["edge1"].predicted_latency, ranking["edge2"].predicted_latency
    assert named is not None
    assert other is not None
    assert [named.service_ms, other.service_ms] == pytest.approx([10.0, 50.0])
    assert [named.elsewhere, other.elsewhere] == [False, True]


def make_plan(task: Task, snapshot: Snapshot, policy: Policy) -> Plan:
    tasks = some_tasks(task)
    assignment = run_assign(FLEET, tasks, snapshot, policy=policy)
    return plan_from_assignment(FLEET, tasks, snapshot, NO_MEMORY, assignment)


def test_explain_says_milliseconds_and_what_each_part_costs() -> None:
    task, snapshot = a_detection(), a_fleet(used=0.6)
    plan = make_plan(task, snapshot, ONLY_LATENCY)
    step = plan.steps[0]
    explained = explain_decision(FLEET, task, snapshot, step.decision, plan.policy)
    view = ExplanationView(step, explained)
    text = " ".join(view.wide().split())
    assert "edge1: 115 ms at p95 of 100 ms (p50 115, p99 115): 31 ms service at 0% load" in text
    assert "31 ms service + 46 ms waiting at 60% load, 12 ms transfer, 4 ms rtt" in text
    assert "Changes of loads are left out" in text
    item: dict[str, Any] = dict(view.item())
    assert item["deadline_s"] == 0.1
    assert item["latencies"]["edge1"]["transfer_ms"] == pytest.approx(80.0)
    assert "LATENCY" in PlanView(plan).wide()


def test_documents_have_the_term_only_where_it_says_something() -> None:
    plain = PLAN_KIND.encode(make_plan(a_task("slam", robots=["robot1"]), a_fleet(), Policy()))
    text = str(plain)
    assert "latency" not in text
    assert "LATENCY" not in PlanView(PLAN_KIND.decode(plain)).wide()
    plan = make_plan(a_detection(), a_fleet(used=0.3), ONLY_LATENCY)
    document = PLAN_KIND.encode(plan)
    assert document["weights"] == {"cpu": 0, "memory": 0, "network": 0, "task": 0, "latency": 1}
    assert PLAN_KIND.decode(document).steps == plan.steps


jobs = st.builds(JobSize, received=st.sampled_from([0.0, 2e5, 5e6]), sent=st.sampled_from([0.0, 1e3]))
services = st.sampled_from(
    [{}, SERVICE, {"2c-4Gi": ServiceTime(p50=0.02, p95=0.03), "4c-4Gi": ServiceTime(p50=0.04, p95=0.04)}]
)


@st.composite
def latency_cases(draw: st.DrawFn, *, weighed: bool = True, hard: bool = True) -> Case:
    """Cases of which some tasks state deadlines."""
    case = draw(cases())
    tasks = {
        name: replace(
            task,
            deadline=draw(st.sampled_from([None, 0.05, 0.1, 1.0])),
            service_time=draw(services),
            job=draw(jobs),
        )
        for name, task in case.tasks.tasks.items()
    }
    if hard:
        tasks = {
            name: replace(task, hard_deadline=task.deadline is not None and draw(st.booleans()))
            for name, task in tasks.items()
        }
    weights = case.policy.weights
    if weighed:
        weights = Weights({**weights, LATENCY: draw(st.sampled_from([0.0, 0.5, 2.0]))})
    return replace(case, tasks=replace(case.tasks, tasks=tasks), policy=replace(case.policy, weights=weights))


@given(case=latency_cases())
@settings(deadline=None)
def test_both_scans_decide_the_same_with_latency(case: Case) -> None:
    pytest.importorskip("numpy")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edgectl.scheduler.assign.MIN_ARRAY_PAIRS", 0)
        arrays = case.assign()
    assert arrays == case.assign()


@given(case=latency_cases())
@settings(deadline=None)
def test_totals_are_the_weighted_sums_and_nothing_new_goes_where_it_misses_a_hard_deadline(
    case: Case,
) -> None:
    found = case.assign()
    for decision in found.decisions:
        for entry in decision.ranking:
            if entry.total is not None and case.policy.prefer == Policy().prefer:
                terms = zip(found.policy.weights.values(), entry.terms.values(), strict=True)
                assert entry.total == pytest.approx(sum(weight * (term or 0.0) for weight, term in terms))
                assert -1.0 <= (entry.terms[LATENCY] or 0.0) <= 1.0
            late = any(each.rule is RejectionRule.DEADLINE_MISSED for each in entry.rejections)
            if late and case.policy.name is PolicyName.UTILITY:
                assert not entry.feasible
                if decision.host == entry.host and decision.reason is Reason.BEST:
                    raise AssertionError(f"{decision.task} is placed where it misses its deadline")


def strip_predictions(found: Assignment) -> Assignment:
    decisions = tuple(
        replace(
            decision,
            ranking=tuple(
                replace(entry, predicted_latency=None, terms=type(entry.terms)({**entry.terms, LATENCY: 1.0}))
                for entry in decision.ranking
            ),
        )
        for decision in found.decisions
    )
    return replace(found, decisions=decisions)


@given(case=latency_cases(weighed=False, hard=False))
@settings(deadline=None)
def test_soft_deadlines_that_are_not_weighed_change_no_decision(case: Case) -> None:
    plain = {name: replace(task, service_time={}) for name, task in case.tasks.tasks.items()}
    without = replace(case, tasks=replace(case.tasks, tasks=plain))
    assert strip_predictions(case.assign()) == strip_predictions(without.assign())


def test_room_is_not_made_at_the_price_of_a_hard_deadline() -> None:
    """edge2 has room for detection if the other leaves it; then detection would miss on edge1's slow link."""
    inventory: Inventory = FLEET
    tasks = some_tasks(
        a_detection(hard_deadline=True, demand=Demand(cpu=a_quantity(0.5))),
        a_task("filler", cpu=0.6, only=["edge2"], priority=5.0),
    )
    decisions = decisions_by_task(run_assign(inventory, tasks, a_fleet()))
    assert decisions["filler"].host == "edge2"
    assert decisions["detection"].host is None, "edge1 has room, but its link is too slow"
