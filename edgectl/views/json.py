"""The form for programs: the documents of ``formats``, the same bytes every time."""

from collections.abc import Iterable, Mapping, Sequence

from edgectl.formats import plan as plan_format
from edgectl.formats import snapshot as snapshot_format
from edgectl.formats.base import FORMAT_VERSION, Document, dump_line, dumps, number, optional, without_none
from edgectl.model.bandwidth import Measurement
from edgectl.model.event import Event
from edgectl.model.evidence import Column, Reality, Replayed
from edgectl.model.experiment import Run
from edgectl.model.explanation import Explanation
from edgectl.model.finding import Diagnosis
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Plan, Step
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.profile import ClassProfile
from edgectl.model.profiler import Profiler
from edgectl.model.result import ActionResult, PhaseResult, Results
from edgectl.model.revision import Revision
from edgectl.model.scenario import Scenario
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task, Tasks
from edgectl.units import format_instant
from edgectl.views import host_sheet, task_sheet
from edgectl.views.absent import Absent, absent
from edgectl.views.demands import stated
from edgectl.views.diagnosis import document as diagnosis_document
from edgectl.views.events import document as events_document
from edgectl.views.events import line as event_line
from edgectl.views.explanation import document as explanation_document
from edgectl.views.listing import Change, Item, Listing
from edgectl.views.listing import document as listing_document
from edgectl.views.listing import line as change_document
from edgectl.views.measured import as_document as measured_document
from edgectl.views.profile import document as profile_document
from edgectl.views.profilers import document as profilers_document
from edgectl.views.replayed import document as replayed_document
from edgectl.views.simulated import as_document as simulated_document
from edgectl.views.text import PLAIN, Look
from edgectl.views.top import hosts_document, tasks_document


def plan(value: Plan, _look: Look = PLAIN) -> str:
    """The plan document."""
    return dumps(plan_format.encode(value))


def simulated(scenario: Scenario, values: Iterable[Column], real: Reality, _look: Look = PLAIN) -> str:
    """What the model says of each scheme."""
    return dumps(simulated_document(scenario, values, real))


def measured(run: Run, values: Sequence[Column], _look: Look = PLAIN) -> str:
    """What an experiment on real hosts gave."""
    return dumps(measured_document(run, values))


def replayed(values: Iterable[Replayed], _look: Look = PLAIN) -> str:
    """What each variant would have done."""
    return dumps(replayed_document(values))


def explanation(step: Step, value: Explanation, _look: Look = PLAIN) -> str:
    """Why a task goes where it goes."""
    return dumps(explanation_document(step, value))


def profilers(values: Iterable[Profiler], _look: Look = PLAIN) -> str:
    """The profilers that stay on the hosts."""
    return dumps(profilers_document(values))


def diagnosis(value: Diagnosis, _look: Look = PLAIN) -> str:
    """What the doctor found."""
    return dumps(diagnosis_document(value))


def events(values: Sequence[Event], _look: Look = PLAIN) -> str:
    """What happened."""
    return dumps(events_document(values))


def events_more(values: Iterable[Event], _head: object, _look: Look = PLAIN) -> str:
    """What happened since, one object per line."""
    return "".join(dump_line(event_line(value)) for value in values)


def snapshot(value: Snapshot, _look: Look = PLAIN) -> str:
    """The snapshot document."""
    return dumps(snapshot_format.encode(value))


def status(value: Snapshot, inventory: Inventory, tasks: Tasks, _look: Look = PLAIN) -> str:
    """The snapshot document with the wanted tasks and their demands beside it."""
    return dumps(status_document(value, inventory, tasks))


def status_document(value: Snapshot, _inventory: Inventory, tasks: Tasks) -> Document:
    """What ``status`` shows, as JSON types."""
    document = snapshot_format.encode(value)
    seen = {name for host in value.hosts.values() for name in host.tasks}
    document["wanted"] = {
        task.name: _wanted(task) | ({} if task.name in seen else _absent(absent(task, value))) for task in tasks.tasks.values()
    }
    return document


def _absent(known: Absent) -> Document:
    """Of a task that no host reports: its state, and where and when it was known last."""
    contact = None if known.contact is None else format_instant(known.contact)
    return without_none(state=known.state, last_host=known.host, last_contact=contact)


def _wanted(task: Task) -> Document:
    demand = task.demand
    return {
        "robots": list(task.robots),
        "managed": task.managed,
        "demand": {"cpu": stated(demand.cpu), "memory": stated(demand.memory), "throughput": stated(demand.throughput)},
    }


def results(value: Results, _look: Look = PLAIN) -> str:
    """What an apply did."""
    return dumps(results_document(value))


def results_document(value: Results) -> Document:
    """What an apply did, as JSON types."""
    return {
        "format_version": FORMAT_VERSION,
        "revision": value.revision,
        "seconds": number(round(value.seconds, 3)),
        "done": value.done,
        "interrupted": value.interrupted,
        "actions": [_action(action) for action in value.actions],
    }


def drained(passes: Sequence[Results], left: Iterable[tuple[str, str]], done: bool, _look: Look = PLAIN) -> str:  # noqa: FBT001
    """What a drain did: its last pass, whether the hosts are empty, every pass in order, and what is still on the hosts."""
    remaining = [{"task": task, "host": host} for task, host in left]
    every = [results_document(each) for each in passes]
    return dumps({**every[-1], "done": done, "left": remaining, "passes": every})


def bandwidth(value: Snapshot, links: Iterable[Measurement], _look: Look = PLAIN) -> str:
    """The snapshot document, with what each link was just measured to carry."""
    return dumps({**snapshot_format.encode(value), "bandwidth": [_bandwidth(each) for each in links]})


def _bandwidth(value: Measurement) -> Document:
    return without_none(edge=value.edge, robot=value.robot, bytes_per_s=optional(value.bytes_per_s), error=value.error or None)


def history(values: Iterable[Revision], _look: Look = PLAIN) -> str:
    """The revisions without their actions."""
    return dumps({"format_version": FORMAT_VERSION, "revisions": [_revision(value) for value in values]})


def revision(value: Revision, _look: Look = PLAIN) -> str:
    """One revision with its actions, and where every task stood afterwards."""
    placements = None if value.placements is None else dict(value.placements)
    actions = [_action(action) for action in value.actions]
    return dumps({"format_version": FORMAT_VERSION, **_revision(value), "actions": actions, "placements": placements})


def _revision(value: Revision) -> Document:
    return {
        "revision": value.number,
        "began_at": format_instant(value.began_at),
        "user": value.user,
        "verb": value.verb,
        "outcome": value.ending.value,
        "seconds": optional(value.seconds),
        "counts": dict(value.counts),
    }


def _action(action: ActionResult) -> Document:
    document: Document = {
        "task": action.task,
        "action": action.action.value,
        "outcome": action.outcome.value,
        "host": action.host,
        "previous_host": action.previous_host,
        "located": action.located,
        "downtime_s": optional(action.downtime_s),
        "phases": [_phase(phase) for phase in action.phases],
    }
    return document | without_none(error=action.error or None, hint=action.hint or None)


def _phase(phase: PhaseResult) -> Document:
    document: Document = {"phase": phase.phase.value, "host": phase.host, "seconds": number(round(phase.seconds, 3)), "ok": phase.ok}
    return document | without_none(detail=phase.detail or None)


def validated(inventory: Inventory, tasks: Tasks, _look: Look = PLAIN) -> str:
    """What two good files hold, with their digests."""
    return dumps(
        {
            "format_version": FORMAT_VERSION,
            "edges": [host.name for host in inventory.edges],
            "robots": [host.name for host in inventory.robots],
            "tasks": list(tasks.tasks),
            "inventory_digest": inventory.digest,
            "tasks_digest": tasks.digest,
        }
    )


def commands(values: Iterable[Mapping[str, object]], _look: Look = PLAIN) -> str:
    """What would be sent."""
    return dumps({"format_version": FORMAT_VERSION, "requests": list(values)})


def nothing(_look: Look = PLAIN) -> str:
    """An apply that had nothing to do."""
    return dumps({"format_version": FORMAT_VERSION, "done": True, "actions": []})


def profile(values: Iterable[ClassProfile], _look: Look = PLAIN) -> str:
    """What tasks were measured to use."""
    return dumps(profile_document(values))


def ssim(value: float, _look: Look = PLAIN) -> str:
    """How like the truth a map is."""
    return dumps({"format_version": FORMAT_VERSION, "ssim": number(value)})


def fields(values: Mapping[str, str], _look: Look = PLAIN) -> str:
    """Names and values as one object."""
    return dumps({"format_version": FORMAT_VERSION, **values})


def listing(value: Listing, _look: Look = PLAIN) -> str:
    """What is listed."""
    return dumps(listing_document(value))


def listing_more(value: Listing, changed: Iterable[tuple[Change, Item]], _first: Listing | None, _look: Look = PLAIN) -> str:
    """What changed, one object per line."""
    return "".join(dump_line(change_document(value.at, change, item)) for change, item in changed)


def top_hosts(value: Snapshot, inventory: Inventory, points: Iterable[HostPoint], _look: Look = PLAIN) -> str:
    """The hosts with their use."""
    return dumps(hosts_document(value, inventory, points))


def top_tasks(value: Snapshot, inventory: Inventory, tasks: Tasks, points: Iterable[TaskPoint], _look: Look = PLAIN) -> str:
    """The tasks that run, with their use and demand."""
    return dumps(tasks_document(value, inventory, tasks, points))


def top_hosts_line(value: Snapshot, inventory: Inventory, points: Iterable[HostPoint], _look: Look = PLAIN) -> str:
    """The same on one line."""
    return dump_line(hosts_document(value, inventory, points))


def top_tasks_line(value: Snapshot, inventory: Inventory, tasks: Tasks, points: Iterable[TaskPoint], _look: Look = PLAIN) -> str:
    """The same on one line."""
    return dump_line(tasks_document(value, inventory, tasks, points))


def host_details(name: str, value: Snapshot, inventory: Inventory, _tasks: Tasks, happened: Sequence[Event], _look: Look = PLAIN) -> str:
    """Everything that is known of a host."""
    return dumps(host_sheet.host_details(name, value, inventory, happened))


def task_details(
    name: str, value: Snapshot, inventory: Inventory, tasks: Tasks, step: Step | None, happened: Sequence[Event], _look: Look = PLAIN
) -> str:
    """Everything that is known of a task."""
    return dumps(task_sheet.task_details(name, value, inventory, tasks, step, happened))
