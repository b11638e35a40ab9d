"""Notes of a plan on links that carry less than their nominal capacity, and on those that are partly seen."""

from dataclasses import replace

from edgectl.model.snapshot import CapacitySource
from edgectl.views.plan_sections import list_link_notes, list_partial_notes
from edgectl.views.snapshot import SnapshotView
from tests.builders import a_link, a_sample, a_snapshot

LIVE = replace(a_link(2e6), nominal=10e6, capacity_source=CapacitySource.TCP, capacity_age_s=3.0)


def test_a_plan_notes_slow_links_with_source_and_age_the_worst_first() -> None:
    worse = replace(LIVE, capacity_bytes_per_s=1e6, capacity_source=CapacitySource.PROBE)
    fine = replace(LIVE, capacity_bytes_per_s=9.5e6)
    links = {"robot1": LIVE, "robot2": a_link(), "robot3": fine, "robot4": worse}
    assert list_link_notes(a_snapshot(edge1=a_sample(links=links))) == [
        "link edge1 - robot4 carries 1.0MB/s (probe, 3.0s ago, nominal 10.0MB/s)",
        "link edge1 - robot1 carries 2.0MB/s (tcp, 3.0s ago, nominal 10.0MB/s)",
    ]


def test_many_slow_links_are_counted() -> None:
    slow = a_snapshot(edge1=a_sample(links={f"robot{number}": LIVE for number in range(5)}))
    assert list_link_notes(slow)[3:] == ["2 more links carry less than nominal: edgectl get links"]


def test_a_plan_and_a_probe_name_the_links_that_are_partly_seen() -> None:
    unseen = replace(a_link(), partial="udp unseen")
    snapshot = a_snapshot(
        edge1=a_sample(links={"robot1": unseen, "robot2": a_link()}), edge2=a_sample(links={"robot1": unseen})
    )
    assert list_partial_notes(snapshot) == [
        "partial: udp unseen on edge1 - robot1 and edge2 - robot1; the declared throughput stands there"
    ]
    assert SnapshotView(snapshot).table().count("(partial: udp unseen)") == 2
    assert SnapshotView(snapshot).wide().count("(partial: udp unseen)") == 4
