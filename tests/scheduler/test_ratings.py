# SPDX-License-Identifier: Apache-2.0
"""UT_rating: ratings of plugins in totals, tables of totals, explanations; and what cannot weigh them."""

from dataclasses import replace

import pytest

from edgectl.errors import UsageError
from edgectl.formats.kinds import SNAPSHOT_KIND
from edgectl.model.policy import WEIGHT_PRESETS, Policy, PolicyName, Weights
from edgectl.model.resource import RATING
from edgectl.model.snapshot import Snapshot, TermRatings
from edgectl.scheduler.array_scan import build_array_scan
from edgectl.scheduler.explain import explain_decision
from edgectl.usecases.plan import check_search
from tests.builders import a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import decisions_by_task, hosts_by_task, run_assign

EDGES = ["edge3", "edge2", "edge1"]
FLEET = an_inventory(*map(an_edge, EDGES))
TASKS = some_tasks(a_task("slam", cpu=1.0), a_task("nav", cpu=1.0))
SHADE = TermRatings(package="lab 0.1", tasks={"slam": {"edge1": 1.0, "edge2": 0.2}})
HEAT = TermRatings(package="lab 0.1", tasks={"slam": {"edge1": 0.0}, "nav": {"edge2": 0.9}})
LOOK = a_snapshot(edge3=a_sample(), edge2=a_sample(used=1.0), edge1=a_sample(used=2.0))
ALONE = Policy(weights=WEIGHT_PRESETS[RATING], terms=("shade",))


def rated(snapshot: Snapshot = LOOK, **terms: TermRatings) -> Snapshot:
    return replace(snapshot, ratings=terms)


def test_ratings_alone_decide_within_the_room_that_is_there() -> None:
    """slam: edge1 1.0, edge3 0.5 (not rated), edge2 0.2; a full edge1 is none."""
    found = decisions_by_task(run_assign(FLEET, TASKS, rated(shade=SHADE), policy=ALONE))
    assert found["slam"].host == "edge1"
    assert [(entry.host, entry.terms[RATING], entry.total) for entry in found["slam"].ranking] == [
        ("edge1", 1.0, 1.0),
        ("edge3", 0.5, 0.5),
        ("edge2", 0.2, 0.2),
    ]
    full = rated(a_snapshot({**LOOK.hosts, "edge1": a_sample(used=4.0)}), shade=SHADE)
    assert hosts_by_task(run_assign(FLEET, TASKS, full, policy=ALONE))["slam"] == "edge3"


def test_several_terms_count_by_their_mean_and_beside_the_others() -> None:
    """slam on edge1: rating (1.0 + 0.0) / 2, cpu (4 - 2 - 1) / 4; half of each. nav has taken a core of edge3."""
    weights = Weights({**dict.fromkeys(Weights(), 0.0), "cpu": 0.5, RATING: 0.5})
    policy = Policy(weights=weights, terms=("shade", "heat"))
    found = decisions_by_task(run_assign(FLEET, TASKS, rated(shade=SHADE, heat=HEAT), policy=policy))["slam"]
    totals = {entry.host: entry.total for entry in found.ranking}
    assert totals == pytest.approx({"edge1": 0.25 / 2 + 0.25, "edge2": 0.25 + 0.175, "edge3": 0.25 + 0.25})


def test_a_running_task_moves_for_ratings_by_the_margin_as_for_any_term() -> None:
    run = a_run(spec_hash="hash-slam")
    hosts = {**LOOK.hosts, "edge3": a_sample(tasks={"slam": run})}
    for margin, host in ((0.4, "edge1"), (0.6, "edge3")):
        policy = replace(ALONE, move_margin=margin, min_dwell=0.0)
        found = run_assign(FLEET, TASKS, rated(a_snapshot(hosts), shade=SHADE), policy=policy)
        assert hosts_by_task(found)["slam"] == host


def test_explain_names_the_term_and_the_weight_that_would_change_it() -> None:
    weights = Weights({**dict.fromkeys(Weights(), 0.0), "cpu": 0.5, RATING: 0.5})
    policy = Policy(weights=weights, terms=("shade",))
    look = rated(shade=SHADE)
    assignment = run_assign(FLEET, TASKS, look, policy=policy)
    decision = decisions_by_task(assignment)["slam"]
    found = explain_decision(FLEET, TASKS.tasks["slam"], look, decision, assignment.policy)
    assert {each.term: each.weight for each in found.contributions}[RATING] == 0.5
    assert RATING in {flip.term for flip in found.flips}
    plain = run_assign(FLEET, TASKS, LOOK)
    none = explain_decision(FLEET, TASKS.tasks["slam"], LOOK, decisions_by_task(plain)["slam"], plain.policy)
    assert RATING not in {each.term for each in none.contributions} | {flip.term for flip in none.flips}


def test_the_scan_of_large_fleets_counts_them_too(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numpy")
    assert build_array_scan is not None
    # Totals without ratings must not tie: then the arrays alone would not decide anyway.
    mixed = Weights({**dict.fromkeys(Weights(), 0.0), "cpu": 0.3, RATING: 0.7})
    policies = [ALONE, Policy(weights=mixed, terms=("shade",))]
    plain = [run_assign(FLEET, TASKS, rated(shade=SHADE), policy=policy) for policy in policies]
    monkeypatch.setattr("edgectl.scheduler.assign.MIN_ARRAY_PAIRS", 0)
    found = [run_assign(FLEET, TASKS, rated(shade=SHADE), policy=policy) for policy in policies]
    assert [each.decisions for each in found] == [each.decisions for each in plain]
    assert [hosts_by_task(each)["slam"] for each in found] == ["edge1", "edge1"]


def test_without_its_ratings_nothing_is_decided() -> None:
    with pytest.raises(UsageError, match="rating is weighed, and the ratings of shade are missing"):
        run_assign(FLEET, TASKS, LOOK, policy=ALONE)
    with pytest.raises(UsageError, match="rating is weighed, and terms are missing"):
        run_assign(FLEET, TASKS, LOOK, policy=Policy(weights=WEIGHT_PRESETS[RATING]))
    for named in ({"optimal": True}, {"rebalance": True}):
        with pytest.raises(UsageError, match="cannot weigh the ratings of plugins"):
            check_search(replace(ALONE, **named))  # type: ignore[arg-type]


def test_the_snapshot_keeps_them_and_a_plan_of_it_is_the_same() -> None:
    look = rated(shade=SHADE, heat=HEAT)
    read = SNAPSHOT_KIND.decode(SNAPSHOT_KIND.encode(look))
    assert read.ratings == look.ratings
    for name in (PolicyName.UTILITY, PolicyName.STATIC, PolicyName.PACK):
        policy = replace(ALONE, name=name)
        assert run_assign(FLEET, TASKS, read, policy=policy) == run_assign(FLEET, TASKS, look, policy=policy)
