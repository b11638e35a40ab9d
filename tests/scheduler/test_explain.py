# SPDX-License-Identifier: Apache-2.0
"""Explanations checked against the scheduler itself: every flip is applied, and just before it nothing
changes.
"""

from dataclasses import replace

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edgectl.model.assignment import Assignment, Reason
from edgectl.model.explanation import ChangeKind, Explanation, Flip
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy, Weights
from edgectl.model.resource import Usage
from edgectl.model.snapshot import LinkSample, Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.assign import assign
from edgectl.scheduler.explain import TermNoise, explain_decision
from tests.builders import (
    GI,
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)

LINK = 10e6
# Distance beyond a crossing as a share of the capacity: totals then differ by more than the tolerance of
# equality.
STEP = 1e-6


def run_assign(inventory: Inventory, tasks: Tasks, snapshot: Snapshot, policy: Policy) -> Assignment:
    return assign(inventory, tasks, snapshot, snapshot.manager or ManagerState(), policy, NOW)


def explain_slam(
    inventory: Inventory,
    tasks: Tasks,
    snapshot: Snapshot,
    policy: Policy,
    noise: dict[str, TermNoise] | None = None,
) -> Explanation:
    assignment = run_assign(inventory, tasks, snapshot, policy)
    return explain_decision(
        inventory, tasks.tasks["slam"], snapshot, assignment.decisions[0], assignment.policy, noise
    )


def two_edges(used1: float, used2: float, **fields: float) -> tuple[Inventory, Tasks, Snapshot]:
    """Two edges of 4 cores, one task of 0.4 cores."""
    snapshot = a_snapshot(edge1=a_sample(used=used1), edge2=a_sample(used=used2))
    return (
        an_inventory(an_edge("edge1"), an_edge("edge2")),
        some_tasks(a_task(cpu=fields.get("cpu", 0.4))),
        snapshot,
    )


CPU = Policy(weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0))


def test_by_hand_a_load_that_rises_and_one_that_falls() -> None:
    """Totals (4 - 1 - .4)/4 = .65 and (4 - 2 - .4)/4 = .4: one core apart."""
    found = explain_slam(*two_edges(1.0, 2.0), CPU)
    assert found.runner_up == "edge2"
    leads = {each.term: round(each.lead, 9) for each in found.contributions}
    assert {term: lead for term, lead in leads.items() if lead} == {"cpu": 0.25}
    flips = {(flip.change, flip.host): flip for flip in found.flips if flip.term == "cpu"}
    assert flips[ChangeKind.LOAD_RISES, "edge1"].amount == pytest.approx(1.0)
    assert flips[ChangeKind.LOAD_FALLS, "edge2"].amount == pytest.approx(1.0)
    assert {flip.winner for flip in flips.values()} == {"edge2"}
    assert found.slack == pytest.approx(0.25)


def test_by_hand_a_weight() -> None:
    """Memory favours edge2 by .5, cpu edge1 by .25: with weights w and 1 - w they are equal at .25 w = .5 (1
    - w).
    """
    inventory, tasks, _ = two_edges(0.0, 0.0)
    world = a_snapshot(edge1=a_sample(used=1.0, used_memory=2 * GI), edge2=a_sample(used=2.0))
    policy = Policy(weights=Weights(cpu=0.9, memory=0.1, network=0.0, task=0.0))
    found = explain_slam(inventory, tasks, world, policy)
    falls = next(
        flip for flip in found.flips if flip.change is ChangeKind.WEIGHT_FALLS and flip.term == "cpu"
    )
    assert falls.amount == pytest.approx(2 / 3)
    assert falls.winner == "edge2"


def test_a_running_task_flips_only_beyond_the_margin() -> None:
    inventory, tasks, _ = two_edges(0.0, 0.0)
    run = a_run(used=Usage(cpu=0.4), spec_hash="hash-slam")
    world = a_snapshot(
        memory=ManagerState(managed=True, placements={"slam": Placement(host="edge1", since=NOW - 3600.0)}),
        edge1=a_sample(used=1.4, tasks={"slam": run}),
        edge2=a_sample(used=1.0),
    )
    found = explain_slam(inventory, tasks, world, CPU)
    rises = next(flip for flip in found.flips if flip.change is ChangeKind.LOAD_RISES)
    assert (rises.host, rises.winner) == ("edge1", "edge2")
    assert rises.amount == pytest.approx(0.4)


def test_an_unplaced_task_says_what_would_have_to_go() -> None:
    found = explain_slam(*two_edges(3.9, 3.8), CPU)
    assert found.decision.reason is Reason.NO_FEASIBLE_HOST
    falls = next(flip for flip in found.flips if flip.change is ChangeKind.LOAD_FALLS)
    assert (falls.host, falls.winner) == ("edge2", "edge2")
    assert falls.amount == pytest.approx(0.2)


def test_a_lead_within_the_noise_is_fragile() -> None:
    noise = {"edge1": TermNoise(cpu=0.03), "edge2": TermNoise(cpu=0.04)}
    near = explain_slam(*two_edges(1.0, 1.16), CPU, noise)
    assert near.noise == pytest.approx(0.05)
    assert near.slack == pytest.approx(0.04)
    assert near.fragile
    assert not explain_slam(*two_edges(1.0, 2.0), CPU, noise).fragile
    assert not explain_slam(*two_edges(1.0, 1.0001), CPU).fragile, "nothing is known of the noise"


@st.composite
def draw_inputs(draw: st.DrawFn) -> tuple[Inventory, Tasks, Snapshot, Policy]:
    edges = [f"edge{number}" for number in range(1, draw(st.integers(2, 4)) + 1)]
    share = st.integers(0, 90).map(lambda percent: percent / 100)
    demand = {"cpu": draw(share) * 1.5, "memory": draw(share) * GI, "throughput": draw(share) * 3e6}
    task = a_task(**demand, robots=["robot1"])  # type: ignore[arg-type]
    incumbent = draw(st.none() | st.sampled_from(edges))
    samples = {}
    for edge in edges:
        cores = draw(st.sampled_from([2.0, 4.0, 8.0]))
        run = a_run(used=Usage(cpu=0.0), spec_hash="hash-slam")
        samples[edge] = a_sample(
            cores=cores, used=cores * draw(share), used_memory=4 * GI * draw(share),
            links={"robot1": a_link(LINK, LINK * draw(share))}, tasks={"slam": run} if edge == incumbent else {},
        )  # fmt: skip
    placements = {"slam": Placement(host=incumbent, since=NOW - 3600.0)} if incumbent else {}
    weights = draw(st.tuples(*[st.integers(1, 20)] * 4))
    total = sum(weights)
    policy = Policy(
        weights=Weights(
            **{
                name: value / total
                for name, value in zip(("cpu", "memory", "network", "task"), weights, strict=True)
            }
        )
    )
    inventory = an_inventory(*(an_edge(name) for name in edges), a_robot("robot1", probe=False))
    return (
        inventory,
        some_tasks(task),
        a_snapshot(samples, memory=ManagerState(managed=True, placements=placements)),
        policy,
    )


@settings(max_examples=300)
@given(draw_inputs(), st.data())
def test_every_flip_flips_and_nothing_smaller_does(
    world: tuple[Inventory, Tasks, Snapshot, Policy], data: st.DataObject
) -> None:
    inventory, tasks, snapshot, policy = world
    found = explain_slam(*world)
    assume(found.flips)
    flip = data.draw(st.sampled_from(found.flips))
    assume(flip.size > 2 * STEP)
    just_before, just_after = (
        apply_flip(snapshot, policy, flip, 1 + step / flip.size) for step in (-STEP, STEP)
    )
    assume(just_after is not None)
    assert just_before is not None
    assert just_after is not None
    assert run_assign(inventory, tasks, *just_before).decisions[0].host == found.decision.host
    assert run_assign(inventory, tasks, *just_after).decisions[0].host == flip.winner


def apply_flip(
    snapshot: Snapshot, policy: Policy, flip: Flip, share: float
) -> tuple[Snapshot, Policy] | None:
    """Return the input after ``share`` of the flip; None where a load would become negative."""
    if flip.host is None:
        assume(1e-3 < flip.amount < 1 - 1e-3)
        return snapshot, change_weight(policy, flip, share)
    host, sign = snapshot.hosts[flip.host], 1.0 if flip.change is ChangeKind.LOAD_RISES else -1.0
    delta = sign * flip.amount * share
    assert host.measured
    if flip.term in host.usage:
        usage = host.usage[flip.term]
        host = replace(
            host,
            usage={**host.usage, flip.term: replace(usage, used=usage.used + delta)},
        )
        left = usage.used + delta
    else:
        assert flip.robot is not None
        link = host.links[flip.robot]
        left = link.used_bytes_per_s + delta
        host = replace(
            host,
            links={
                flip.robot: LinkSample(capacity_bytes_per_s=link.capacity_bytes_per_s, used_bytes_per_s=left)
            },
        )
    return (replace(snapshot, hosts={**snapshot.hosts, flip.host: host}), policy) if left >= 0 else None


def change_weight(policy: Policy, flip: Flip, share: float) -> Policy:
    old = dict(policy.weights)
    weight = old[flip.term] + (flip.amount - old[flip.term]) * share
    rest = (1 - weight) / (1 - old[flip.term])
    return replace(
        policy,
        weights=Weights({term: weight if term == flip.term else value * rest for term, value in old.items()}),
    )
