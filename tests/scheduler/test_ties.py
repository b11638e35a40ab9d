# SPDX-License-Identifier: Apache-2.0
"""Ties go to the greater free share; names decide between equal hosts only."""

from dataclasses import replace
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.config.weights import parse_weights
from edgectl.model.explanation import TieRule
from edgectl.model.policy import Policy
from edgectl.scheduler.explain import find_tie
from edgectl.scheduler.ties import choose_tied_place, order_tied_places
from tests.builders import a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import NO_MEMORY, hosts_by_task, run_assign, simulate_apply
from tests.scheduler.test_scan import a_view
from tests.scheduler.tight_fleets import TightFleet, build_random_fleet

SMALL_AND_LARGE = an_inventory(an_edge("edge1"), an_edge("edge2"))


@pytest.mark.parametrize("weights", ["network", "task"])
def test_weights_that_see_no_difference_send_tasks_where_more_is_free(weights: str) -> None:
    """Six tasks of 1 core: edge1 has 4 cores, edge2 64, where even the sixth leaves 58/64."""
    snapshot = a_snapshot(edge1=a_sample(), edge2=a_sample(cores=64.0))
    tasks = some_tasks(*(a_task(f"task{number}", cpu=1.0) for number in range(6)))
    found = run_assign(SMALL_AND_LARGE, tasks, snapshot, policy=Policy(weights=parse_weights(weights)))
    assert set(hosts_by_task(found).values()) == {"edge2"}
    tie = find_tie(found.decisions[0], ())
    assert tie is not None
    assert (tie.hosts, tie.rule) == (("edge1",), TieRule.FREE_SHARE)
    assert [entry.host for entry in found.decisions[0].ranking] == ["edge2", "edge1"]


def test_the_present_host_goes_before_the_freer_one() -> None:
    snapshot = a_snapshot(edge1=a_sample(tasks={"slam": a_run()}), edge2=a_sample(cores=64.0))
    policy = Policy(weights=parse_weights("network"), min_dwell=0.0, move_margin=0.0)
    assert hosts_by_task(
        run_assign(SMALL_AND_LARGE, some_tasks(a_task(cpu=1.0)), snapshot, policy=policy)
    ) == {"slam": "edge1"}


def rename_hosts(fleet: TightFleet, names: dict[str, str]) -> TightFleet:
    """``fleet`` with other names for its edges."""
    hosts = [replace(host, name=names.get(host.name, host.name)) for host in fleet.inventory.hosts.values()]
    samples = {names.get(name, name): sample for name, sample in fleet.snapshot.hosts.items()}
    placements = {
        task: replace(place, host=names.get(place.host, place.host))
        for task, place in fleet.memory.placements.items()
    }
    return replace(
        fleet,
        inventory=an_inventory(*hosts),
        snapshot=replace(fleet.snapshot, hosts=samples),
        memory=replace(fleet.memory, placements=placements),
    )


@settings(max_examples=max(5, settings().max_examples // 10))
@given(st.integers(0, 10_000), st.sampled_from([0.6, 0.8, 0.95]), st.randoms(use_true_random=False))
def test_other_names_of_hosts_change_nothing(seed: int, fill: float, dice: Random) -> None:
    """Also where tasks make room, and where tasks run already: no two of these hosts are equal."""
    fleet = build_random_fleet(4, 9, seed, fill)
    if seed % 2:
        snapshot, memory = simulate_apply(fleet.assign(), fleet.tasks, fleet.snapshot, NO_MEMORY)
        fleet = replace(
            fleet, snapshot=snapshot, memory=memory, policy=Policy(min_dwell=0.0, move_margin=0.02)
        )
    edges = [edge.name for edge in fleet.inventory.edges]
    names = dict(zip(edges, dice.sample(["a", "edge10", "edge2", "z"], 4), strict=True))
    plain, renamed = hosts_by_task(fleet.assign()), hosts_by_task(rename_hosts(fleet, names).assign())
    assert renamed == {task: names.get(host or "", host) for task, host in plain.items()}


@settings(max_examples=max(5, settings().max_examples // 10))
@given(st.integers(0, 10_000), st.randoms(use_true_random=False))
def test_other_names_of_tasks_change_nothing_where_priorities_order_them(seed: int, dice: Random) -> None:
    fleet = build_random_fleet(4, 10, seed, 0.9)
    ranked = [replace(task, priority=float(index)) for index, task in enumerate(fleet.tasks.tasks.values())]
    names = dict(
        zip((task.name for task in ranked), dice.sample([f"t{n}" for n in range(50)], 10), strict=True)
    )
    found = [
        hosts_by_task(replace(fleet, tasks=some_tasks(*tasks)).assign())
        for tasks in (ranked, [replace(task, name=names[task.name]) for task in ranked])
    ]
    assert found[1] == {names[task]: host for task, host in found[0].items()}


@given(st.integers(0, 50), st.sampled_from(["all", "network"]), st.randoms(use_true_random=False), st.data())
def test_the_place_that_is_chosen_is_the_first_in_order(
    seed: int, weights: str, dice: Random, data: st.DataObject
) -> None:
    view = a_view(seed)
    context = replace(view.context, policy=Policy(weights=parse_weights(weights)))
    tied = dice.sample(list(view.listed), dice.randint(2, len(view.listed)))
    placed = {place: dice.randint(1, 2) for place in tied if dice.random() < 0.7}
    incumbent = data.draw(st.sampled_from([None, tied[0], tied[-1]]))
    view = replace(view, context=context, placed=placed, incumbent=incumbent)
    order = order_tied_places(view, tied)
    assert choose_tied_place(view, tied) == order[0]
    for besides in tied:
        assert choose_tied_place(view, tied, besides) == next(place for place in order if place != besides)
