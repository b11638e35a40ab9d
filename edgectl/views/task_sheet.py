"""Everything that is known of a task: what the files state, what is measured, what was decided, what happened last."""

from collections.abc import Sequence

from edgectl.formats.base import FORMAT_VERSION, Document, number, optional
from edgectl.formats.snapshot import encode_task
from edgectl.model.event import Event
from edgectl.model.inventory import Inventory
from edgectl.model.memory import Memory
from edgectl.model.plan import Step
from edgectl.model.snapshot import Snapshot, TaskSample
from edgectl.model.task import Check, Task, Tasks
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import events as events_view
from edgectl.views import metrics
from edgectl.views.absent import absent, silence
from edgectl.views.reasons import reason
from edgectl.views.sheet import Field, events_section, fields, pairs, section
from edgectl.views.state import STATES, phrase
from edgectl.views.text import PLAIN, Cell, Look, Row
from edgectl.views.use import Amounts, apart, demanded, off, shown


def task(
    name: str, value: Snapshot, inventory: Inventory, tasks: Tasks, step: Step | None, events: Sequence[Event] | None, look: Look = PLAIN
) -> str:
    """One task; of one that no file names, only how it runs. ``events``: the last ones, oldest first; None: not asked for."""
    stated = tasks.tasks.get(name)
    runs = _runs(name, value)
    stands = [("Name", Cell(name, "name")), *(_spec(stated) if stated else [("Command", Cell("not in the task files", "warn"))])]
    stands += _placing(name, stated, value, step)
    parts = [fields(stands, look)]
    for place, sample in runs:
        parts.append(section(f"On {place}", _run(sample, value.taken_at), look))
        parts.append(section(f"Use on {place}", _demand(stated, place, sample, value, inventory), look))
        parts.append(section(f"Metrics on {place}", [(name, metrics.value(each)) for name, each in sample.metrics.items()], look))
        parts.append(section("Said last", [(line,) for line in sample.log_tail], look))
    return "".join([*parts, events_section(events, look)])


def _spec(stated: Task) -> list[Field]:
    handoff = stated.handoff
    checks = {"safe when": handoff.safe_when, "hold": handoff.hold, "release": handoff.release}
    hooks = [f"{what} {_check(check)}" for what, check in checks.items() if check is not None]
    return [
        ("Template", stated.template if stated.template != stated.name else ""),
        ("Kind", stated.kind.value if stated.managed else f"{stated.kind.value}, not managed"),
        ("Command", stated.command),
        ("Workdir", stated.workdir or ""),
        ("Robots", ", ".join(stated.robots)),
        ("Needs", ", ".join(f"{need.task} ({need.until})" for need in stated.needs)),
        ("Priority", f"{stated.priority:g}" if stated.priority else ""),
        ("Deadline", "" if stated.deadline is None else format_duration(stated.deadline)),
        ("Labels", pairs(stated.labels)),
        ("Hosts", _rules(stated)),
        ("Ready", _check(stated.ready)),
        ("Done when", _check(stated.done_when)),
        ("Restart", stated.restart.value),
        ("Stop", f"{stated.stop.signal}, then KILL after {format_duration(stated.stop.grace)}"),
        ("Handoff", "; ".join([handoff.order.value, *hooks, *([f"within {format_duration(handoff.timeout)}"] if hooks else [])])),
        ("Host silent", _when_silent(stated)),
        ("Limits", _limits(stated)),
        ("Environment", pairs(stated.env)),
        ("Env command", " ".join(stated.env_command)),
    ]


def _check(check: Check | None) -> str:
    return "" if check is None else f"{check.command!r} on {check.on} within {format_duration(check.timeout)}"


def _rules(stated: Task) -> str:
    rules = stated.hosts
    named = {"only": ", ".join(rules.only), "never": ", ".join(rules.never), "labels": pairs(rules.labels), "pin": rules.pin}
    parts = [f"{what} {text}" for what, text in named.items() if text]
    return "; ".join([*parts, f"onboard {stated.onboard}"])


def _when_silent(stated: Task) -> str:
    replaced = f", after {format_duration(stated.replace_after)}" if stated.on_unreachable == "replace" else ""
    fence = "" if stated.self_fence is None else f"; stops itself after {format_duration(stated.self_fence)}"
    return f"{stated.on_unreachable}{replaced}{fence}"


def _limits(stated: Task) -> str:
    cpu, memory = stated.limits.cpu, stated.limits.memory
    return ", ".join(
        text for text in (f"cpu {format_cores(cpu)}" if cpu else "", f"memory {format_bytes(memory)}" if memory else "") if text
    )


def _placing(name: str, stated: Task | None, value: Snapshot, step: Step | None) -> list[Field]:
    memory = value.memory or Memory()
    placed = memory.placements.get(name)
    downtimes = [f"{place}: {', '.join(map(format_duration, found))}" for place, found in _downtimes(name, memory).items()]
    return [
        ("State", _missing(stated, value) if stated is not None and not _runs(name, value) else ""),
        ("Placed", f"{placed.host} since {format_instant(int(placed.since))}" if placed else ""),
        ("Downtimes", "; ".join(downtimes)),
        ("Deferred", memory.deferred.get(name, "")),
        ("Decision", reason(step) if step is not None else ""),
    ]


def _missing(stated: Task, value: Snapshot) -> str:
    known = absent(stated, value)
    return known.state + (f" on {known.host}" if known.host else "") + silence(known.contact, value.taken_at)


def _downtimes(name: str, memory: Memory) -> dict[str, tuple[float, ...]]:
    return {place: found for (task, place), found in memory.downtimes.items() if task == name and found}


def _runs(name: str, value: Snapshot) -> list[tuple[str, TaskSample]]:
    return [(place, each.tasks[name]) for place, each in value.hosts.items() if name in each.tasks]


def _run(sample: TaskSample, now: float) -> list[Row]:
    since = f"{format_instant(int(sample.started_at))} ({format_duration(max(0.0, now - sample.started_at))})" if sample.started_at else ""
    found: list[Field] = [
        ("State:", Cell(phrase(sample), STATES[sample.state])),
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


def _demand(stated: Task | None, place: str, sample: TaskSample, value: Snapshot, inventory: Inventory) -> list[Row]:
    demand = demanded(stated, inventory.hosts.get(place), value.hosts[place], value.memory) if stated else Amounts()
    difference = off(sample, demand)
    rows: list[Row] = [
        ("cpu", format_cores(sample.used_cores), shown(demand.cores, format_cores), apart(difference.cores, demand.cores, format_cores)),
        ("memory", format_bytes(sample.used_bytes), shown(demand.bytes, format_bytes), apart(difference.bytes, demand.bytes, format_bytes)),
        (
            "network",
            format_rate(sample.used_bytes_per_s),
            shown(demand.rate, format_rate),
            apart(difference.rate, demand.rate, format_rate),
        ),
    ]
    return [("", "USED", "DEMAND", "OFF"), *rows] if sample.state.alive else []


def task_details(name: str, value: Snapshot, inventory: Inventory, tasks: Tasks, step: Step | None, events: Sequence[Event]) -> Document:
    """One task as JSON types."""
    stated, memory = tasks.tasks.get(name), value.memory or Memory()
    placed = memory.placements.get(name)
    runs = []
    for place, sample in _runs(name, value):
        demand = demanded(stated, inventory.hosts.get(place), value.hosts[place], memory) if stated else Amounts()
        runs.append({"host": place, **encode_task(sample), "demand": demand.document(), "off": off(sample, demand).document()})
    return {
        "format_version": FORMAT_VERSION,
        "taken_at": format_instant(value.taken_at),
        "kind": "task",
        "name": name,
        "spec": None if stated is None else _spec_document(stated),
        "runs": runs,
        "placed": None if placed is None else {"host": placed.host, "since": format_instant(placed.since)},
        "downtimes_s": {place: [number(each) for each in found] for place, found in _downtimes(name, memory).items()},
        "decision": None if step is None else _decision(step),
        "events": [events_view.line(event) for event in events],
    }


def _spec_document(stated: Task) -> Document:
    handoff = stated.handoff
    hooks = {"safe_when": handoff.safe_when, "hold": handoff.hold, "release": handoff.release}
    return {
        "template": stated.template,
        "kind": stated.kind.value,
        "managed": stated.managed,
        "command": stated.command,
        "robots": list(stated.robots),
        "needs": [{"task": need.task, "until": need.until.value} for need in stated.needs],
        "priority": number(stated.priority),
        "deadline_s": optional(stated.deadline),
        "labels": dict(stated.labels),
        "restart": stated.restart.value,
        "handoff": {"order": handoff.order.value, **{key: check.command for key, check in hooks.items() if check is not None}},
        "on_unreachable": stated.on_unreachable.value,
        "env": {key: str(text) for key, text in stated.env.items()},
    }


def _decision(step: Step) -> Document:
    decision = step.decision
    named = {"action": step.action.value, "reason": reason(step), "host": decision.host, "previous_host": decision.previous_host}
    return {**named, "total": optional(decision.total), "lead": optional(decision.lead)}
