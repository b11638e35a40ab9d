# SPDX-License-Identifier: Apache-2.0
"""Rankings that are made when they are read, and bounds that spare the second look at a task."""

from dataclasses import replace
from random import Random

import pytest

from edgectl.formats.codec import encode
from edgectl.model.assignment import Assignment, Verdict
from edgectl.model.policy import Policy
from edgectl.scheduler.candidates import CandidateSet, gather_candidates, weigh_candidates
from edgectl.scheduler.choice import MoveConstraints, choose_by_utility
from edgectl.scheduler.ledger import compute_demand_usage
from edgectl.scheduler.peaks import LoadPeaks, stays_by_room, stays_in_place
from edgectl.scheduler.ranking import SHORT_RANKING, rank_hosts
from tests.scheduler.test_scan import a_view
from tests.scheduler.tight_fleets import build_random_fleet


def a_plan() -> Assignment:
    return build_random_fleet(10, 30, seed=3, fill=0.6).assign()


def test_the_order_in_which_rankings_are_read_does_not_matter() -> None:
    forward, backward, shuffled = a_plan(), a_plan(), a_plan()
    for decision in reversed(backward.decisions):
        assert len(decision.ranking) == 10
    order = list(shuffled.decisions)
    Random(1).shuffle(order)
    for decision in order:
        assert decision.rejection_counts == {}
    assert [encode(each) for each in forward.decisions] == [encode(each) for each in backward.decisions]
    assert [encode(each) for each in forward.decisions] == [encode(each) for each in shuffled.decisions]
    assert forward == backward


def test_a_decision_agrees_with_the_ranking_that_is_made_later() -> None:
    for seed in range(4):
        for decision in build_random_fleet(10, 30, seed=seed, fill=0.8).assign().decisions:
            ranked = next((each for each in decision.ranking if each.host == decision.host), None)
            others = [each for each in decision.ranking if each.feasible and each.host != decision.host]
            assert decision.total == (ranked.total if ranked else None)
            if ranked and others and ranked.total is not None and others[0].total is not None:
                assert (decision.challenger, decision.lead) == (
                    others[0].host,
                    ranked.total - others[0].total,
                )


def test_equal_hosts_are_ranked_in_the_order_of_the_tie_rule() -> None:
    fleet = build_random_fleet(70, 70, seed=1, fill=0.2)
    sample = fleet.snapshot.hosts["edge1"]
    alike = replace(fleet.snapshot, hosts=dict.fromkeys(fleet.snapshot.hosts, sample))
    for decision in replace(fleet, snapshot=alike).assign().decisions:
        shown = [each.host for each in decision.ranking]
        assert (decision.host, decision.challenger) == (shown[0], shown[1])
        assert len(shown) == SHORT_RANKING


def a_running_view(seed: int) -> CandidateSet:
    """A task that runs on one of thirty edges, its own load taken out, predecessors on two others."""
    view = a_view(seed)
    here = Random(seed).choice([place for place in view.listed if place not in view.denied])
    ledger = view.ledger.copy()
    ledger.release(here, compute_demand_usage(view.context.fleet, view.task, here))
    context = replace(view.context, policy=Policy(weights=view.context.policy.weights, move_margin=0.3))
    return gather_candidates(
        context, ledger, view.task, incumbent=here, predecessors=view.predecessors, placed={}
    )


def test_a_task_that_stays_by_the_bounds_stays_by_the_rule() -> None:
    stayed = 0
    for seed in range(150):
        view = a_running_view(seed)
        assert view.incumbent is not None
        ledger = view.ledger.copy()
        ledger.charge(view.incumbent, compute_demand_usage(ledger.fleet, view.task, view.incumbent))
        if not stays_in_place(replace(view, ledger=ledger), LoadPeaks()):
            continue
        stayed += 1
        weighed = weigh_candidates(view)
        choice = choose_by_utility(weighed, MoveConstraints())
        assert (choice.verdict, choice.place) == (Verdict.KEPT, view.incumbent)
        assert rank_hosts(weighed, choice.place)[0]
    assert 10 < stayed < 140, f"{stayed} of 150: both answers occur"


@pytest.mark.parametrize("beside", [False, True])
def test_a_task_that_stays_by_room_alone_stays_by_the_rule(beside: bool) -> None:
    stayed = 0
    for seed in range(150):
        view = a_running_view(seed)
        here = view.incumbent
        assert here is not None
        predecessors = dict.fromkeys(view.predecessors, here) if beside else {}
        view = gather_candidates(
            view.context, view.ledger, view.task, incumbent=here, predecessors=predecessors, placed={}
        )
        ledger = view.ledger.copy()
        ledger.charge(here, compute_demand_usage(ledger.fleet, view.task, here))
        if not stays_by_room(view.context, ledger, view.task, here, tuple(view.located), LoadPeaks()):
            continue
        stayed += 1
        choice = choose_by_utility(weigh_candidates(view), MoveConstraints())
        assert (choice.verdict, choice.place) == (Verdict.KEPT, here)
    assert 0 < stayed < 150, f"{stayed} of 150: both answers occur"
