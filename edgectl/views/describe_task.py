"""Everything that is known of a task: what the files state, what is measured, what was decided, what happened last."""

from collections.abc import Sequence

from edgectl.formats.document import FORMAT_VERSION, Document, encode_number, encode_optional
from edgectl.formats.snapshot import encode_task
from edgectl.model.event import Event
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Step
from edgectl.model.snapshot import Snapshot, TaskSample
from edgectl.model.task import Check, Task, Tasks
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import events as events_view
from edgectl.views import metrics
from edgectl.views.describe import Field, format_pairs, render_events_section, render_fields, render_section
from edgectl.views.reasons import describe_reason
from edgectl.views.state import TASK_STATE_STYLES, format_silence, format_task_state, resolve_absent_task
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row
from edgectl.views.usage import (
    ResourceAmounts,
    compute_task_demand,
    format_or_dash,
    render_difference,
    subtract_demand,
)


def render_task_details(
    name: str,
    value: Snapshot,
    inventory: Inventory,
    tasks: Tasks,
    step: Step | None,
    events: Sequence[Event] | None,
    look: RenderOptions = PLAIN,
) -> str:
    """One task; of one that no file names, only how it runs. ``events``: the last ones, oldest first; None: not asked for."""
    stated = tasks.tasks.get(name)
    runs = _select_task_runs(name, value)
    stands = [
        ("Name", Cell(name, "name")),
        *(_list_spec_fields(stated) if stated else [("Command", Cell("not in the task files", "warn"))]),
    ]
    stands += _list_placement_fields(name, stated, value, step)
    parts = [render_fields(stands, look)]
    for place, sample in runs:
        parts.append(render_section(f"On {place}", _render_run_rows(sample, value.taken_at), look))
        parts.append(
            render_section(
                f"Use on {place}", _render_demand_rows(stated, place, sample, value, inventory), look
            )
        )
        parts.append(
            render_section(
                f"Metrics on {place}",
                [(name, metrics.format_metric(each)) for name, each in sample.metrics.items()],
                look,
            )
        )
        parts.append(render_section("Said last", [(line,) for line in sample.log_tail], look))
    return "".join([*parts, render_events_section(events, look)])


def _list_spec_fields(stated: Task) -> list[Field]:
    handoff = stated.handoff
    checks = {"safe when": handoff.safe_when, "hold": handoff.hold, "release": handoff.release}
    hooks = [f"{what} {_format_check(check)}" for what, check in checks.items() if check is not None]
    return [
        ("Template", stated.template if stated.template != stated.name else ""),
        ("Kind", stated.kind.value if stated.managed else f"{stated.kind.value}, not managed"),
        ("Command", stated.command),
        ("Workdir", stated.workdir or ""),
        ("Robots", ", ".join(stated.robots)),
        ("Needs", ", ".join(f"{need.task} ({need.until})" for need in stated.needs)),
        ("Priority", f"{stated.priority:g}" if stated.priority else ""),
        ("Deadline", "" if stated.deadline is None else format_duration(stated.deadline)),
        ("Labels", format_pairs(stated.labels)),
        ("Hosts", _format_host_rules(stated)),
        ("Ready", _format_check(stated.ready)),
        ("Done when", _format_check(stated.done_when)),
        ("Restart", stated.restart.value),
        ("Stop", f"{stated.stop.signal}, then KILL after {format_duration(stated.stop.grace)}"),
        (
            "Handoff",
            "; ".join(
                [
                    handoff.order.value,
                    *hooks,
                    *([f"within {format_duration(handoff.timeout)}"] if hooks else []),
                ]
            ),
        ),
        ("Host silent", _format_unreachable_policy(stated)),
        ("Limits", _format_task_limits(stated)),
        ("Environment", format_pairs(stated.env)),
        ("Env command", " ".join(stated.env_command)),
    ]


def _format_check(check: Check | None) -> str:
    return "" if check is None else f"{check.command!r} on {check.on} within {format_duration(check.timeout)}"


def _format_host_rules(stated: Task) -> str:
    rules = stated.hosts
    named = {
        "only": ", ".join(rules.only),
        "never": ", ".join(rules.never),
        "labels": format_pairs(rules.labels),
        "pin": rules.pin,
    }
    parts = [f"{what} {text}" for what, text in named.items() if text]
    return "; ".join([*parts, f"onboard {stated.onboard}"])


def _format_unreachable_policy(stated: Task) -> str:
    replaced = (
        f", after {format_duration(stated.replace_after)}" if stated.on_unreachable == "replace" else ""
    )
    fence = "" if stated.self_fence is None else f"; stops itself after {format_duration(stated.self_fence)}"
    return f"{stated.on_unreachable}{replaced}{fence}"


def _format_task_limits(stated: Task) -> str:
    cpu, memory = stated.limits.cpu, stated.limits.memory
    return ", ".join(
        text
        for text in (
            f"cpu {format_cores(cpu)}" if cpu else "",
            f"memory {format_bytes(memory)}" if memory else "",
        )
        if text
    )


def _list_placement_fields(name: str, stated: Task | None, value: Snapshot, step: Step | None) -> list[Field]:
    memory = value.manager or ManagerState()
    placed = memory.placements.get(name)
    downtimes = [
        f"{place}: {', '.join(map(format_duration, found))}"
        for place, found in _select_downtimes(name, memory).items()
    ]
    return [
        (
            "State",
            _format_absent_state(stated, value)
            if stated is not None and not _select_task_runs(name, value)
            else "",
        ),
        ("Placed", f"{placed.host} since {format_instant(int(placed.since))}" if placed else ""),
        ("Downtimes", "; ".join(downtimes)),
        ("Deferred", memory.deferred.get(name, "")),
        ("Decision", describe_reason(step) if step is not None else ""),
    ]


def _format_absent_state(stated: Task, value: Snapshot) -> str:
    known = resolve_absent_task(stated, value)
    return (
        known.state
        + (f" on {known.host}" if known.host else "")
        + format_silence(known.contact, value.taken_at)
    )


def _select_downtimes(name: str, memory: ManagerState) -> dict[str, tuple[float, ...]]:
    return {place: found for (task, place), found in memory.downtimes.items() if task == name and found}


def _select_task_runs(name: str, value: Snapshot) -> list[tuple[str, TaskSample]]:
    return [(place, each.tasks[name]) for place, each in value.hosts.items() if name in each.tasks]


def _render_run_rows(sample: TaskSample, now: float) -> list[Row]:
    since = (
        f"{format_instant(int(sample.started_at))} ({format_duration(max(0.0, now - sample.started_at))})"
        if sample.started_at
        else ""
    )
    found: list[Field] = [
        ("State:", Cell(format_task_state(sample), TASK_STATE_STYLES[sample.state])),
        ("Since:", since),
        ("Process:", str(sample.pid or "")),
        ("Restarts:", str(sample.restarts)),
        ("Last exit:", "" if sample.last_exit is None else str(sample.last_exit)),
        ("Exit code:", "" if sample.exit_code is None else str(sample.exit_code)),
        ("Limits:", sample.limits),
        ("Generation:", str(sample.generation or "")),
        ("Instance:", sample.instance),
    ]
    return [field for field in found if field[1]]


def _render_demand_rows(
    stated: Task | None, place: str, sample: TaskSample, value: Snapshot, inventory: Inventory
) -> list[Row]:
    demand = (
        compute_task_demand(stated, inventory.hosts.get(place), value.hosts[place], value.manager)
        if stated
        else ResourceAmounts()
    )
    difference = subtract_demand(sample, demand)
    rows: list[Row] = [
        (
            "cpu",
            format_cores(sample.used["cpu"]),
            format_or_dash(demand.cores, format_cores),
            render_difference(difference.cores, demand.cores, format_cores),
        ),
        (
            "memory",
            format_bytes(sample.used["memory"]),
            format_or_dash(demand.bytes, format_bytes),
            render_difference(difference.bytes, demand.bytes, format_bytes),
        ),
        (
            "network",
            format_rate(sample.used["network"]),
            format_or_dash(demand.rate, format_rate),
            render_difference(difference.rate, demand.rate, format_rate),
        ),
    ]
    return [("", "USED", "DEMAND", "OFF"), *rows] if sample.state.alive else []


def encode_task_details(
    name: str, value: Snapshot, inventory: Inventory, tasks: Tasks, step: Step | None, events: Sequence[Event]
) -> Document:
    """One task as JSON types."""
    stated, memory = tasks.tasks.get(name), value.manager or ManagerState()
    placed = memory.placements.get(name)
    runs = []
    for place, sample in _select_task_runs(name, value):
        demand = (
            compute_task_demand(stated, inventory.hosts.get(place), value.hosts[place], memory)
            if stated
            else ResourceAmounts()
        )
        runs.append(
            {
                "host": place,
                **encode_task(sample),
                "demand": demand.document(),
                "off": subtract_demand(sample, demand).document(),
            }
        )
    return {
        "format_version": FORMAT_VERSION,
        "taken_at": format_instant(value.taken_at),
        "kind": "task",
        "name": name,
        "spec": None if stated is None else _encode_task_spec(stated),
        "runs": runs,
        "placed": None if placed is None else {"host": placed.host, "since": format_instant(placed.since)},
        "downtimes_s": {
            place: [encode_number(each) for each in found]
            for place, found in _select_downtimes(name, memory).items()
        },
        "decision": None if step is None else _encode_decision(step),
        "events": [events_view.encode_event(event) for event in events],
    }


def _encode_task_spec(stated: Task) -> Document:
    handoff = stated.handoff
    hooks = {"safe_when": handoff.safe_when, "hold": handoff.hold, "release": handoff.release}
    return {
        "template": stated.template,
        "kind": stated.kind.value,
        "managed": stated.managed,
        "command": stated.command,
        "robots": list(stated.robots),
        "needs": [{"task": need.task, "until": need.until.value} for need in stated.needs],
        "priority": encode_number(stated.priority),
        "deadline_s": encode_optional(stated.deadline),
        "labels": dict(stated.labels),
        "restart": stated.restart.value,
        "handoff": {
            "order": handoff.order.value,
            **{key: check.command for key, check in hooks.items() if check is not None},
        },
        "on_unreachable": stated.on_unreachable.value,
        "env": {key: str(text) for key, text in stated.env.items()},
    }


def _encode_decision(step: Step) -> Document:
    decision = step.decision
    named = {
        "action": step.action.value,
        "reason": describe_reason(step),
        "host": decision.host,
        "previous_host": decision.previous_host,
    }
    return {**named, "total": encode_optional(decision.total), "lead": encode_optional(decision.lead)}
