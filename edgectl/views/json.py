"""The form for programs: the documents of ``formats``, the same bytes every time."""

from collections.abc import Iterable, Mapping, Sequence

from edgectl.formats import plan as plan_format
from edgectl.formats import snapshot as snapshot_format
from edgectl.formats.document import (
    FORMAT_VERSION,
    Document,
    dump_document,
    dump_line,
    encode_number,
    encode_optional,
    without_none,
)
from edgectl.model.diagnosis import Diagnosis
from edgectl.model.event import Event
from edgectl.model.explanation import Explanation
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Plan, Step
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.profile import ClassProfile
from edgectl.model.profiler import Profiler
from edgectl.model.resource import RESOURCES
from edgectl.model.result import ActionResult, PhaseResult, Results
from edgectl.model.revision import Revision
from edgectl.model.snapshot import BandwidthMeasurement, Snapshot
from edgectl.model.task import Task, Tasks
from edgectl.units import format_instant
from edgectl.views import describe_host, describe_task
from edgectl.views.demands import encode_declared_demand
from edgectl.views.diagnosis import encode_diagnosis as diagnosis_document
from edgectl.views.events import encode_event as event_line
from edgectl.views.events import encode_events as events_document
from edgectl.views.explanation import encode_explanation as explanation_document
from edgectl.views.listing import ItemChange, Listing, ListingItem
from edgectl.views.listing import encode_item_change as change_document
from edgectl.views.listing import encode_listing as listing_document
from edgectl.views.profile import encode_profiles as profile_document
from edgectl.views.profilers import encode_profilers as profilers_document
from edgectl.views.state import AbsentTask, resolve_absent_task
from edgectl.views.text import PLAIN, RenderOptions
from edgectl.views.top import encode_top_hosts, encode_top_tasks


def plan(value: Plan, _look: RenderOptions = PLAIN) -> str:
    """The plan document."""
    return dump_document(plan_format.encode(value))


def explanation(step: Step, value: Explanation, _look: RenderOptions = PLAIN) -> str:
    """Why a task goes where it goes."""
    return dump_document(explanation_document(step, value))


def profilers(values: Iterable[Profiler], _look: RenderOptions = PLAIN) -> str:
    """The profilers that stay on the hosts."""
    return dump_document(profilers_document(values))


def diagnosis(value: Diagnosis, _look: RenderOptions = PLAIN) -> str:
    """What the doctor found."""
    return dump_document(diagnosis_document(value))


def events(values: Sequence[Event], _look: RenderOptions = PLAIN) -> str:
    """What happened."""
    return dump_document(events_document(values))


def events_more(values: Iterable[Event], _head: object, _look: RenderOptions = PLAIN) -> str:
    """What happened since, one object per line."""
    return "".join(dump_line(event_line(value)) for value in values)


def snapshot(value: Snapshot, _look: RenderOptions = PLAIN) -> str:
    """The snapshot document."""
    return dump_document(snapshot_format.encode(value))


def status(value: Snapshot, inventory: Inventory, tasks: Tasks, _look: RenderOptions = PLAIN) -> str:
    """The snapshot document with the wanted tasks and their demands beside it."""
    return dump_document(encode_status(value, inventory, tasks))


def encode_status(value: Snapshot, _inventory: Inventory, tasks: Tasks) -> Document:
    """What ``status`` shows, as JSON types."""
    document = snapshot_format.encode(value)
    seen = {name for host in value.hosts.values() for name in host.tasks}
    document["wanted"] = {
        task.name: _encode_wanted_task(task)
        | ({} if task.name in seen else _encode_absent_task(resolve_absent_task(task, value)))
        for task in tasks.tasks.values()
    }
    return document


def _encode_absent_task(known: AbsentTask) -> Document:
    """Of a task that no host reports: its state, and where and when it was known last."""
    contact = None if known.contact is None else format_instant(known.contact)
    return without_none(state=known.state, last_host=known.host, last_contact=contact)


def _encode_wanted_task(task: Task) -> Document:
    demand = task.demand
    return {
        "robots": list(task.robots),
        "managed": task.managed,
        "demand": {
            resource.demand_key: encode_declared_demand(demand[resource.name]) for resource in RESOURCES
        },
    }


def results(value: Results, _look: RenderOptions = PLAIN) -> str:
    """What an apply did."""
    return dump_document(encode_results(value))


def encode_results(value: Results) -> Document:
    """What an apply did, as JSON types."""
    return {
        "format_version": FORMAT_VERSION,
        "revision": value.revision,
        "seconds": encode_number(round(value.seconds, 3)),
        "done": value.done,
        "interrupted": value.interrupted,
        "actions": [_encode_action_result(action) for action in value.actions],
    }


def drained(
    passes: Sequence[Results],
    left: Iterable[tuple[str, str]],
    done: bool,  # noqa: FBT001
    _look: RenderOptions = PLAIN,
) -> str:
    """What a drain did: its last pass, whether the hosts are empty, every pass in order, and what is still on the hosts."""
    remaining = [{"task": task, "host": host} for task, host in left]
    every = [encode_results(each) for each in passes]
    return dump_document({**every[-1], "done": done, "left": remaining, "passes": every})


def bandwidth(value: Snapshot, links: Iterable[BandwidthMeasurement], _look: RenderOptions = PLAIN) -> str:
    """The snapshot document, with what each link was just measured to carry."""
    return dump_document(
        {
            **snapshot_format.encode(value),
            "bandwidth": [_encode_bandwidth_measurement(each) for each in links],
        }
    )


def _encode_bandwidth_measurement(value: BandwidthMeasurement) -> Document:
    return without_none(
        edge=value.edge,
        robot=value.robot,
        bytes_per_s=encode_optional(value.bytes_per_s),
        error=value.error or None,
    )


def history(values: Iterable[Revision], _look: RenderOptions = PLAIN) -> str:
    """The revisions without their actions."""
    return dump_document(
        {"format_version": FORMAT_VERSION, "revisions": [_encode_revision(value) for value in values]}
    )


def revision(value: Revision, _look: RenderOptions = PLAIN) -> str:
    """One revision with its actions, and where every task stood afterwards."""
    placements = None if value.placements is None else dict(value.placements)
    actions = [_encode_action_result(action) for action in value.actions]
    return dump_document(
        {
            "format_version": FORMAT_VERSION,
            **_encode_revision(value),
            "actions": actions,
            "placements": placements,
        }
    )


def _encode_revision(value: Revision) -> Document:
    return {
        "revision": value.number,
        "began_at": format_instant(value.began_at),
        "user": value.user,
        "verb": value.verb,
        "outcome": value.ending.value,
        "seconds": encode_optional(value.seconds),
        "counts": dict(value.counts),
    }


def _encode_action_result(action: ActionResult) -> Document:
    document: Document = {
        "task": action.task,
        "action": action.action.value,
        "outcome": action.outcome.value,
        "host": action.host,
        "previous_host": action.previous_host,
        "located": action.located,
        "downtime_s": encode_optional(action.downtime_s),
        "phases": [_encode_phase_result(phase) for phase in action.phases],
    }
    return document | without_none(error=action.error or None, hint=action.hint or None)


def _encode_phase_result(phase: PhaseResult) -> Document:
    document: Document = {
        "phase": phase.phase.value,
        "host": phase.host,
        "seconds": encode_number(round(phase.seconds, 3)),
        "ok": phase.ok,
    }
    return document | without_none(detail=phase.detail or None)


def validated(inventory: Inventory, tasks: Tasks, _look: RenderOptions = PLAIN) -> str:
    """What two good files hold, with their digests."""
    return dump_document(
        {
            "format_version": FORMAT_VERSION,
            "edges": [host.name for host in inventory.edges],
            "robots": [host.name for host in inventory.robots],
            "tasks": list(tasks.tasks),
            "inventory_digest": inventory.digest,
            "tasks_digest": tasks.digest,
        }
    )


def commands(values: Iterable[Mapping[str, object]], _look: RenderOptions = PLAIN) -> str:
    """What would be sent."""
    return dump_document({"format_version": FORMAT_VERSION, "requests": list(values)})


def nothing(_look: RenderOptions = PLAIN) -> str:
    """An apply that had nothing to do."""
    return dump_document({"format_version": FORMAT_VERSION, "done": True, "actions": []})


def profile(values: Iterable[ClassProfile], _look: RenderOptions = PLAIN) -> str:
    """What tasks were measured to use."""
    return dump_document(profile_document(values))


def fields(values: Mapping[str, str], _look: RenderOptions = PLAIN) -> str:
    """Names and values as one object."""
    return dump_document({"format_version": FORMAT_VERSION, **values})


def listing(value: Listing, _look: RenderOptions = PLAIN) -> str:
    """What is listed."""
    return dump_document(listing_document(value))


def listing_more(
    value: Listing,
    changed: Iterable[tuple[ItemChange, ListingItem]],
    _first: Listing | None,
    _look: RenderOptions = PLAIN,
) -> str:
    """What changed, one object per line."""
    return "".join(dump_line(change_document(value.at, change, item)) for change, item in changed)


def top_hosts(
    value: Snapshot, inventory: Inventory, points: Iterable[HostPoint], _look: RenderOptions = PLAIN
) -> str:
    """The hosts with their use."""
    return dump_document(encode_top_hosts(value, inventory, points))


def top_tasks(
    value: Snapshot,
    inventory: Inventory,
    tasks: Tasks,
    points: Iterable[TaskPoint],
    _look: RenderOptions = PLAIN,
) -> str:
    """The tasks that run, with their use and demand."""
    return dump_document(encode_top_tasks(value, inventory, tasks, points))


def top_hosts_line(
    value: Snapshot, inventory: Inventory, points: Iterable[HostPoint], _look: RenderOptions = PLAIN
) -> str:
    """The same on one line."""
    return dump_line(encode_top_hosts(value, inventory, points))


def top_tasks_line(
    value: Snapshot,
    inventory: Inventory,
    tasks: Tasks,
    points: Iterable[TaskPoint],
    _look: RenderOptions = PLAIN,
) -> str:
    """The same on one line."""
    return dump_line(encode_top_tasks(value, inventory, tasks, points))


def host_details(
    name: str,
    value: Snapshot,
    inventory: Inventory,
    _tasks: Tasks,
    happened: Sequence[Event],
    _look: RenderOptions = PLAIN,
) -> str:
    """Everything that is known of a host."""
    return dump_document(describe_host.encode_host_details(name, value, inventory, happened))


def task_details(
    name: str,
    value: Snapshot,
    inventory: Inventory,
    tasks: Tasks,
    step: Step | None,
    happened: Sequence[Event],
    _look: RenderOptions = PLAIN,
) -> str:
    """Everything that is known of a task."""
    return dump_document(describe_task.encode_task_details(name, value, inventory, tasks, step, happened))
