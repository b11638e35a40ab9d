# SPDX-License-Identifier: Apache-2.0
"""A decided plan as a packing: shares by column are those by place, and a search finds the same with both."""

from math import inf
from random import Random

import pytest

from edgectl.scheduler.decided_plan import DecidedPlan
from edgectl.scheduler.initial_state import InitialState
from edgectl.scheduler.ledger import compute_demand_usage
from edgectl.scheduler.packed_plan import build_item, build_packing, build_plan_frame
from edgectl.scheduler.packing import (
    Item,
    Packing,
    ShareTable,
    find_place,
    fits,
    list_lacks,
    list_sufficient,
)
from tests.scheduler.test_scan import a_view


def build_view(seed: int, *, placed: bool) -> tuple[Packing, Item]:
    """The packing of one task in a fleet with every anomaly that an edge can have, and its item."""
    view = a_view(seed)
    task, fleet = view.task, view.context.fleet
    allowed = [place for place in view.listed if place not in view.denied]
    here = Random(seed).choice(allowed)
    use = compute_demand_usage(fleet, task, here)
    ledger = view.ledger.copy()
    if placed:
        ledger.charge(here, use)
    plan = DecidedPlan(
        context=view.context,
        order=[task],
        initial=InitialState(ledger=view.ledger, running={}, located={}, completed=frozenset(), fixed={}),
        choices={},
        placed={task.name: (here, use)} if placed else {},
        ledger=ledger,
    )
    frame = build_plan_frame(plan, {})
    packing = build_packing(frame)
    return packing, packing.items[task.name] if placed else build_item(frame, task)


@pytest.mark.parametrize("placed", [False, True])
def test_shares_by_column_are_those_by_place(placed: bool) -> None:
    seen = 0
    for seed in range(60):
        packing, item = build_view(seed, placed=placed)
        if item.shares.columns is None:
            continue  # it was measured to use a link that its robots do not say
        seen += 1
        columns = dict(item.shares.columns)
        for place in item.places:
            shares = item.shares[place]
            if inf in shares.values():
                assert inf in [row[place] for row in columns.values()]
                continue
            assert {column: row[place] for column, row in columns.items()} == {
                column: share for column, share in shares.items() if column in columns
            }
            left_out = shares.keys() - columns.keys()
            assert all(shares[column] == 0.0 and packing.free[place][column] == 1.0 for column in left_out)
    assert seen > 20


@pytest.mark.parametrize("placed", [False, True])
def test_a_search_finds_the_same_by_column_and_by_place(placed: bool) -> None:
    places = set()
    for seed in range(60):
        packing, item = build_view(seed, placed=placed)
        plain = item._replace(shares=ShareTable(item.shares.__getitem__))
        assert find_place(packing, item) == find_place(packing, plain)
        assert find_place(packing, item, item.places[:2]) == find_place(packing, plain, item.places[:2])
        places.add(find_place(packing, item))
        for place in item.places:
            assert fits(packing, item, place) == fits(packing, plain, place)
            names = [*packing.on[place]]
            sufficient = list_sufficient(packing, item, place, names)
            assert sufficient == list_sufficient(packing, plain, place, names)
            lacks = list_lacks(packing, plain, place)
            assert inf in dict(lacks).values() or list_lacks(packing, item, place) == lacks
    assert None in places
    assert len(places) > 5
