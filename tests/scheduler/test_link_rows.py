# SPDX-License-Identifier: Apache-2.0
"""Links of all edges as rows: what they carry now and at best, and what a plan expects of them."""

from dataclasses import replace

import pytest

from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import LinkSample
from edgectl.scheduler.capacities import build_capacities
from edgectl.scheduler.ledger import build_measured_ledger
from tests.builders import a_link, a_robot, a_sample, a_snapshot, an_edge, an_inventory, silent
from tests.scheduler.test_scan import a_view

# In bytes/s: what an edge shows of its link to the robot, and what is declared; then now, and at best.
CASES = [
    pytest.param(a_link(8e6), None, (8e6, 8e6), id="as measured"),
    pytest.param(replace(a_link(4e6), nominal=10e6), None, (4e6, 10e6), id="below the nominal rate"),
    pytest.param(a_link(8e6), 5e6, (5e6, 5e6), id="declared"),
    pytest.param(replace(a_link(4e6), nominal=10e6), 5e6, (4e6, 5e6), id="declared, and less now"),
    pytest.param(replace(a_link(8e6), nominal=10e6), 5e6, (5e6, 5e6), id="declared, and more now"),
    pytest.param(a_link(0.0), 5e6, (0.0, 0.0), id="down"),
    pytest.param(None, 5e6, (None, None), id="not shown"),
]


@pytest.mark.parametrize(("link", "declared", "expected"), CASES)
@pytest.mark.parametrize("alone", [True, False])
def test_what_a_link_carries_now_and_at_best(
    link: LinkSample | None,
    declared: float | None,
    expected: tuple[float | None, float | None],
    alone: bool,
) -> None:
    """``alone``: no other edge has a link of another kind, so that the whole row may be read at once."""
    other = a_link(9e6) if alone else replace(a_link(3e6), nominal=9e6)
    inventory = an_inventory(
        *(an_edge(name) for name in ("edge3", "edge2", "edge1")),
        a_robot("robot2"),
        a_robot("robot1"),
        links={} if declared is None else {("edge2", "robot1"): declared},
    )
    snapshot = a_snapshot(
        edge1=a_sample(links={"robot1": other, "robot2": a_link(1e6)}),
        edge2=a_sample(links={} if link is None else {"robot1": link}),
        edge3=silent(),
    )
    fleet = build_capacities(inventory, snapshot, ManagerState(), frozenset())
    others = (9e6, 9e6) if alone else (3e6, 9e6)
    assert fleet.links["robot1"] == (others[0], expected[0], None)
    assert fleet.nominal_links["robot1"] == (others[1], expected[1], None)
    assert fleet.links["robot2"] == fleet.nominal_links["robot2"] == (1e6, None, None)


def test_expected_loads_name_the_links_that_an_edge_has() -> None:
    linked = set()
    for seed in range(10):
        fleet = a_view(seed).context.fleet
        ledger = build_measured_ledger(fleet)
        found = ledger.expected(())
        assert list(found) == sorted(found, key=lambda name: fleet.order[fleet.index[name]])
        for name, load in found.items():
            place = fleet.index[name]
            assert load.used == {each: row[place] for each, row in ledger.used.items()} | {"network": 0.0}
            assert load.links == {
                robot: row[place]
                for robot, row in ledger.links.items()
                if fleet.links[robot][place] is not None
            }
            linked.add(tuple(load.links))
    assert linked == {("robot1",), ("robot2",), ("robot1", "robot2")}


def test_a_fleet_without_robots_has_no_links() -> None:
    inventory = an_inventory(an_edge("edge2"), an_edge("edge1"))
    fleet = build_capacities(
        inventory, a_snapshot(edge1=a_sample(used=1.0), edge2=a_sample()), ManagerState(), frozenset()
    )
    found = build_measured_ledger(fleet).expected(())
    assert {name: (load.used["cpu"], load.links) for name, load in found.items()} == {
        "edge1": (1.0, {}),
        "edge2": (0.0, {}),
    }
