# SPDX-License-Identifier: Apache-2.0
"""Which changes to make so that two sums end in their ranges: a search from both ends (ADR 175). Pure."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from functools import cache
from math import inf
from typing import NamedTuple

# Changes that one search may choose from: more have too many sums.
MAX_CHANGES = 16
# Sets of changes that are offered, where those before were refused.
MAX_OFFERS = 8


class Range(NamedTuple):
    """What each change adds to one sum, and where that sum may end."""

    changes: Sequence[float]
    least: float
    most: float


def find_changes(
    first: Range, second: Range, accepts: Callable[[Sequence[int]], bool]
) -> Sequence[int] | None:
    """The indexes of changes that leave both sums in their ranges, and that ``accepts`` takes; None if none
    are found.

    Those with few of the first half of the changes come first. ``first`` should be the narrower range: its
    sums are sorted.
    """
    changes, least, most = first
    other_changes, other_least, other_most = second
    half = len(changes) // 2
    sums, other_sums = _list_sums(changes[:half]), _list_sums(other_changes[:half])
    rest_sums, other_rest_sums = _list_sums(changes[half:]), _list_sums(other_changes[half:])
    rest = sorted(zip(rest_sums, other_rest_sums, range(len(rest_sums)), strict=True))
    keys = [*[key for key, _, _ in rest], inf]
    offers = 0
    for mask in _list_masks(half):
        known = sums[mask]
        start = bisect_left(keys, least - known)
        if keys[start] > most - known:
            continue
        stop = bisect_right(keys, most - known, start)
        known = other_sums[mask]
        for _, value, others in rest[start:stop]:
            if other_least <= known + value <= other_most:
                chosen = mask | others << half
                found = [index for index in range(len(changes)) if chosen >> index & 1]
                if accepts(found):
                    return found
                offers += 1
                if offers >= MAX_OFFERS:
                    return None
    return None


def _list_sums(changes: Sequence[float]) -> list[float]:
    """The sums of all sets of ``changes``: of that whose bits make up the index."""
    sums = [0.0]
    for change in changes:
        sums += [each + change for each in sums]
    return sums


@cache
def _list_masks(bits: int) -> list[int]:
    """All sets of so many ``bits``, the smallest first."""
    return sorted(range(1 << bits), key=int.bit_count)
