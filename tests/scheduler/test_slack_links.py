# SPDX-License-Identifier: Apache-2.0
"""Links that no tasks can fill are left out of programs, and only those."""

from itertools import combinations
from random import Random

from edgectl.model.policy import Weights
from edgectl.model.resource import HOST_RESOURCES
from edgectl.scheduler.placement_problem import PlacementItem, PlacementProblem, list_kinds
from edgectl.scheduler.slack_links import drop_slack_links

# The columns of links come after those of hosts.
LINKS = (len(HOST_RESOURCES), len(HOST_RESOURCES) + 1)


def build_problem(items: list[PlacementItem], limits: list[float]) -> PlacementProblem:
    return PlacementProblem(
        items=items, free=[limits], limits=[limits], edges=1, weights=Weights(), located={}
    )


def draw_item(dice: Random, number: int) -> PlacementItem:
    """A task with one link that uses up to half of two resources of a host, and of the link."""
    link = dice.choice(LINKS)
    shares = {0: dice.uniform(0.0, 0.5), 1: dice.uniform(0.0, 0.5), link: dice.uniform(0.0, 0.5)}
    return PlacementItem(name=f"task{number}", shares={0: shares}, links=[link])


def test_no_set_of_tasks_with_room_on_the_host_fills_a_link_that_is_dropped() -> None:
    dice, dropped, kept = Random(1), 0, 0
    for _ in range(60):
        items = [draw_item(dice, number) for number in range(6)]
        limits = [dice.uniform(0.3, 1.0) for _ in range(LINKS[-1] + 1)]
        loads = dict.fromkeys(LINKS, 0.0)
        for count in range(1, 7):
            for chosen in combinations([item.shares[0] for item in items], count):
                if all(sum(row[column] for row in chosen) <= limits[column] for column in (0, 1)):
                    for link in LINKS:
                        loads[link] = max(loads[link], sum(row.get(link, 0.0) for row in chosen))
        left = {
            column
            for item in drop_slack_links(build_problem(items, limits)).items
            for column in item.shares[0]
        }
        assert {0, 1} <= left
        for link in LINKS:
            assert link in left or loads[link] <= limits[link]
            dropped += link not in left
            kept += link in left
    assert dropped > 10 < kept


def test_tasks_for_different_robots_are_of_one_kind_where_links_are_wide() -> None:
    # Of memory 0.4 each two fit, which use 0.6 of both links together.
    items = [
        PlacementItem(name=name, shares={0: {0: 0.1, 1: share, link: 0.3}}, links=[link])
        for name, share, link in (("a", 0.4, LINKS[0]), ("b", 0.4 + 1e-15, LINKS[1]))
    ]
    wide, narrow = ([1.0] * len(HOST_RESOURCES) + [limit, limit] for limit in (0.7, 0.2))
    assert len(list_kinds(drop_slack_links(build_problem(items, wide)))) == 1
    assert len(list_kinds(drop_slack_links(build_problem(items, narrow)))) == 2
