# SPDX-License-Identifier: Apache-2.0
"""Notes on tasks of other fleets."""

from dataclasses import replace

from edgectl.model.snapshot import OtherTask, TaskState
from edgectl.views.other_tasks import list_foreign_notes
from tests.builders import a_sample, a_snapshot


def a_foreign_task(task: str, fleet: str = "hall", started_by: str = "paula@laptop") -> OtherTask:
    return OtherTask(
        fleet=fleet, host="jetson", task=task, state=TaskState.RUNNING, started_by=started_by, instance=task
    )


def test_each_fleet_is_named_once_with_its_tasks_and_hosts() -> None:
    """Two names of one machine report the same tasks."""
    theirs = tuple(a_foreign_task(name) for name in ("slam", "web"))
    many = tuple(a_foreign_task(f"t{n}", fleet="", started_by="") for n in range(7))
    value = a_snapshot(
        {
            "edge1": replace(a_sample(), foreign_tasks=theirs),
            "edge2": replace(a_sample(), foreign_tasks=(*theirs, *many)),
            "edge3": a_sample(),
        }
    )
    assert list_foreign_notes(value) == [
        "edge2: an edgectl before fleets runs t0, t1, t2, t3, t4 and 2 more; it is left alone, and counts as load except on a slice",
        "edge1 and edge2: fleet hall (paula@laptop) runs slam and web; it is left alone, and counts as load except on a slice",
    ]
