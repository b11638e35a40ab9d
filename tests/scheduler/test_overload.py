# SPDX-License-Identifier: Apache-2.0
"""Moves forced by load: slack, dwell and max_moves (ADR 0061); fleets without room (ADR 0062)."""

from dataclasses import replace

import pytest

from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.policy import Policy
from edgectl.model.resource import CPU as CPU_RESOURCE
from edgectl.model.resource import MEMORY as MEMORY_RESOURCE
from edgectl.model.resource import Usage
from edgectl.rules.slack import compute_slack, estimate_noise
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
from tests.scheduler.closed_loop import ClosedLoop, build_saturated_loop, build_tight_loop
from tests.scheduler.fleets import NO_MEMORY, decisions_by_task, run_assign

TWO = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot())
CPU = Policy(weights=parse_weights("cpu"))
LONG_AGO, JUST_NOW = NOW - 3600.0, NOW - 30.0


def decide_slam(
    others: dict[str, float], demand: dict[str, float], since: float = LONG_AGO, policy: Policy = CPU
) -> Decision:
    """Return the decision on slam, which runs on edge1 beside ``others``; edge2 is idle.

    Of 4 cores, 4 GiB and 10 MB/s.
    """
    links = {"robot1": a_link(used=others.get("network", 0.0))}
    run = a_run(started_at=since)
    snapshot = a_snapshot(
        edge1=a_sample(
            used=others.get("cpu", 0.0),
            used_memory=others.get("memory", 0.0) * GI,
            links=links,
            tasks={"slam": run},
        ),
        edge2=a_sample(links={"robot1": a_link()}),
    )
    task = a_task(
        cpu=demand.get("cpu", 0.0),
        memory=demand.get("memory", 0.0) * GI,
        throughput=demand.get("network", 0.0),
        robots=["robot1"],
    )
    (decision,) = run_assign(TWO, some_tasks(task), snapshot, policy=policy).decisions
    return decision


TIGHT = Policy(move_margin=2.0)  # no gain is worth a move


@pytest.mark.parametrize(
    ("others", "demand", "since", "reason"),
    [
        # cpu (4 - 2.1 - 2) / 4 = -.025: within 5 %
        ({"cpu": 2.1}, {"cpu": 2.0}, LONG_AGO, Reason.BELOW_MARGIN),
        ({"cpu": 2.2}, {"cpu": 2.0}, LONG_AGO, Reason.BELOW_MARGIN),  # -.05: just within
        ({"cpu": 2.21}, {"cpu": 2.0}, LONG_AGO, Reason.FORCED_INFEASIBLE),
        ({"cpu": 2.21}, {"cpu": 2.0}, JUST_NOW, Reason.DWELL),
        ({"network": 5.5e6}, {"network": 5e6}, LONG_AGO, Reason.BELOW_MARGIN),
        ({"network": 5.6e6}, {"network": 5e6}, LONG_AGO, Reason.FORCED_INFEASIBLE),
        ({"network": 5.6e6}, {"network": 5e6}, JUST_NOW, Reason.DWELL),
        # memory (4 - 2.08 - 2) / 4 = -.02: just within; beyond it moves at once
        ({"memory": 2.08}, {"memory": 2.0}, LONG_AGO, Reason.BELOW_MARGIN),
        ({"memory": 2.09}, {"memory": 2.0}, JUST_NOW, Reason.FORCED_INFEASIBLE),
        # both short: the memory does not wait for the dwell of the cpu
        ({"cpu": 3.0, "memory": 2.09}, {"cpu": 2.0, "memory": 2.0}, JUST_NOW, Reason.FORCED_INFEASIBLE),
    ],
)
def test_slack_and_dwell(
    others: dict[str, float], demand: dict[str, float], since: float, reason: Reason
) -> None:
    decision = decide_slam(others, demand, since, TIGHT)
    assert decision.reason is reason
    assert decision.host == ("edge2" if reason is Reason.FORCED_INFEASIBLE else "edge1")
    assert decision.overcommitted == (decision.host == "edge1")


def test_within_the_slack_a_better_host_is_worth_a_move_as_always() -> None:
    # edge1 (4 - 2.1 - 2) / 4 = -.025, edge2 .5
    decision = decide_slam({"cpu": 2.1}, {"cpu": 2.0})
    assert (decision.host, decision.reason) == ("edge2", Reason.GAIN)
    assert decision.amount == pytest.approx(0.525)


def test_the_slack_is_for_what_runs_and_not_for_what_is_placed() -> None:
    snapshot = a_snapshot(edge1=a_sample(used=2.1), edge2=a_sample(used=4.0))
    (decision,) = run_assign(TWO, some_tasks(a_task(cpu=2.0)), snapshot).decisions
    assert decision.verdict is Verdict.UNPLACED


@pytest.mark.parametrize(
    ("used1", "used2", "demand", "margin", "reason"),
    [
        # edge1 stays at (4 - 4 - 1) / 4 = -.25; edge2 would be at (4 - 3.2 - 1) / 4 = -.05, edge1 then at 0
        (5.0, 3.2, 1.0, 0.1, Reason.RELIEF),
        (
            5.0,
            3.2,
            1.0,
            0.2,
            Reason.NOTHING_FITS,
        ),  # the worse of both improves by .2, no more than the margin
        (5.0, 3.8, 1.0, 0.1, Reason.NOTHING_FITS),  # -.25 against -.2: .05
        (9.0, 3.8, 1.0, 0.1, Reason.RELIEF),  # -1.25; then -1 there and -.2 here: .25
        (5.0, 4.0, 1.0, 0.0, Reason.NOTHING_FITS),  # the same on both
    ],
)
def test_without_room_a_move_must_lower_the_worst_overload(
    used1: float, used2: float, demand: float, margin: float, reason: Reason
) -> None:
    run = a_run(used=Usage(cpu=1.0))
    snapshot = a_snapshot(edge1=a_sample(used=used1, tasks={"slam": run}), edge2=a_sample(used=used2))
    policy = Policy(weights=parse_weights("cpu"), move_margin=margin)
    (decision,) = run_assign(TWO, some_tasks(a_task(cpu=demand)), snapshot, policy=policy).decisions
    assert decision.reason is reason
    assert decision.host == ("edge2" if reason is Reason.RELIEF else "edge1")


def test_relief_waits_for_the_dwell_and_counts_as_a_move() -> None:
    run = a_run(used=Usage(cpu=1.0), started_at=JUST_NOW)
    snapshot = a_snapshot(edge1=a_sample(used=5.0, tasks={"slam": run}), edge2=a_sample(used=3.2))
    tasks = some_tasks(a_task(cpu=1.0))
    assert run_assign(TWO, tasks, snapshot, policy=CPU).decisions[0].reason is Reason.DWELL
    rested = Policy(weights=parse_weights("cpu"), min_dwell=0.0, attended=False, max_moves=0)
    assert run_assign(TWO, tasks, snapshot, policy=rested).decisions[0].reason is Reason.MAX_MOVES


@pytest.mark.parametrize("resource", ["cpu", "memory", "network"])
@pytest.mark.parametrize(
    ("spare", "noise", "smooth", "most"),
    [
        (0.005, 0.02, False, 1),
        (0.005, 0.02, True, 0),
        (0.005, 0.05, True, 0),
        (0.025, 0.05, True, 0),
    ],
)
def test_a_task_that_just_fits_is_not_moved_to_and_fro(
    resource: str, spare: float, noise: float, smooth: bool, most: int
) -> None:
    """Both edges are filled but for ``spare`` of their capacity; the reading of the load of others is noisy.

    Memory has less slack, so readings off by 5 % are known to vary there after the first cycles.
    """
    loop = build_tight_loop(spare, noise, smooth=smooth, resource=resource, known=True)
    if resource == "memory" and noise > 0.02:
        loop.run(cycles=20)
        loop.moves = 0
    assert loop.run() <= most


def test_a_noisy_host_has_the_slack_of_its_own_noise() -> None:
    """Raw readings with a standard deviation of 5 % of the host, and a task that just fits: no move in an hour."""
    moves = {}
    for known, cycles in ((False, 60), (True, 360)):
        loop = ClosedLoop(
            {"slam": 0.5}, {"edge1": 0.495, "edge2": 0.495}, {"slam": "edge1"}, noise=0.05 * 3**0.5,
            smooth=False, known=known,
        )  # fmt: skip
        loop.run(cycles=20)  # until enough is measured
        loop.moves = 0
        moves[known] = loop.run(cycles)
    assert moves[False] > 0
    assert moves[True] == 0


def test_a_step_of_the_load_is_no_noise_and_the_slack_has_an_end() -> None:
    assert estimate_noise([0.5] * 15 + [0.9] * 15) == 0.0
    assert estimate_noise([0.1, 0.9] * 4) == 0.0  # too few
    assert compute_slack(CPU_RESOURCE, estimate_noise([0.1, 0.9] * 15)) == pytest.approx(0.15)
    assert (compute_slack(CPU_RESOURCE, 0.04), compute_slack(MEMORY_RESOURCE, 0.9)) == pytest.approx(
        (0.08, 0.06)
    )


@pytest.mark.parametrize(
    ("used", "cpu", "reason"),
    [
        (2.35, 0.05, Reason.BELOW_MARGIN),  # (4 - 2.35 - 2) / 4 = -.0875: twice the noise is .1
        (2.45, 0.05, Reason.FORCED_INFEASIBLE),  # -.1125
        (2.35, 0.02, Reason.FORCED_INFEASIBLE),  # twice the noise is less than 5 %
        (2.61, 0.5, Reason.FORCED_INFEASIBLE),  # -.1525: three times the slack is the end
    ],
)
def test_the_slack_is_twice_the_noise(used: float, cpu: float, reason: Reason) -> None:
    runs = {"slam": a_run(started_at=LONG_AGO)}
    snapshot = a_snapshot(edge1=a_sample(used=used, tasks=runs), edge2=a_sample())
    memory = replace(NO_MEMORY, noise={"edge1": {"cpu": cpu}})
    (decision,) = run_assign(
        TWO, some_tasks(a_task(cpu=2.0)), snapshot, memory=memory, policy=TIGHT
    ).decisions
    assert decision.reason is reason


def test_a_day_of_cron_moves_nothing_after_five_seconds_of_noise() -> None:
    """Every ten minutes, readings off by up to 10 %: half a second is too short, and 5 s are enough (ADR 74)."""
    moves = {}
    for readings in (1, 10):
        loop = ClosedLoop(
            {"slam": 0.5}, {"edge1": 0.495, "edge2": 0.495}, {"slam": "edge1"}, noise=0.1, smooth=False,
            every=600.0, readings=readings,
        )  # fmt: skip
        moves[readings] = loop.run(cycles=144)
    assert moves[1] > 5
    assert moves[10] == 0


@pytest.mark.parametrize("resource", ["cpu", "memory", "network"])
@pytest.mark.parametrize("smooth", [True, False])
def test_a_saturated_fleet_is_left_as_it_is(smooth: bool, resource: str) -> None:
    """All tasks use four times what they declare: every host is above its capacity, and no place is better."""
    assert build_saturated_loop(smooth=smooth, resource=resource).run(cycles=120) == 0


@pytest.mark.parametrize("resource", ["cpu", "memory", "network"])
def test_an_overload_that_a_move_relieves_is_relieved_once(resource: str) -> None:
    where = {"task1": "zeta", "task2": "zeta", "task3": "zeta", "task4": "beta"}
    base = dict.fromkeys(("zeta", "beta"), 0.3)
    loop = ClosedLoop(
        dict.fromkeys(where, 0.1), base, where, noise=0.02, smooth=True, use=4.0, resource=resource
    )
    assert loop.run(cycles=60) == 1
    assert sorted(loop.where.values()) == ["beta", "beta", "zeta", "zeta"]


def test_decisions_of_a_saturated_fleet_name_what_is_short() -> None:
    snapshot = a_snapshot(edge1=a_sample(used=5.0, tasks={"slam": a_run(used=Usage(cpu=2.0))}))
    found = decisions_by_task(
        run_assign(an_inventory(an_edge()), some_tasks(a_task(cpu=1.0)), snapshot, memory=NO_MEMORY)
    )["slam"]
    (rejection,) = found.ranking[0].rejections
    assert (found.reason, found.host) == (Reason.NOTHING_FITS, "edge1")
    assert (rejection.demand, rejection.used, rejection.capacity) == (2.0, 3.0, 4.0)
