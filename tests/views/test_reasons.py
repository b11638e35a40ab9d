# SPDX-License-Identifier: Apache-2.0
"""Every reason and every rule has words; the numbers in them are the decision's own."""

import pytest

from edgectl.model.assignment import (
    Decision,
    MoveCost,
    RankedHost,
    Reason,
    Rejection,
    RejectionRule,
    UtilityTerms,
    Verdict,
)
from edgectl.model.plan import Action, Step
from edgectl.model.resource import CPU, NETWORK
from edgectl.views.notes import join_words
from edgectl.views.reasons import describe_fitting_hosts, describe_reason, describe_rejection

NO_TERMS = UtilityTerms(cpu=None, memory=None, network=None, task=None)


def rejected(host: str, *rejections: Rejection) -> RankedHost:
    return RankedHost(host=host, rank=0, total=None, terms=NO_TERMS, feasible=False, rejections=rejections)


def short(host: str, free: float) -> RankedHost:
    return rejected(
        host,
        Rejection(rule=RejectionRule.INSUFFICIENT, resource=CPU, demand=2.4, used=4.0 - free, capacity=4.0),
    )


def step(why: Reason, action: Action = Action.KEEP, **fields: object) -> Step:
    verdict = fields.pop("verdict", Verdict.KEPT)
    decision = Decision(task="t", verdict=verdict, reason=why, host="e1", previous_host="e1", **fields)  # type: ignore[arg-type]
    return Step(decision=decision, action=action)


@pytest.mark.parametrize("why", list(Reason))
def test_every_reason_has_words(why: Reason) -> None:
    text = describe_reason(step(why, subject="s", amount=1.0, challenger="e2", lead=-0.1))
    assert text.startswith("keep: ")
    assert len(text) > len("keep: ") + 3


@pytest.mark.parametrize("rule", list(RejectionRule))
def test_every_rule_has_words(rule: RejectionRule) -> None:
    assert len(describe_rejection(Rejection(rule=rule))) > 3


def test_below_margin_names_challenger_lead_and_margin() -> None:
    text = describe_reason(step(Reason.BELOW_MARGIN, challenger="edge2", lead=-0.082, amount=0.1))
    assert text == "keep: edge2 leads by 0.082, below move margin 0.10"


def test_dwell_says_how_long() -> None:
    assert (
        describe_reason(step(Reason.DWELL, challenger="edge2", lead=-0.2, amount=61.0))
        == "keep: edge2 leads by 0.200; 1m01s left of min_dwell"
    )


def test_gain_says_by_how_much() -> None:
    decision = Decision(
        task="t", verdict=Verdict.PLACED, reason=Reason.GAIN, host="e2", previous_host="e1", amount=0.25
    )
    assert (
        describe_reason(Step(decision=decision, action=Action.MOVE))
        == "move: e2 beats e1 by 0.250, more than the move margin"
    )


def test_a_measured_move_names_downtime_and_stay() -> None:
    cost = MoveCost(stay_s=300.0, downtime_s=4.0, per_s=10.0)
    kept = describe_reason(
        step(Reason.COST_ABOVE_GAIN, challenger="e2", lead=-0.13, amount=cost.needed, cost=cost)
    )
    assert kept == "keep: e2 leads by 0.130, no more than the 0.133 that 4.0s of downtime cost over 5m00s"
    decision = Decision(
        task="t",
        verdict=Verdict.PLACED,
        reason=Reason.GAIN_OVER_COST,
        host="e2",
        previous_host="e1",
        amount=0.14,
        cost=cost,
    )
    moved = describe_reason(Step(decision=decision, action=Action.MOVE))
    assert moved == "move: e2 beats e1 by 0.140, more than the 0.133 that 4.0s of downtime cost over 5m00s"


def test_a_silent_host_says_how_long_its_task_is_held() -> None:
    assert describe_reason(step(Reason.HOST_SILENT, Action.HOLD, subject="e1")) == "hold: e1 does not answer"
    assert (
        describe_reason(step(Reason.HOST_SILENT, Action.HOLD, subject="e1", amount=80.0))
        == "hold: e1 does not answer; replaced in 1m20s"
    )
    assert (
        describe_reason(step(Reason.REPLACED, Action.START, subject="e1"))
        == "start: e1 does not answer, and its copy there is fenced off"
    )


def test_a_task_that_was_given_up_says_what_starts_it_again() -> None:
    ended = Decision(task="t", verdict=Verdict.UNPLACED, reason=Reason.GIVEN_UP, subject="e1", amount=3.0)
    end = "and is given up; edgectl restart t, or a changed spec, starts it again"
    assert (
        describe_reason(Step(decision=ended, action=Action.UNPLACED))
        == f"unplaced: failed on e1 (last exit 3) {end}"
    )
    well = Decision(task="t", verdict=Verdict.UNPLACED, reason=Reason.GIVEN_UP, subject="e1", amount=0.0)
    assert (
        describe_reason(Step(decision=well, action=Action.UNPLACED))
        == f"unplaced: exited by itself on e1 (last exit 0) {end}"
    )


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        (("command", "env"), "restart: command and env changed"),
        (("spec",), "restart: its spec changed"),
        ((), "restart: its spec changed"),
    ],
)
def test_a_restart_names_what_changed(changed: tuple[str, ...], text: str) -> None:
    made = step(Reason.SPEC_CHANGED, Action.RESTART)
    assert describe_reason(Step(decision=made.decision, action=made.action, changed=changed)) == text


def test_unplaced_in_one_line() -> None:
    cordoned = rejected("e3", Rejection(rule=RejectionRule.CORDONED))
    decision = Decision(
        task="t",
        verdict=Verdict.UNPLACED,
        reason=Reason.NO_FEASIBLE_HOST,
        nearest="e2",
        ranking=(short("e1", 1.12), short("e2", 1.2), cordoned),
    )
    assert describe_reason(Step(decision=decision, action=Action.UNPLACED)) == (
        "unplaced: 0/3 hosts fit: 2 short of cpu (need 2.400 cores, free 1.120 cores and 1.200 cores), 1 cordoned; nearest is e2"
    )


def test_fits_counts_what_a_short_ranking_left_out() -> None:
    decision = Decision(
        task="t",
        verdict=Verdict.UNPLACED,
        reason=Reason.NO_FEASIBLE_HOST,
        ranking=(short("e1", 1.0),),
        rejection_counts={"insufficient": 80, "cordoned": 2},
    )
    assert (
        describe_fitting_hosts(decision)
        == "0/83 hosts fit: 1 short of cpu (need 2.400 cores, free 1.000 cores), 80 others too small, 2 cordoned"
    )


def test_forced_move_says_what_the_present_host_lacks() -> None:
    link = Rejection(
        rule=RejectionRule.INSUFFICIENT,
        resource=NETWORK,
        robot="r1",
        demand=2e6,
        used=4e6,
        capacity=5e6,
    )
    decision = Decision(
        task="t",
        verdict=Verdict.PLACED,
        reason=Reason.FORCED_INFEASIBLE,
        host="e2",
        previous_host="e1",
        ranking=(rejected("e1", link),),
    )
    assert (
        describe_reason(Step(decision=decision, action=Action.MOVE))
        == "move: e1 short of network to r1 by 1.0MB/s (need 2.0MB/s, free 1.0MB/s)"
    )


def test_left_out_and_a_second_copy() -> None:
    assert (
        describe_reason(step(Reason.GAIN, Action.NONE, verdict=Verdict.PLACED))
        == "none: left out by --target or -l"
    )
    decision = Decision(task="t", verdict=Verdict.KEPT, reason=Reason.STILL_BEST, host="e1")
    assert (
        describe_reason(Step(decision=decision, action=Action.KEEP, stop=("e2", "e3")))
        == "keep: still the best host; stop the one on e2 and e3"
    )


def test_listed() -> None:
    assert [join_words(()), join_words("a"), join_words("abc")] == ["", "a", "a, b and c"]
