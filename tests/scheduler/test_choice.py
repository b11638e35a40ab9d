# SPDX-License-Identifier: Apache-2.0
"""Choice of a host: affinity, ties, and moves of running tasks."""

import pytest

from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task
from tests.builders import (
    GI,
    NOW,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)
from tests.scheduler.fleets import NO_MEMORY, decisions_by_task, hosts_by_task, ranking_by_host, run_assign

TWO = an_inventory(an_edge("edge1"), an_edge("edge2"))
THREE = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"))
CPU = Policy(weights=parse_weights("cpu"), min_dwell=0.0)


def decide_one(
    inventory: Inventory,
    task: Task,
    snapshot: Snapshot,
    memory: ManagerState = NO_MEMORY,
    policy: Policy = CPU,
    *others: Task,
) -> Decision:
    return decisions_by_task(
        run_assign(inventory, some_tasks(task, *others), snapshot, memory=memory, policy=policy)
    )[task.name]


def test_affinity_draws_a_successor_to_its_predecessor() -> None:
    snapshot = a_snapshot(edge1=a_sample(used=1.0, tasks={"slam": a_run()}), edge2=a_sample())
    decision = decide_one(TWO, a_task("nav", needs=["slam"]), snapshot, NO_MEMORY, Policy(), a_task("slam"))
    # edge1 (.75 + 1 + 1 + 1) / 4 = .9375; edge2 (1 + 1 + 1 + 0) / 4 = .75
    assert (decision.host, decision.reason, decision.subject) == ("edge1", Reason.WITH_PREDECESSOR, "slam")
    assert (decision.total, decision.lead) == pytest.approx((0.9375, 0.1875))
    assert {name: entry.affinity for name, entry in ranking_by_host(decision).items()} == {
        "edge1": 1,
        "edge2": -1,
    }


def test_placements_of_this_plan_draw_too() -> None:
    snapshot = a_snapshot(edge1=a_sample(used=1.0), edge2=a_sample())
    found = run_assign(
        TWO, some_tasks(a_task("slam", cpu=0.4), a_task("nav", needs=["slam"])), snapshot, policy=Policy()
    )
    assert hosts_by_task(found) == {"slam": "edge2", "nav": "edge2"}


def test_hosts_without_predecessor_share_a_rank() -> None:
    runs = {"edge1": "a", "edge2": "b"}
    samples = {host: a_sample(tasks={task: a_run()}) for host, task in runs.items()}
    snapshot = a_snapshot(samples, edge3=a_sample())
    decision = decide_one(
        THREE, a_task("c", needs=["a", "b"]), snapshot, NO_MEMORY, Policy(), a_task("a"), a_task("b")
    )
    # a(edge1) = a(edge2) = 1 - 1 = 0, a(edge3) = -2: m = 2, so 1, 1 and 0
    assert {
        name: (entry.affinity, entry.terms["task"]) for name, entry in ranking_by_host(decision).items()
    } == {
        "edge1": (0, 1.0),
        "edge2": (0, 1.0),
        "edge3": (-2, 0.0),
    }


def test_only_candidates_are_ranked_by_affinity() -> None:
    # slam is on edge1, which is cordoned: the two others are equal, so .5 each
    snapshot = a_snapshot(edge1=a_sample(tasks={"slam": a_run()}), edge2=a_sample(), edge3=a_sample())
    decision = decide_one(
        THREE,
        a_task("nav", needs=["slam"]),
        snapshot,
        ManagerState(cordons=frozenset({"edge1"})),
        Policy(),
        a_task("slam"),
    )
    assert [ranking_by_host(decision)[name].terms["task"] for name in ("edge1", "edge2", "edge3")] == [
        None,
        0.5,
        0.5,
    ]


def test_an_infeasible_candidate_still_counts_in_the_ranks() -> None:
    snapshot = a_snapshot(
        edge1=a_sample(used=4.0, tasks={"slam": a_run()}), edge2=a_sample(), edge3=a_sample()
    )
    decision = decide_one(
        THREE,
        a_task("nav", cpu=1.0, needs=["slam"]),
        snapshot,
        NO_MEMORY,
        Policy(),
        a_task("slam", pin="edge1"),
    )
    assert [ranking_by_host(decision)[name].terms["task"] for name in ("edge1", "edge2", "edge3")] == [
        1.0,
        0.0,
        0.0,
    ]
    assert decision.host == "edge2"


def test_ties_go_to_the_incumbent_then_the_emptiest_then_the_first_by_name() -> None:
    inventory = an_inventory(an_edge("edge10"), an_edge("edge2"))
    idle = a_snapshot(edge10=a_sample(), edge2=a_sample())
    tasks = some_tasks(a_task("a"), a_task("b"), a_task("c"))
    # zero demands: all totals are equal. a: natural order -> edge2; b: edge2 has one -> edge10; c: one each -> edge2
    assert hosts_by_task(run_assign(inventory, tasks, idle, policy=CPU)) == {
        "a": "edge2",
        "b": "edge10",
        "c": "edge2",
    }
    running = a_snapshot(edge10=a_sample(tasks={"a": a_run()}), edge2=a_sample())
    assert decide_one(inventory, a_task("a"), running).host == "edge10"


def test_equal_within_1e_9_is_a_tie() -> None:
    nearly = a_snapshot(edge1=a_sample(used=2e-9), edge2=a_sample())  # .5e-9 apart
    clearly = a_snapshot(edge1=a_sample(used=2e-8), edge2=a_sample())
    assert decide_one(TWO, a_task(), nearly).host == "edge1"
    assert [entry.rank for entry in decide_one(TWO, a_task(), nearly).ranking] == [1, 2]
    assert decide_one(TWO, a_task(), clearly).host == "edge2"


@pytest.mark.parametrize(
    ("used", "host", "reason"),
    [
        (
            0.40,
            "edge1",
            Reason.BELOW_MARGIN,
        ),  # edge1 (4 - .4) / 4 = .9, edge2 1: exactly the margin is not more
        (0.44, "edge2", Reason.GAIN),  # .89: gain .11
        (0.00, "edge1", Reason.STILL_BEST),
    ],
)
def test_the_margin_must_be_exceeded(used: float, host: str, reason: Reason) -> None:
    snapshot = a_snapshot(edge1=a_sample(used=used, tasks={"slam": a_run()}), edge2=a_sample())
    decision = decide_one(TWO, a_task(), snapshot)
    assert (decision.host, decision.reason, decision.previous_host, decision.challenger) == (
        host, reason, "edge1", "edge1" if host == "edge2" else "edge2",
    )  # fmt: skip
    assert decision.amount == pytest.approx({Reason.GAIN: 0.11, Reason.BELOW_MARGIN: 0.1}.get(reason))
    assert decision.verdict is (Verdict.PLACED if host == "edge2" else Verdict.KEPT)


@pytest.mark.parametrize(
    ("memory", "started_s_ago", "host", "left"),
    [
        (NO_MEMORY, 119.0, "edge1", 1.0),
        (NO_MEMORY, 120.0, "edge2", None),
        # the manager state knows the time of arrival; a restart in place does not reset it
        (ManagerState(placements={"slam": Placement(host="edge1", since=NOW - 500.0)}), 5.0, "edge2", None),
        (ManagerState(placements={"slam": Placement(host="edge1", since=NOW - 20.0)}), 500.0, "edge1", 100.0),
        # the manager state has a host that left the inventory: the start counts
        (ManagerState(placements={"slam": Placement(host="edge9", since=NOW - 500.0)}), 5.0, "edge1", 115.0),
    ],
)
def test_dwell(memory: ManagerState, started_s_ago: float, host: str, left: float | None) -> None:
    run = a_run(started_at=NOW - started_s_ago)
    snapshot = a_snapshot(edge1=a_sample(used=2.0, tasks={"slam": run}), edge2=a_sample())
    decision = decide_one(TWO, a_task(), snapshot, memory, Policy(weights=parse_weights("cpu")))
    assert decision.host == host
    if left is not None:
        assert decision.reason is Reason.DWELL
        assert decision.amount == pytest.approx(left)


@pytest.mark.parametrize(
    ("attended", "max_moves", "moved"),
    [(True, 1, 3), (False, 1, 1), (False, 2, 2), (False, None, 3), (False, 0, 0)],
)
def test_max_moves_acts_when_nobody_looks(attended: bool, max_moves: int | None, moved: int) -> None:
    inventory = an_inventory(*(an_edge(f"edge{n}") for n in range(1, 5)))
    runs = {name: a_run() for name in "abc"}
    snapshot = a_snapshot(
        edge1=a_sample(used=3.9, tasks=runs), edge2=a_sample(), edge3=a_sample(), edge4=a_sample()
    )
    policy = Policy(weights=parse_weights("cpu"), attended=attended, max_moves=max_moves)
    found = run_assign(
        inventory, some_tasks(*(a_task(name, cpu=1.0) for name in "abc")), snapshot, policy=policy
    )
    # nothing fits on edge1 any more, but slower is not dead: within max_moves
    assert sum(d.reason is Reason.FORCED_INFEASIBLE for d in found.decisions) == moved
    assert sum(d.reason is Reason.MAX_MOVES for d in found.decisions) == 3 - moved
    snapshot = a_snapshot(
        edge1=a_sample(used=2.0, tasks=runs), edge2=a_sample(), edge3=a_sample(), edge4=a_sample()
    )
    found = run_assign(
        inventory, some_tasks(*(a_task(name, cpu=0.01) for name in "abc")), snapshot, policy=policy
    )
    assert sum(d.reason is Reason.GAIN for d in found.decisions) == moved
    assert sum(d.reason is Reason.MAX_MOVES for d in found.decisions) == 3 - moved


@pytest.mark.parametrize("max_moves", [0, 1])
def test_a_task_that_runs_nowhere_is_placed_not_moved_in_a_later_pass(max_moves: int) -> None:
    """The first pass puts ``a`` on edge1, before ``b`` is pinned there; the second prefers edge2."""
    snapshot = a_snapshot(
        edge1=a_sample(used=0.1, tasks={"c": a_run(used=Usage(cpu=0.1))}),
        edge2=a_sample(used=0.2),
        edge3=a_sample(used=0.3),
    )
    tasks = some_tasks(a_task("a", cpu=0.2), a_task("b", cpu=3.0, pin="edge1"), a_task("c", cpu=0.1))
    policy = Policy(weights=parse_weights("cpu"), attended=False, max_moves=max_moves)
    found = run_assign(THREE, tasks, snapshot, policy=policy)
    by_task = decisions_by_task(found)
    first = by_task["a"]
    assert found.settled
    assert (first.host, first.previous_host, first.reason, first.amount) == ("edge2", None, Reason.BEST, None)
    assert by_task["c"].reason is (Reason.GAIN if max_moves else Reason.MAX_MOVES)


ON_EDGE1 = ManagerState(placements={"slam": Placement(host="edge1", since=NOW)})


@pytest.mark.parametrize(
    ("memory", "policy", "task", "reason"),
    [
        (ManagerState(draining=frozenset({"edge1"})), CPU, a_task(), Reason.FORCED_DRAIN),
        (
            NO_MEMORY,
            Policy(weights=parse_weights("cpu"), without=frozenset({"edge1"})),
            a_task(),
            Reason.FORCED_RULE,
        ),
        (ON_EDGE1, Policy(), a_task(never=["edge1"]), Reason.FORCED_RULE),
        (ON_EDGE1, Policy(), a_task(pin="edge2"), Reason.FORCED_RULE),
        (NO_MEMORY, Policy(max_moves=0, attended=False), a_task(memory=3 * GI), Reason.FORCED_INFEASIBLE),
    ],
)
def test_forced_moves_bypass_margin_dwell_and_max_moves(
    memory: ManagerState, policy: Policy, task: Task, reason: Reason
) -> None:
    snapshot = a_snapshot(
        edge1=a_sample(used=2.0, used_memory=2 * GI, tasks={"slam": a_run(started_at=NOW)}),
        edge2=a_sample(used=1.0),
    )
    decision = decide_one(TWO, task, snapshot, memory, policy)
    assert (decision.host, decision.previous_host, decision.reason, decision.subject) == (
        "edge2",
        "edge1",
        reason,
        "edge1",
    )


def test_a_host_that_is_left_out_counts_as_gone_for_what_may_run_nowhere_else() -> None:
    runs = {name: a_run(used=Usage(cpu=0.5)) for name in ("pinned", "slam")}
    snapshot = a_snapshot(edge1=a_sample(used=1.0, tasks=runs), edge2=a_sample())
    tasks = some_tasks(
        a_task("pinned", cpu=0.5, pin="edge1"), a_task("slam", cpu=0.5), a_task("z-new", needs=["pinned"])
    )
    policy = Policy(weights=parse_weights("cpu"), without=frozenset({"edge1"}))
    found = run_assign(TWO, tasks, snapshot, policy=policy)
    assert found.settled
    assert hosts_by_task(found) == {"pinned": None, "slam": "edge2", "z-new": None}
    by_task = decisions_by_task(found)
    assert by_task["pinned"].verdict is Verdict.UNPLACED
    assert (by_task["pinned"].reason, by_task["z-new"].reason) == (
        Reason.NO_CANDIDATE,
        Reason.PREDECESSOR_MISSING,
    )


@pytest.mark.parametrize("memory", [ManagerState(cordons=frozenset({"edge1"})), NO_MEMORY])
def test_a_cordon_or_an_old_sample_only_closes_to_new_work(memory: ManagerState) -> None:
    age = 0.0 if memory.cordons else 600.0
    snapshot = a_snapshot(edge1=a_sample(tasks={"slam": a_run()}, age=age), edge2=a_sample(used=2.0))
    found = run_assign(TWO, some_tasks(a_task("slam"), a_task("zoom")), snapshot, memory=memory, policy=CPU)
    assert hosts_by_task(found) == {"slam": "edge1", "zoom": "edge2"}


def test_a_drained_task_that_fits_nowhere_else_stays_with_its_total() -> None:
    snapshot = a_snapshot(
        edge1=a_sample(used=1.0, tasks={"slam": a_run(used=Usage(cpu=1.0))}), edge2=a_sample(used=3.5)
    )
    decision = decide_one(TWO, a_task(cpu=1.0), snapshot, ManagerState(draining=frozenset({"edge1"})))
    assert (decision.host, decision.reason) == ("edge1", Reason.NOTHING_FITS)
    assert decision.total == pytest.approx(0.75)
    assert not ranking_by_host(decision)["edge1"].feasible


@pytest.mark.parametrize(
    ("edges", "quiet", "frozen"),
    [(2, 1, False), (4, 2, False), (20, 11, False), (20, 12, True), (3, 2, True)],
)
def test_with_most_edges_silent_nothing_moves_but_starts_are_allowed(
    edges: int, quiet: int, frozen: bool
) -> None:
    # .55 x 20 = 11 unreachable is not more than 55 %, 12 is
    inventory = an_inventory(*(an_edge(f"edge{n}") for n in range(1, edges + 1)))
    answered = edges - quiet
    samples = {
        f"edge{n}": a_sample(used=3.0 if n == 1 else 0.0) if n <= answered else silent()
        for n in range(1, edges + 1)
    }
    samples["edge1"] = a_sample(used=3.0, tasks={"old": a_run()})
    found = run_assign(inventory, some_tasks(a_task("new"), a_task("old")), a_snapshot(samples), policy=CPU)
    assert found.frozen is frozen
    assert decisions_by_task(found)["new"].verdict is Verdict.PLACED
    if frozen:
        assert decisions_by_task(found)["old"].host == "edge1"


def test_frozen_says_so() -> None:
    inventory = an_inventory(*(an_edge(f"edge{n}") for n in range(1, 6)))
    for used in (3.0, 5.0):  # worth a move; not even feasible
        snapshot = a_snapshot(
            edge1=a_sample(used=used, tasks={"slam": a_run()}),
            edge2=a_sample(),
            edge3=silent(),
            edge4=silent(),
            edge5=silent(),
        )
        decision = decide_one(inventory, a_task(), snapshot)
        assert (decision.host, decision.reason) == ("edge1", Reason.MOVES_FROZEN)
