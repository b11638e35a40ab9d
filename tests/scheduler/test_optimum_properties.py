# SPDX-License-Identifier: Apache-2.0
"""Properties of the best plan, on any fleet: never worse, every bound true, and settled where it says so."""

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Verdict
from edgectl.model.plan import Action
from edgectl.scheduler.assign import assign
from edgectl.solver.highs import make_solver
from tests.builders import NOW
from tests.scheduler.fleets import hosts_by_task, simulate_apply
from tests.scheduler.test_properties import Case, cases
from tests.scheduler.tight_fleets import build_random_fleet, count_unplaced, enlarge_edge

few = settings(max_examples=max(5, settings().max_examples // 5))


@few
@given(cases())
def test_never_worse_and_every_bound_holds(case: Case) -> None:
    policy = replace(case.policy, optimal=True)
    found = assign(case.inventory, case.tasks, case.snapshot, case.memory, policy, NOW, make_solver())
    plain = case.assign()
    assert count_unplaced(found) <= count_unplaced(plain)
    overloaded = {decision.task for decision in plain.decisions if decision.overcommitted}
    assert {d.task for d in found.decisions if d.overcommitted and d.verdict is Verdict.PLACED} <= overloaded
    assert hosts_by_task(found).keys() == hosts_by_task(plain).keys()
    certificate = found.certificate
    if certificate is not None:
        assert certificate.placed <= certificate.placed_bound
        assert certificate.moves >= certificate.moves_bound
        assert (
            certificate.utility_sum_bound is None or certificate.utility_sum <= certificate.utility_sum_bound
        )


@few
@given(st.integers(0, 10_000), st.sampled_from(["edge1", "edge2", "edge3"]), st.floats(0.5, 0.8))
def test_a_larger_edge_unplaces_nothing(seed: int, edge: str, fill: float) -> None:
    fleet = build_random_fleet(3, 10, seed, fill)
    assert count_unplaced(enlarge_edge(fleet, edge).assign()) <= count_unplaced(fleet.assign())


@few
@given(st.integers(0, 10_000), st.floats(0.4, 0.9), st.sampled_from(["plain", "rebalance", "optimal"]))
def test_a_settled_plan_applied_and_made_again_changes_nothing(seed: int, fill: float, way: str) -> None:
    fleet = build_random_fleet(3, 9, seed, fill)
    policy = replace(fleet.policy, rebalance=way == "rebalance", optimal=way == "optimal", min_dwell=0.0)
    solve = make_solver() if policy.optimal else None
    first = assign(fleet.inventory, fleet.tasks, fleet.snapshot, fleet.memory, policy, NOW, solve)
    if not first.settled:
        return
    snapshot, memory = simulate_apply(first, fleet.tasks, fleet.snapshot, fleet.memory)
    for again in (replace(policy, optimal=False, rebalance=False), policy):
        solve = make_solver() if again.optimal else None
        second = assign(fleet.inventory, fleet.tasks, snapshot, memory, again, NOW, solve)
        if again.rebalance:
            continue  # running tasks may still pay by more than the margin
        steps = diff_assignment(second, fleet.tasks, snapshot, memory)
        assert {step.action for step in steps} <= {Action.KEEP, Action.UNPLACED}
