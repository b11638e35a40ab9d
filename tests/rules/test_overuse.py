# SPDX-License-Identifier: Apache-2.0
"""Tasks that use more than they declare."""

import pytest

from edgectl.model.demand import Quantity
from edgectl.model.resource import Usage
from edgectl.rules.overuse import find_overuses
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
    some_tasks,
)

FLEET = an_inventory(an_edge(), a_robot())


@pytest.mark.parametrize(
    ("declared", "used", "age_s", "found"),
    [
        (0.30, 1.20, 3600.0, [(0.30, 1.20)]),
        (0.30, 1.20, 5.0, []),  # it starts up
        (1.00, 1.20, 3600.0, []),  # no more than 1.2 times
        (1.00, 1.21, 3600.0, [(1.00, 1.21)]),
        (0.05, 0.12, 3600.0, []),  # 2 % of 4 cores are .08
        ("10%", 1.0, 3600.0, [(0.40, 1.0)]),
        (0.0, 1.0, 3600.0, [(0.0, 1.0)]),
        (None, 1.0, 3600.0, []),  # nothing is declared
        (Quantity(value=0.3, measured=True), 1.0, 3600.0, []),
    ],
)
def test_what_counts_as_overuse(
    declared: float | str | Quantity | None, used: float, age_s: float, found: list[tuple[float, float]]
) -> None:
    run = a_run(used=Usage(cpu=used), started_at=NOW - age_s)
    snapshot = a_snapshot(edge1=a_sample(used=used, tasks={"slam": run, "stranger": run}))
    overuses = find_overuses(FLEET, some_tasks(a_task(cpu=declared)), snapshot)
    assert [round(each.declared, 9) for each in overuses] == [declares for declares, _ in found]
    assert [each.used for each in overuses] == [uses for _, uses in found]


def test_a_link_is_told_with_its_figures_and_the_remedy() -> None:
    run = a_run(used=Usage(network=5e6), links={"robot1": 5e6})
    snapshot = a_snapshot(edge1=a_sample(links={"robot1": a_link()}, tasks={"slam-robot1": run}))
    task = a_task("slam-robot1", throughput=1e6, robots=["robot1"], template="slam")
    (found,) = find_overuses(FLEET, some_tasks(task), snapshot)
    assert found.describe() == "uses 5.0MB/s of network, declares 1.0MB/s; edgectl profile slam --write"


@pytest.mark.parametrize(("used", "count"), [(0.05, 0), (0.06, 1)])
def test_a_few_clock_ticks_on_a_small_host_are_noise(used: float, count: int) -> None:
    sample = a_sample(cores=0.3, tasks={"slam": a_run(used=Usage(cpu=used))})
    found = find_overuses(FLEET, some_tasks(a_task(cpu=0.003)), a_snapshot(edge1=sample))
    assert len(found) == count
