# SPDX-License-Identifier: Apache-2.0
"""Links that no placement can fill: without them tasks for different robots are alike (ADR 93). Pure."""

from collections.abc import Sequence
from dataclasses import replace

from edgectl.model.resource import HOST_RESOURCES
from edgectl.scheduler.packing import Shares
from edgectl.scheduler.placement_problem import PlacementItem, PlacementProblem

_HOST = range(len(HOST_RESOURCES))


def drop_slack_links(problem: PlacementProblem) -> PlacementProblem:
    """The same placements without the shares of links that no tasks with room on a host can fill.

    Not for sums of utilities, to which these links count.
    """
    slack = [_find_slack_links(problem, place) for place in range(len(problem.limits))]
    return replace(problem, items=[_drop_columns(item, slack) for item in problem.items])


def _drop_columns(item: PlacementItem, slack: Sequence[frozenset[int]]) -> PlacementItem:
    shares = {
        place: {column: share for column, share in row.items() if column not in slack[place]}
        for place, row in item.shares.items()
    }
    return replace(item, shares=shares, links=())


def _find_slack_links(problem: PlacementProblem, place: int) -> frozenset[int]:
    rows = [item.shares[place] for item in problem.items if place in item.shares]
    limits = problem.limits[place]
    links = {column for row in rows for column in row if column not in _HOST}
    return frozenset(
        link
        for link in links
        if min(_bound_load(rows, link, column, limits[column]) for column in _HOST) <= limits[link]
    )


def _bound_load(rows: Sequence[Shares], link: int, column: int, limit: float) -> float:
    """The most load on ``link`` by tasks that share ``limit`` of ``column``; of one perhaps a part."""
    left, load = max(0.0, limit), 0.0
    pairs = [(row.get(column, 0.0), row[link]) for row in rows if row.get(link, 0.0) > 0.0]
    for share, rate in sorted(pairs, key=lambda pair: pair[0] / pair[1]):
        if share > left:
            return load + rate * left / share
        left -= share
        load += rate
    return load
