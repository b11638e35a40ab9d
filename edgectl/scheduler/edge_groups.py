# SPDX-License-Identifier: Apache-2.0
"""Groups of edges that are alike, so that what depends on an edge is computed once for each group."""

from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from typing import Any, NamedTuple


class EdgeGroups(NamedTuple):
    """``first``: one edge of each group. ``expand``: a value for each edge, from one for each group."""

    first: tuple[int, ...]
    expand: Callable[[Sequence[float]], Sequence[float]]


def group_edges(columns: Iterable[Sequence[object]], edges: int) -> EdgeGroups:
    """The edges 0 .. ``edges`` - 1, in one group where all ``columns`` have the same values."""
    keys = list(zip(*(column[:edges] for column in columns), strict=True))
    first: dict[Any, int] = {}
    for edge, key in enumerate(keys):
        first.setdefault(key, edge)
    numbers = {key: number for number, key in enumerate(first)}
    index = [numbers[key] for key in keys]
    # An itemgetter of one index gives the value itself; a group of its own for each edge needs none.
    expand = tuple if len(first) == edges else itemgetter(*index)
    return EdgeGroups(tuple(first.values()), expand)
