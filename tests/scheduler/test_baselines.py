# SPDX-License-Identifier: Apache-2.0
"""Rules of other schedulers as policies (ADR 130): tables worked by hand, and what no policy may do."""

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.model.assignment import Assignment, Reason, Verdict
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.model.resource import Usage
from edgectl.model.task import OnboardRule
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
    silent,
    some_tasks,
)
from tests.scheduler.fleets import decisions_by_task, hosts_by_task, run_assign, simulate_apply
from tests.scheduler.test_properties import Case, cases, quick

# In reverse alphabetical order of their loads: the order of names decides nothing.
FLEET = an_inventory(an_edge("zulu"), an_edge("mike"), an_edge("alpha"))
ONE_CORE = a_task("slam", cpu=1.0, memory=GI)
SNAPSHOT = a_snapshot(
    zulu=a_sample(used=0.4, used_memory=2 * GI),  # free with the task: cpu (4 - .4 - 1) / 4 = .65, memory .25
    mike=a_sample(used=2.0, used_memory=0.4 * GI),  # cpu .25, memory .65
    alpha=a_sample(used=2.4, used_memory=2.4 * GI),  # cpu .15, memory .15
)
UNEVEN = a_snapshot(
    zulu=a_sample(used=0.4, used_memory=2.8 * GI),  # cpu .65, memory .05: 20 - (4.467 + 1.122) = 14.411
    mike=a_sample(used=1.6, used_memory=1.6 * GI),  # cpu .35, memory .35: 20 - 2 x 2.239 = 15.523
    alpha=a_sample(used=3.4),  # the CPU does not fit
)


def a_policy(name: str, seed: int = 0) -> Policy:
    return Policy(name=PolicyName(name), seed=seed)


@pytest.mark.parametrize(
    ("name", "host", "reason"),
    [
        # mean free share: zulu .45, mike .45 (a tie, by name), alpha .15
        ("static-least-loaded", "mike", Reason.LEAST_LOADED),
        ("least-loaded", "mike", Reason.BEST),
        # zulu 20 - (4.467 + 1.778) = 13.755, mike the same, alpha 20 - 2 x 1.413 = 17.175
        ("static-pack", "alpha", Reason.FULLEST),
        ("pack", "alpha", Reason.FULLEST),
        # the first task of the sequence begins at the first edge by name
        ("static-in-turn", "alpha", Reason.IN_TURN),
    ],
)
def test_each_rule_places_a_task_that_starts(name: str, host: str, reason: Reason) -> None:
    found = run_assign(FLEET, some_tasks(ONE_CORE), SNAPSHOT, policy=a_policy(name)).decisions[0]
    assert (found.host, found.reason, found.verdict) == (host, reason, Verdict.PLACED)


def test_free_share_and_packing_differ_where_a_host_is_full_on_one_side_only() -> None:
    """The mean ranks zulu and mike alike, the sum of powers prefers the even one; alpha is full."""
    hosts = {
        name: run_assign(FLEET, some_tasks(ONE_CORE), UNEVEN, policy=a_policy(name)).decisions[0].host
        for name in ("static-least-loaded", "static-pack")
    }
    assert hosts == {"static-least-loaded": "mike", "static-pack": "mike"}
    fuller = a_snapshot({**UNEVEN.hosts, "zulu": a_sample(used=1.2, used_memory=2.8 * GI)})
    # zulu: cpu .45, memory .05: mean .25, 20 - (2.818 + 1.122) = 16.060; mike: .35, 15.523
    assert (
        run_assign(FLEET, some_tasks(ONE_CORE), fuller, policy=a_policy("pack")).decisions[0].host == "zulu"
    )
    least = run_assign(FLEET, some_tasks(ONE_CORE), fuller, policy=a_policy("least-loaded")).decisions[0]
    assert least.host == "mike"
    assert least.total == pytest.approx(0.35)


def test_in_turn_goes_round_and_skips_what_does_not_fit() -> None:
    tasks = some_tasks(*(a_task(f"t{number}", cpu=0.5) for number in range(6)))
    empty = a_snapshot(zulu=a_sample(), mike=a_sample(), alpha=a_sample())
    found = run_assign(FLEET, tasks, empty, policy=a_policy("static-in-turn"))
    assert [decision.host for decision in found.decisions] == ["alpha", "mike", "zulu"] * 2
    full = a_snapshot(zulu=a_sample(), mike=a_sample(used=3.9), alpha=a_sample())
    found = run_assign(FLEET, tasks, full, policy=a_policy("static-in-turn"))
    assert [decision.host for decision in found.decisions] == ["alpha", "zulu", "zulu"] * 2


def test_in_turn_takes_the_robot_only_when_no_edge_fits() -> None:
    inventory = an_inventory(an_edge("zulu"), an_edge("mike"), a_robot("alpha", onboard=True))
    task = a_task("slam", cpu=1.0, robots=["alpha"], onboard=OnboardRule.ALLOW)
    links = {"alpha": a_link()}

    def place(used: float) -> str | None:
        edges = {name: a_sample(used=used, links=links) for name in ("zulu", "mike")}
        snapshot = a_snapshot(edges, alpha=a_sample())
        return (
            run_assign(inventory, some_tasks(task), snapshot, policy=a_policy("static-in-turn"))
            .decisions[0]
            .host
        )

    assert (place(0.0), place(3.5)) == ("mike", "alpha")


def test_the_seed_decides_the_draw_and_every_host_is_drawn_alike() -> None:
    tasks = some_tasks(a_task("slam", cpu=0.1))
    empty = a_snapshot(zulu=a_sample(), mike=a_sample(), alpha=a_sample())

    def draw(seed: int, snapshot: object = empty) -> str | None:
        return run_assign(FLEET, tasks, snapshot, policy=a_policy("random", seed)).decisions[0].host  # type: ignore[arg-type]

    drawn = [draw(seed) for seed in range(300)]
    assert drawn == [draw(seed) for seed in range(300)]
    # chi-square of 3 classes: 13.8 is exceeded with probability .001, and the seeds are fixed
    assert sum((count - 100) ** 2 / 100 for count in Counter(drawn).values()) < 13.8
    lost = a_snapshot(zulu=a_sample(), mike=a_sample(), alpha=silent())
    assert all(draw(seed, lost) == host for seed, host in enumerate(drawn) if host != "alpha")
    assert {draw(seed, lost) for seed, host in enumerate(drawn) if host == "alpha"} == {"zulu", "mike"}


def test_static_by_random_draws_once_for_each_seed_among_the_hosts_with_room() -> None:
    """As `random` draws; then it stays, which no other draw changes."""
    tasks = some_tasks(a_task("slam", cpu=1.0), a_task("nav", cpu=1.0))
    roomy = a_snapshot(zulu=a_sample(), mike=a_sample(used=3.5), alpha=a_sample(used=1.0))

    def draw(name: str, seed: int) -> dict[str, str | None]:
        found = run_assign(FLEET, tasks, roomy, policy=a_policy(name, seed))
        assert {decision.reason for decision in found.decisions} == {Reason.DRAWN}
        return hosts_by_task(found)

    drawn = [draw("static-random", seed) for seed in range(200)]
    assert drawn == [draw("random", seed) for seed in range(200)]
    pairs = Counter((hosts["slam"], hosts["nav"]) for hosts in drawn)
    # mike has room for half a core; all pairs of the others come up, a quarter of the time each
    assert pairs.keys() == {(one, other) for one in ("zulu", "alpha") for other in ("zulu", "alpha")}
    # chi-square of 4 classes: 16.3 is exceeded with probability .001, and the seeds are fixed
    assert sum((count - 50) ** 2 / 50 for count in pairs.values()) < 16.3
    run = {"slam": a_run(used=Usage(cpu=1.0)), "nav": a_run(used=Usage(cpu=1.0))}
    running = a_snapshot(zulu=a_sample(), mike=a_sample(used=3.5), alpha=a_sample(used=3.0, tasks=run))
    for seed in range(20):
        kept = run_assign(FLEET, tasks, running, policy=a_policy("static-random", seed))
        assert {decision.reason for decision in kept.decisions} == {Reason.NEVER_MOVED}


@pytest.mark.parametrize(
    ("name", "hosts"),
    [
        # mean of free CPU and memory: mike .45 as zulu (by name), then zulu .45 against mike 0 and .4; then both .2 (by name)
        ("static", ["mike", "zulu", "mike"]),
        ("static-least-loaded", ["mike", "zulu", "mike"]),
        ("static-in-turn", ["alpha", "mike", "zulu"]),
        # 17.175 at alpha, which is full then; 13.755 at both others (by name); then 20 - (1 + 2.512) at mike
        ("static-pack", ["alpha", "mike", "mike"]),
    ],
)
def test_each_static_scheme_places_by_its_own_rule_and_keeps_all(name: str, hosts: list[str]) -> None:
    tasks = some_tasks(*(a_task(f"t{number}", cpu=1.0, memory=GI) for number in range(3)))
    found = run_assign(FLEET, tasks, SNAPSHOT, policy=a_policy(name))
    assert [decision.host for decision in found.decisions] == hosts
    snapshot, memory = simulate_apply(found, tasks, SNAPSHOT, ManagerState())
    again = run_assign(FLEET, tasks, snapshot, memory=memory, policy=a_policy(name))
    assert hosts_by_task(again) == hosts_by_task(found)
    assert {decision.reason for decision in again.decisions} == {Reason.NEVER_MOVED}


@pytest.mark.parametrize("name", ["pack", "random"])
def test_a_running_task_stays_while_it_fits_and_leaves_when_it_does_not(name: str) -> None:
    """utility would go to the empty alpha: (4 - 1) / 4 against (4 - 2.5 - 1) / 4."""
    run = {"slam": a_run(used=Usage(cpu=1.0, memory=GI))}
    known = ManagerState(placements={"slam": Placement(host="zulu", since=NOW)})
    fits = a_snapshot(zulu=a_sample(used=3.5, tasks=run), mike=a_sample(used=3.9), alpha=a_sample())
    kept = run_assign(FLEET, some_tasks(ONE_CORE), fits, memory=known, policy=a_policy(name)).decisions[0]
    assert (kept.host, kept.reason) == ("zulu", Reason.STILL_FITS)
    task = replace(ONE_CORE, hosts=replace(ONE_CORE.hosts, never=("zulu",)))
    moved = run_assign(FLEET, some_tasks(task), fits, memory=known, policy=a_policy(name)).decisions[0]
    assert (moved.host, moved.previous_host, moved.reason) == ("alpha", "zulu", Reason.FORCED_RULE)
    nowhere = replace(ONE_CORE, hosts=replace(ONE_CORE.hosts, never=("zulu", "alpha")))
    stays = run_assign(FLEET, some_tasks(nowhere), fits, memory=known, policy=a_policy(name)).decisions[0]
    assert (stays.host, stays.reason) == ("zulu", Reason.NOTHING_FITS)
    gone = replace(a_policy(name), without=frozenset({"zulu", "alpha"}))
    left = run_assign(FLEET, some_tasks(ONE_CORE), fits, memory=known, policy=gone).decisions[0]
    assert (left.host, left.reason) == (None, Reason.NO_FEASIBLE_HOST)


def test_least_loaded_moves_for_a_gain_above_the_margin_and_ignores_all_other_terms() -> None:
    run = {"slam": a_run(used=Usage(cpu=1.0, memory=0.0))}
    task = a_task("slam", cpu=1.0, needs=["nav"])
    near = a_task("nav", managed=False)
    policy = replace(a_policy("least-loaded"), weights=Weights(cpu=0.0, memory=0.0, network=0.0, task=1.0))

    def place(zulu: float) -> tuple[str | None, Reason]:
        hosts = {"mike": a_sample(used=4.0), "alpha": a_sample(used=4.0)}
        running = a_sample(used=4.0, tasks={"nav": a_run(), **run})
        snapshot = a_snapshot({**hosts, "mike": running, "zulu": a_sample(used=zulu)})
        found = decisions_by_task(run_assign(FLEET, some_tasks(task, near), snapshot, policy=policy))["slam"]
        return found.host, found.reason

    # mean of cpu and memory: mike (0 + 1) / 2; zulu with 2 cores used (.25 + 1) / 2, with 2.4 (.15 + 1) / 2
    assert place(2.0) == ("zulu", Reason.GAIN)
    assert place(2.4) == ("mike", Reason.BELOW_MARGIN)


@pytest.mark.parametrize("name", [name for name in PolicyName if name.startswith("static")])
def test_static_policies_never_move_and_return_to_their_first_host(name: str) -> None:
    run = {"slam": a_run(used=Usage(cpu=1.0))}
    running = a_snapshot(zulu=a_sample(used=4.0, tasks=run), mike=a_sample(), alpha=a_sample())
    kept = run_assign(FLEET, some_tasks(ONE_CORE), running, policy=a_policy(name)).decisions[0]
    assert (kept.host, kept.reason) == ("zulu", Reason.NEVER_MOVED)
    known = ManagerState(first={"slam": "mike"})
    back = run_assign(FLEET, some_tasks(ONE_CORE), SNAPSHOT, memory=known, policy=a_policy(name)).decisions[0]
    assert (back.host, back.reason) == ("mike", Reason.FIRST_PLACEMENT)
    pinned = replace(ONE_CORE, hosts=replace(ONE_CORE.hosts, pin="zulu"))
    there = run_assign(FLEET, some_tasks(pinned), SNAPSHOT, memory=known, policy=a_policy(name)).decisions[0]
    assert (there.host, there.reason) == ("zulu", Reason.PINNED)


BASELINES = [
    PolicyName.LEAST_LOADED, PolicyName.PACK, PolicyName.RANDOM, PolicyName.STATIC, PolicyName.STATIC_LEAST_LOADED,
    PolicyName.STATIC_IN_TURN, PolicyName.STATIC_RANDOM, PolicyName.STATIC_PACK,
]  # fmt: skip
# These place beyond capacity by what they are: where an operator said so, or to lower a worse overload.
BEYOND_CAPACITY = (Reason.FIRST_PLACEMENT, Reason.PINNED, Reason.RELIEF)


@quick
@given(cases(), st.sampled_from(BASELINES), st.integers(0, 9))
def test_no_policy_breaks_feasibility(case: Case, name: PolicyName, seed: int) -> None:
    found = replace(case, policy=replace(case.policy, name=name, seed=seed, best_effort=False)).assign()
    for decision in found.decisions:
        if decision.verdict is Verdict.PLACED and decision.reason not in BEYOND_CAPACITY:
            chosen = next(entry for entry in decision.ranking if entry.host == decision.host)
            assert chosen.feasible
            assert not decision.overcommitted


@quick
@given(cases(), st.sampled_from([PolicyName.PACK, PolicyName.RANDOM]))
def test_what_fits_is_left_where_it_is(case: Case, name: PolicyName) -> None:
    """The plan after a perfect apply moves nothing that a rule or a shortage does not move."""
    first = replace(case, policy=replace(case.policy, name=name)).assign()
    snapshot, memory = simulate_apply(first, case.tasks, case.snapshot, case.memory)
    again = replace(case, policy=replace(case.policy, name=name), snapshot=snapshot, memory=memory).assign()
    moved = [task for task, host in hosts_by_task(again).items() if host != hosts_by_task(first)[task]]
    assert all(not _fitted(again, task) for task in moved)


def _fitted(assignment: Assignment, task: str) -> bool:
    decision = decisions_by_task(assignment)[task]
    return any(entry.feasible for entry in decision.ranking if entry.host == decision.previous_host)
