"""A person reads words where a program is told a code or a sign."""

from dataclasses import replace

from edgectl.formats.event_document import encode_event
from edgectl.model.event import Event, EventKind
from edgectl.model.snapshot import DeviceSample
from edgectl.views import events
from edgectl.views.describe_host import HostDetailsView
from tests.builders import NOW, a_sample, a_snapshot, an_edge, an_inventory, some_tasks


def test_why_a_task_has_no_place() -> None:
    event = Event(at=NOW, kind=EventKind.TASK_UNPLACED, task="slam", message="no-candidate")
    assert (
        events.render_events([event])
        .splitlines()[1]
        .endswith("  task-unplaced  slam     no host may run it now")
    )
    assert encode_event(event)["message"] == "no-candidate"


def test_a_clock_is_ahead_or_behind() -> None:
    said = [
        HostDetailsView(
            "edge1",
            a_snapshot(edge1=replace(a_sample(), device=DeviceSample(clock_skew_s=skew))),
            an_inventory(an_edge()),
            some_tasks(),
            None,
        ).table()
        for skew in (-0.14, 2.0)
    ]
    assert "clock 0.1s behind" in said[0]
    assert "clock 2.0s ahead" in said[1]
    assert "Events:" not in said[0], "nobody looked for any"
