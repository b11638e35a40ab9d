# SPDX-License-Identifier: Apache-2.0
"""Notes of a plan on links that carry less than their nominal capacity, and on those that are partly seen."""

from dataclasses import replace

from edgectl.cli.exit_codes import of_status
from edgectl.errors import ExitCode
from edgectl.model.snapshot import CapacitySource
from edgectl.rules.cut_off import list_cut_off_tasks
from edgectl.views.describe_host import HostDetailsView
from edgectl.views.describe_task import TaskDetailsView
from edgectl.views.plan_sections import list_down_link_notes, list_link_notes, list_partial_notes
from edgectl.views.snapshot import SnapshotView
from edgectl.views.status import StatusView
from tests.builders import (
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)

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


def test_a_link_that_is_down_is_noted_where_the_robot_answers_the_manager() -> None:
    links = {"robot1": a_link(0.0), "robot2": a_link(0.0), "robot3": a_link()}
    snapshot = a_snapshot(edge1=a_sample(links=links), robot1=a_sample(), robot2=silent(), robot3=a_sample())
    assert list_down_link_notes(snapshot) == ["link down, no task of the robot can run there: edge1 - robot1"]
    tasks = some_tasks(a_task("slam", robots=("robot1",)), a_task("map", robots=("robot3",)))
    runs = {"slam": a_run(), "map": a_run()}
    seen = replace(snapshot, hosts={**snapshot.hosts, "edge1": a_sample(links=links, tasks=runs)})
    assert list(list_cut_off_tasks(tasks, seen)) == [("slam", "edge1", "robot1")]
    whole = replace(seen, hosts={**seen.hosts, "edge1": a_sample(links={"robot3": a_link()}, tasks=runs)})
    fleet = an_inventory(an_edge("edge1"), *map(a_robot, ("robot1", "robot2", "robot3")))
    assert (
        StatusView(seen, fleet, tasks)
        .table()
        .splitlines()[2]
        .startswith("slam on edge1 is cut off from robot1: the link is down")
    )
    rows = {
        state: {row["task"]: row.get("cut_off_from") for row in StatusView(each, fleet, tasks).items()}
        for state, each in (("down", seen), ("whole", whole))
    }
    assert rows == {"down": {"slam": ["robot1"], "map": None}, "whole": {"slam": None, "map": None}}
    answering = replace(fleet, hosts={name: fleet.hosts[name] for name in ("edge1", "robot1", "robot3")})
    assert of_status(seen, answering, tasks) is ExitCode.PARTLY
    assert of_status(whole, answering, tasks) is ExitCode.DONE


def test_details_of_a_host_and_of_a_task_say_what_traffic_lacks() -> None:
    unseen = replace(a_link(used=1e6), partial="udp unseen")
    run = replace(a_run(), partial="udp unseen")
    snapshot = a_snapshot(edge1=a_sample(links={"robot1": unseen}, tasks={"slam": run}))
    fleet, tasks = an_inventory(an_edge("edge1"), a_robot("robot1")), some_tasks(a_task("slam"))
    host = HostDetailsView("edge1", snapshot, fleet, tasks, None).table()
    assert "1.0MB/s (partial: udp unseen) of 10.0MB/s" in host
    assert host.count("(partial: udp unseen)") == 2
    assert "(partial: udp unseen)" in TaskDetailsView("slam", snapshot, fleet, tasks, None, None).table()
