# SPDX-License-Identifier: Apache-2.0
"""The other schemes: paper, static, local (ADR 0015)."""

from dataclasses import replace

import pytest

from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Reason, Verdict
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.resource import Usage
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import OnboardRule, Task
from tests.builders import (
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
from tests.scheduler.fleets import (
    NO_MEMORY,
    decisions_by_task,
    hosts_by_task,
    list_terms,
    ranking_by_host,
    run_assign,
)

TWO = an_inventory(an_edge("edge1"), an_edge("edge2"))
LINKS = {"robot1": a_link(), "robot2": a_link()}


def a_policy(name: str, weights: str = "all") -> Policy:
    return Policy(name=PolicyName(name), weights=parse_weights(weights))


# --- paper


def test_paper_counts_a_running_task_twice_and_so_hops() -> None:
    snapshot = a_snapshot(
        edge1=a_sample(used=1.0, tasks={"slam": a_run(used=Usage(cpu=1.0))}), edge2=a_sample(used=0.2)
    )
    found = run_assign(TWO, some_tasks(a_task(cpu=1.0)), snapshot, policy=a_policy("paper", "cpu"))
    # gross: edge1 (4 - 1 - 1) / 4 = .5, edge2 (4 - .2 - 1) / 4 = .7
    assert [entry.terms["cpu"] for entry in found.decisions[0].ranking] == pytest.approx([0.7, 0.5])
    assert (found.decisions[0].host, found.decisions[0].previous_host, found.settled) == (
        "edge2",
        "edge1",
        False,
    )
    assert hosts_by_task(
        run_assign(TWO, some_tasks(a_task(cpu=1.0)), snapshot, policy=a_policy("utility", "cpu"))
    ) == {"slam": "edge1"}


@pytest.mark.parametrize("others", [1, 2])
def test_paper_follows_a_predecessor_to_where_nothing_fits(others: int) -> None:
    """cpu (4 - 3.9 - .5)/4 = -.1 and the reward 1 outweigh cpu .875 and the reward -1 on any other edge."""
    edges = [f"edge{number}" for number in range(1, others + 2)]
    full = a_sample(used=3.9, tasks={"slam": a_run()})
    world = a_snapshot({edge: a_sample() for edge in edges[1:]}, edge1=full)
    tasks = some_tasks(a_task("nav", cpu=0.5, needs=["slam"]), a_task("slam", managed=False))
    nav = decisions_by_task(
        run_assign(an_inventory(*map(an_edge, edges)), tasks, world, policy=a_policy("paper"))
    )["nav"]
    assert (nav.host, nav.reason, nav.subject, nav.overcommitted) == (
        "edge1",
        Reason.WITH_PREDECESSOR,
        "slam",
        True,
    )


def test_paper_rewards_only_what_already_runs_with_plus_and_minus_one() -> None:
    tasks = some_tasks(a_task("nav", needs=["slam"]), a_task("slam"))
    cold = run_assign(TWO, tasks, a_snapshot(edge1=a_sample(), edge2=a_sample()), policy=a_policy("paper"))
    assert {entry.terms["task"] for entry in decisions_by_task(cold)["nav"].ranking} == {-1.0}
    warm = run_assign(
        TWO,
        tasks,
        a_snapshot(edge1=a_sample(), edge2=a_sample(tasks={"slam": a_run()})),
        policy=a_policy("paper"),
    )
    nav = decisions_by_task(warm)["nav"]
    # the predecessor is on edge2: (1 + 1 + 1 + 1) / 4 there, (1 + 1 + 1 - 1) / 4 on edge1
    assert list_terms(ranking_by_host(nav)["edge2"]) == pytest.approx((1.0, 1.0, 1.0, 1.0, 1.0))
    assert list_terms(ranking_by_host(nav)["edge1"]) == pytest.approx((1.0, 1.0, 1.0, -1.0, 0.5))
    assert nav.host == "edge2"


def test_paper_has_no_feasibility_and_no_margin() -> None:
    snapshot = a_snapshot(edge1=a_sample(), edge2=a_sample(used=1.0))
    decision = run_assign(TWO, some_tasks(a_task(cpu=9.0)), snapshot, policy=a_policy("paper")).decisions[0]
    assert (decision.host, decision.overcommitted, decision.ranking[0].feasible) == ("edge1", True, False)
    close = a_snapshot(edge1=a_sample(used=0.01, tasks={"slam": a_run()}), edge2=a_sample())
    assert run_assign(TWO, some_tasks(a_task()), close, policy=a_policy("paper")).decisions[0].host == "edge2"


def test_paper_keeps_what_is_proposed_where_it_runs() -> None:
    snapshot = a_snapshot(edge1=a_sample(), edge2=a_sample(used=1.0))
    running = a_snapshot(edge1=a_sample(tasks={"slam": a_run()}), edge2=a_sample(used=1.0))
    tasks = some_tasks(a_task())
    assert run_assign(TWO, tasks, snapshot, policy=a_policy("paper")).decisions[0].verdict is Verdict.PLACED
    assert run_assign(TWO, tasks, running, policy=a_policy("paper")).decisions[0].verdict is Verdict.KEPT


def test_paper_never_offers_the_robot_and_still_needs_an_edge() -> None:
    inventory = an_inventory(an_edge(), a_robot(onboard=True))
    task = a_task(robots=["robot1"])
    busy = a_snapshot(edge1=a_sample(used=3.9, links=LINKS), robot1=a_sample())
    assert hosts_by_task(run_assign(inventory, some_tasks(task), busy, policy=a_policy("paper"))) == {
        "slam": "edge1"
    }
    lost = a_snapshot(edge1=silent(), robot1=a_sample())
    decision = run_assign(inventory, some_tasks(task), lost, policy=a_policy("paper")).decisions[0]
    assert (decision.verdict, decision.reason) == (Verdict.UNPLACED, Reason.NO_CANDIDATE)


# --- static


@pytest.mark.parametrize(
    ("task", "memory", "snapshot", "host", "reason"),
    [
        # first placement ever: by utility
        (a_task(cpu=1.0), NO_MEMORY, a_snapshot(edge1=a_sample(used=2.0), edge2=a_sample()), "edge2", Reason.BEST),
        # later: on its first host, whatever the load, even beyond capacity
        (a_task(cpu=1.0), ManagerState(first={"slam": "edge1"}), a_snapshot(edge1=a_sample(used=3.9), edge2=a_sample()), "edge1",
         Reason.FIRST_PLACEMENT),
        (a_task(pin="edge1"), ManagerState(first={"slam": "edge2"}), a_snapshot(edge1=a_sample(used=2.0), edge2=a_sample()), "edge1", Reason.PINNED),
        # running: never moved, neither by load nor by a drain
        (a_task(), ManagerState(draining=frozenset({"edge1"})), a_snapshot(edge1=a_sample(used=3.9, tasks={"slam": a_run()}), edge2=a_sample()),
         "edge1", Reason.NEVER_MOVED),
        # its first host is unreachable: the task waits for it
        (a_task(), ManagerState(first={"slam": "edge1"}), a_snapshot(edge1=silent(), edge2=a_sample()), None, Reason.NO_CANDIDATE),
        # its first host has left the inventory: a first placement again
        (a_task(), ManagerState(first={"slam": "old"}), a_snapshot(edge1=a_sample(), edge2=a_sample()), "edge1", Reason.BEST),
    ],
)  # fmt: skip
def test_static(
    task: Task, memory: ManagerState, snapshot: Snapshot, host: str | None, reason: Reason
) -> None:
    found = run_assign(TWO, some_tasks(task), snapshot, memory=memory, policy=a_policy("static"))
    assert (found.decisions[0].host, found.decisions[0].reason, found.settled) == (host, reason, True)
    assert found.decisions[0].overcommitted == (
        task.demand["cpu"] is not None and reason is Reason.FIRST_PLACEMENT
    )


GONE = ManagerState(
    managed=True,
    placements={"slam": Placement(host="edge1", since=NOW)},
    first={"slam": "edge1"},
    fenced=frozenset({"edge1"}),
)
RETURNED = a_snapshot(edge1=a_sample(), edge2=a_sample(used=3.9, tasks={"slam": a_run()}))


def test_static_replaces_on_the_best_other_host_and_stays_there() -> None:
    silent_first = a_snapshot(edge1=silent(), edge2=a_sample())
    found = run_assign(
        TWO, some_tasks(a_task()), silent_first, memory=GONE, policy=a_policy("static")
    ).decisions[0]
    assert (found.host, found.reason, found.previous_host) == ("edge2", Reason.REPLACED, "edge1")
    moved = replace(GONE, placements={"slam": Placement(host="edge2", since=NOW)})
    back = run_assign(TWO, some_tasks(a_task()), RETURNED, memory=moved, policy=a_policy("static")).decisions[
        0
    ]
    assert (back.host, back.reason) == ("edge2", Reason.NEVER_MOVED)


def test_static_does_not_replace_what_is_pinned_to_the_silent_host() -> None:
    silent_pin = a_snapshot(edge1=silent(), edge2=a_sample())
    found = run_assign(
        TWO, some_tasks(a_task(pin="edge1")), silent_pin, memory=GONE, policy=a_policy("static")
    ).decisions[0]
    assert (found.verdict, found.reason) == (Verdict.UNPLACED, Reason.NO_CANDIDATE)


# --- local


def test_local_puts_everything_on_its_first_robot() -> None:
    inventory = an_inventory(an_edge(), a_robot("robot1"), a_robot("robot2", onboard=True))
    tasks = some_tasks(
        a_task("a", cpu=5.0, robots=["robot1"]),
        a_task("b", cpu=1.0, robots=["robot2", "robot1"], needs=["a"]),
        a_task("c", cpu=1.0, robots=["robot2"], onboard=OnboardRule.NEVER),
        a_task("d"),
    )
    snapshot = a_snapshot(
        edge1=a_sample(links=LINKS, tasks={"b": a_run()}), robot1=a_sample(), robot2=a_sample()
    )
    found = run_assign(inventory, tasks, snapshot, policy=a_policy("local"))
    assert hosts_by_task(found) == {"a": "robot1", "b": "robot2", "c": "robot2", "d": None}
    a, b, d = (decisions_by_task(found)[name] for name in "abd")
    assert (a.reason, a.overcommitted, b.previous_host, b.reason) == (
        Reason.ONBOARD_LOCAL,
        True,
        "edge1",
        Reason.ONBOARD_LOCAL,
    )
    assert (d.verdict, d.reason) == (Verdict.UNPLACED, Reason.NO_CANDIDATE)
    assert {name: load.used["cpu"] for name, load in found.expected.items()} == {
        "edge1": 0.0,
        "robot1": 5.0,
        "robot2": 2.0,
    }
    assert found.settled


def test_local_without_a_robot_to_run_on() -> None:
    inventory = an_inventory(an_edge(), a_robot(probe=False))
    tasks = some_tasks(a_task("a", robots=["robot1"]), a_task("b", robots=["robot1"]), a_task("c"))
    snapshot = a_snapshot(edge1=a_sample(links=LINKS, tasks={"b": a_run(), "c": a_run()}))
    found = run_assign(inventory, tasks, snapshot, policy=a_policy("local"))
    assert hosts_by_task(found) == {"a": None, "b": "edge1", "c": "edge1"}
    assert decisions_by_task(found)["b"].reason is Reason.NOTHING_FITS


def test_local_does_not_move_when_moves_are_frozen() -> None:
    inventory = an_inventory(*(an_edge(f"edge{n}") for n in (1, 2, 3)), a_robot())
    snapshot = a_snapshot(
        edge1=a_sample(links=LINKS, tasks={"a": a_run()}), edge2=silent(), edge3=silent(), robot1=a_sample()
    )
    found = run_assign(
        inventory, some_tasks(a_task("a", robots=["robot1"])), snapshot, policy=a_policy("local")
    )
    assert (found.decisions[0].host, found.decisions[0].reason) == ("edge1", Reason.MOVES_FROZEN)
