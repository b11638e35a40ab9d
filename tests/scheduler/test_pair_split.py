# SPDX-License-Identifier: Apache-2.0
"""Changes that leave two sums in their ranges, against all sets of changes."""

from collections.abc import Sequence
from itertools import chain, combinations

from hypothesis import given
from hypothesis import strategies as st

from edgectl.scheduler.pair_split import MAX_OFFERS, Range, find_changes

# Whole numbers: sums in any order are the same.
numbers = st.integers(-9, 9)
lists = st.lists(st.tuples(numbers, numbers), max_size=9)


def list_sets(changes: Sequence[tuple[int, int]], first: Range, second: Range) -> list[tuple[int, ...]]:
    every = chain.from_iterable(combinations(range(len(changes)), count) for count in range(len(changes) + 1))
    return [
        each
        for each in every
        if first.least <= sum(changes[index][0] for index in each) <= first.most
        and second.least <= sum(changes[index][1] for index in each) <= second.most
    ]


@given(lists, numbers, st.integers(0, 3), numbers, st.integers(0, 3))
def test_it_finds_changes_where_there_are_any(
    changes: list[tuple[int, int]], least: int, width: int, other: int, other_width: int
) -> None:
    first = Range([change for change, _ in changes], least, least + width)
    second = Range([change for _, change in changes], other, other + other_width)
    sets = list_sets(changes, first, second)
    found = find_changes(first, second, lambda _: True)
    assert (found is not None) == bool(sets)
    if found is None:
        return
    assert tuple(found) in sets
    # What is refused is not offered again, and the search goes on up to its bound.
    offered: list[tuple[int, ...]] = []

    def refuse(chosen: Sequence[int]) -> bool:
        offered.append(tuple(chosen))
        return False

    assert find_changes(first, second, refuse) is None
    assert len(offered) == len(set(offered)) == min(len(sets), MAX_OFFERS)
    assert set(offered) <= set(sets)


def test_two_tasks_that_leave_and_one_that_comes() -> None:
    # A host lacks .7 cores and 1 GiB; the other has .8 and 1 free. To give (.5, 2) and (1, 1) away and to take
    # (.75, 2) is the only way.
    changes = [(-0.5, -2.0), (-1.0, -1.0), (0.75, 2.0), (0.25, 3.0)]
    first, second = Range([x for x, _ in changes], -0.8, -0.7), Range([y for _, y in changes], -1.0, -1.0)
    assert find_changes(first, second, lambda _: True) == [0, 1, 2]
    assert find_changes(second, first, lambda _: True) == [0, 1, 2]
    assert find_changes(first, second, lambda _: False) is None
