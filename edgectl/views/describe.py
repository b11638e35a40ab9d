"""Everything that is known of one host or task: what the files state, what is measured, what was decided, what happened last."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from edgectl.formats.base import FORMAT_VERSION, Document, number, optional, without_none
from edgectl.formats.snapshot import encode_task
from edgectl.model.event import Event
from edgectl.model.inventory import Host, Inventory
from edgectl.model.memory import Memory
from edgectl.model.plan import Step
from edgectl.model.snapshot import HostSample, InterfaceSample, Snapshot, TaskSample
from edgectl.model.task import Check, Task, Tasks
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import events as events_view
from edgectl.views import metrics
from edgectl.views.absent import absent, silence
from edgectl.views.listing import host_document
from edgectl.views.reasons import reason
from edgectl.views.state import STATES, host_status, phrase
from edgectl.views.text import PLAIN, Cell, Look, Row, columns, paint
from edgectl.views.top import compared
from edgectl.views.use import Amounts, apart, demanded, off, share, shown

Field = tuple[str, str | Cell]
_INDENT = 2


def host(name: str, value: Snapshot, inventory: Inventory, tasks: Tasks, events: Sequence[Event], look: Look = PLAIN) -> str:
    """One edge or robot."""
    stated, sample = inventory.hosts[name], value.hosts.get(name)
    parts = [_fields(_host_fields(stated, sample, value), look)]
    if sample is not None and sample.ok:
        parts += [
            _section("Use", _use(stated, sample, look), look),
            _section("Links", _links(sample), look),
            _section("Tasks", compared(value, inventory, tasks, on=name), look),
            _section("Interfaces", _interfaces(sample.device.interfaces), look),
        ]
    return "".join([*parts, _events(events, look)])


def task(
    name: str, value: Snapshot, inventory: Inventory, tasks: Tasks, step: Step | None, events: Sequence[Event], look: Look = PLAIN
) -> str:
    """One task; of one that no file names, only how it runs."""
    stated = tasks.tasks.get(name)
    runs = _runs(name, value)
    fields = [("Name", Cell(name, "name")), *(_spec(stated) if stated else [("Command", Cell("not in the task files", "warn"))])]
    fields += _placing(name, stated, value, step)
    parts = [_fields(fields, look)]
    for place, sample in runs:
        parts.append(_section(f"On {place}", _run(sample, value.taken_at), look))
        parts.append(_section(f"Use on {place}", _demand(stated, place, sample, value, inventory), look))
        parts.append(_section(f"Metrics on {place}", [(name, metrics.value(each)) for name, each in sample.metrics.items()], look))
        parts.append(_section("Said last", [(line,) for line in sample.log_tail], look))
    return "".join([*parts, _events(events, look)])


def _fields(fields: Iterable[Field], look: Look) -> str:
    return columns([(Cell(f"{name}:", "bold"), text) for name, text in fields if text], look)


def _section(title: str, rows: Sequence[Row], look: Look) -> str:
    if not rows:
        return ""
    narrow = look if look.width is None else replace(look, width=max(1, look.width - _INDENT))
    return paint(f"{title}:", "bold", look) + "\n" + textwrap.indent(columns(rows, narrow, wrap=set(range(8))), " " * _INDENT)


def _events(values: Sequence[Event], look: Look) -> str:
    if not values:
        return paint("Events:", "bold", look) + " none\n"
    narrow = look if look.width is None else replace(look, width=max(1, look.width - _INDENT))
    return paint("Events:", "bold", look) + "\n" + textwrap.indent(events_view.text(values, narrow), " " * _INDENT)


def _host_fields(stated: Host, sample: HostSample | None, value: Snapshot) -> list[Field]:
    contact = value.memory.contact.get(stated.name) if value.memory else None
    found = [("Name", Cell(stated.name, "name")), ("Role", stated.role.value), ("Address", stated.host), *_connection(stated)]
    found.append(("Status", host_status(stated.name, sample, value.memory)))
    if sample is not None and not sample.ok:
        found += [("Cause", sample.error), ("Mend", sample.hint)]
    return [
        *found,
        ("Last contact", "" if contact is None else f"{format_duration(max(0.0, value.taken_at - contact))} ago"),
        ("Labels", _pairs(stated.labels)),
        ("Capacity", _capacity(stated, sample)),
        ("Limits", f"cpu {stated.limits.cpu:.0%}, memory {stated.limits.memory:.0%}"),
        ("Onboard", "a candidate for its own tasks" if stated.onboard else ""),
        ("Runtime", stated.runtime.value),
        ("Prelude", stated.prelude),
        ("Environment", _pairs(stated.env)),
        ("Env command", " ".join(stated.env_command)),
        ("Device", _device(sample) if sample is not None and sample.ok else ""),
    ]


def _connection(stated: Host) -> list[Field]:
    named = {"port": stated.port, "user": stated.user, "key": stated.identity_file, "through": stated.proxy_jump}
    parts = [f"{what} {text}" for what, text in named.items() if text]
    return [("Connection", ", ".join([stated.connection.value, *parts]))]


def _capacity(stated: Host, sample: HostSample | None) -> str:
    if stated.capacity is not None:
        base = f"; base load {format_cores(stated.base.cpu)} cores, {format_bytes(stated.base.memory)}"
        declared = f"{format_cores(stated.capacity.cpu)} cores, {format_bytes(stated.capacity.memory)} (declared)"
        return declared + (base if stated.base.cpu or stated.base.memory else "")
    if sample is None or sample.cpu is None or sample.memory is None:
        return ""
    return f"{format_cores(sample.cpu.cores)} cores, {format_bytes(sample.memory.total_bytes)} (measured)"


def _device(sample: HostSample) -> str:
    device = sample.device
    known = {
        "load": None if device.load_1m is None else f"{device.load_1m:.2f}",
        "temperature": None if device.temperature_c is None else f"{device.temperature_c:.0f}C",
        "gpu": None if device.gpu_share is None else f"{device.gpu_share:.0%}",
        "clock": None if device.clock_skew_s is None else _skew(device.clock_skew_s),
        "boot": device.boot_id[:8] or None,
    }
    return ", ".join(f"{what} {text}" for what, text in known.items() if text)


def _skew(seconds: float) -> str:
    return f"{abs(seconds):.1f}s {'behind' if seconds < 0 else 'ahead'}"


def _use(stated: Host, sample: HostSample, look: Look) -> list[Row]:
    if sample.cpu is None or sample.memory is None:
        return []
    cpu, memory = sample.cpu, sample.memory
    return [
        (
            "cpu",
            share(cpu.used_cores, cpu.cores, stated.limits.cpu, look),
            f"{format_cores(cpu.used_cores)} of {format_cores(cpu.cores)} cores",
        ),
        (
            "memory",
            share(memory.used_bytes, memory.total_bytes, stated.limits.memory, look),
            f"{format_bytes(memory.used_bytes)} of {format_bytes(memory.total_bytes)}",
        ),
        *(
            (
                robot,
                share(link.used_bytes_per_s, link.capacity_bytes_per_s, 1.0, look),
                f"{format_rate(link.used_bytes_per_s)} of {format_rate(link.capacity_bytes_per_s)}",
            )
            for robot, link in sample.links.items()
        ),
    ]


def _links(sample: HostSample) -> list[Row]:
    rows: list[Row] = [
        (
            Cell(robot, "name"),
            format_rate(link.capacity_bytes_per_s),
            link.capacity_source.value,
            format_rate(link.used_bytes_per_s),
            "-" if link.rtt_ms is None else f"{link.rtt_ms:.1f}ms",
        )
        for robot, link in sample.links.items()
    ]
    return [("ROBOT", "CAPACITY", "SOURCE", "USED", "RTT"), *rows] if rows else []


def _interfaces(found: Mapping[str, InterfaceSample]) -> list[Row]:
    rows: list[Row] = [
        (
            name,
            format_rate(each.rx_bytes_per_s),
            format_rate(each.tx_bytes_per_s),
            "-" if each.speed_bytes_per_s is None else format_rate(each.speed_bytes_per_s),
        )
        for name, each in found.items()
    ]
    return [("NAME", "IN", "OUT", "SPEED"), *rows] if rows else []


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
        ("Labels", _pairs(stated.labels)),
        ("Hosts", _rules(stated)),
        ("Ready", _check(stated.ready)),
        ("Done when", _check(stated.done_when)),
        ("Restart", stated.restart.value),
        ("Stop", f"{stated.stop.signal}, then KILL after {format_duration(stated.stop.grace)}"),
        ("Handoff", "; ".join([handoff.order.value, *hooks, *([f"within {format_duration(handoff.timeout)}"] if hooks else [])])),
        ("Host silent", _when_silent(stated)),
        ("Limits", _limits(stated)),
        ("Environment", _pairs(stated.env)),
        ("Env command", " ".join(stated.env_command)),
    ]


def _check(check: Check | None) -> str:
    return "" if check is None else f"{check.command!r} on {check.on} within {format_duration(check.timeout)}"


def _rules(stated: Task) -> str:
    rules = stated.hosts
    named = {"only": ", ".join(rules.only), "never": ", ".join(rules.never), "labels": _pairs(rules.labels), "pin": rules.pin}
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
    fields: list[tuple[str, str | Cell]] = [
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
    return [field for field in fields if field[1]]


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


def _pairs(values: Mapping[str, str]) -> str:
    """Names and values; a secret shows as its mask."""
    return ", ".join(f"{name}={text}" for name, text in values.items())


def host_details(name: str, value: Snapshot, inventory: Inventory, events: Sequence[Event]) -> Document:
    """One host as JSON types."""
    stated = inventory.hosts[name]
    contact = value.memory.contact.get(name) if value.memory else None
    return {
        "format_version": FORMAT_VERSION,
        "taken_at": format_instant(value.taken_at),
        **host_document(stated, value),
        **without_none(
            port=stated.port,
            user=stated.user,
            proxy_jump=stated.proxy_jump,
            runtime=stated.runtime.value,
            env={key: str(text) for key, text in stated.env.items()},
            last_contact=None if contact is None else format_instant(contact),
        ),
        "events": [events_view.line(event) for event in events],
    }


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
