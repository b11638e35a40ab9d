# SPDX-License-Identifier: Apache-2.0
"""Details of a task: its specification, its runs, the decision of a plan and the last events."""

from collections.abc import Sequence

from edgectl.formats.document import Document
from edgectl.formats.event_document import encode_event
from edgectl.model.check import Check
from edgectl.model.event import Event
from edgectl.model.image import ContainerImage, PullPolicy
from edgectl.model.inventory import Inventory
from edgectl.model.latency import HeardRule, LatencyRule, LatencySample
from edgectl.model.manager_state import ManagerState, Pin
from edgectl.model.plan import Step
from edgectl.model.resource import RESOURCES
from edgectl.model.snapshot import Snapshot, TaskSample
from edgectl.model.task import Task, Tasks, list_node_names
from edgectl.units import format_bytes, format_cores, format_duration, format_instant
from edgectl.views import metrics
from edgectl.views.describe import Field, format_pairs, render_events_section, render_fields, render_section
from edgectl.views.glossary import head
from edgectl.views.latency import format_ms
from edgectl.views.output import ItemView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.reasons import describe_pin, describe_reason
from edgectl.views.rows import encode_pin, encode_run_row, find_task_demand
from edgectl.views.standbys import (
    describe_standby,
    describe_standby_rule,
    describe_state_rule,
    encode_standby_row,
    list_standby_runs,
    render_standby_state,
)
from edgectl.views.state import TASK_STATE_STYLES, format_silence, format_task_state, resolve_absent_task
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row
from edgectl.views.usage import (
    Amounts,
    format_or_dash,
    format_traffic,
    render_difference,
    subtract_demand,
)


class TaskDetailsView(ItemView):
    """One task; of one that no file names, only its runs.

    ``step``: the decision of a plan made now; None: none was made. ``events``: the last ones, oldest first;
    None: not asked for.
    """

    kind = "task"
    formats = ITEM_FORMATS

    def __init__(
        self,
        name: str,
        snapshot: Snapshot,
        inventory: Inventory,
        tasks: Tasks,
        step: Step | None,
        events: Sequence[Event] | None,
    ) -> None:
        self._name, self._snapshot, self._inventory, self._tasks = name, snapshot, inventory, tasks
        self._step, self._events = step, events
        self._task = tasks.tasks.get(name)
        self._runs = _select_task_runs(name, snapshot)
        self._copies = [(host, copy) for task, host, copy in list_standby_runs(snapshot) if task == name]

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Fields, then each run with its usage and metrics, then events."""
        fields: list[Field] = [("Name", Cell(self._name, "name"))]
        fields += (
            _list_spec_fields(self._task)
            if self._task
            else [("Command", Cell("not in the task files", "warn"))]
        )
        fields += _list_placement_fields(self._name, self._task, self._snapshot, self._step)
        parts = [render_fields(fields, look)]
        for host, sample in self._runs:
            parts += self._render_run(host, sample, look)
        for host, copy in self._copies:
            rows = _render_run_rows(copy, self._snapshot.taken_at, render_standby_state(copy))
            parts.append(render_section(f"Standby on {host}", rows, look))
        return "".join([*parts, render_events_section(self._events, look)])

    def _render_run(self, host: str, sample: TaskSample, look: RenderOptions) -> list[str]:
        usage = _render_usage_rows(sample, self._find_demand(host))
        measured = [(name, metrics.format_metric(each)) for name, each in sample.metrics.items()]
        return [
            render_section(f"On {host}", _render_run_rows(sample, self._snapshot.taken_at), look),
            render_section(f"Usage on {host}", usage, look, right={1, 2, 3}),
            render_section(f"Latency on {host}", _render_latency(sample.latency), look),
            render_section(f"Metrics on {host}", measured, look),
            render_section("Last output", [(line,) for line in sample.log_tail], look),
        ]

    def _find_demand(self, host: str) -> Amounts:
        return find_task_demand(self._name, host, self._snapshot, self._inventory, self._tasks)

    def item(self) -> Document:
        """The task as JSON types."""
        memory = self._snapshot.manager or ManagerState()
        placed = memory.placements.get(self._name)
        downtimes = _select_downtimes(self._name, memory)
        return {
            "task": self._name,
            "taken_at": format_instant(self._snapshot.taken_at),
            "spec": None if self._task is None else _encode_task_spec(self._task),
            "runs": [
                encode_run_row(self._name, host, sample, self._find_demand(host), self._snapshot)
                for host, sample in self._runs
            ],
            "standbys": [
                encode_standby_row(self._name, host, copy, {}, self._snapshot) for host, copy in self._copies
            ],
            "placement": None
            if placed is None
            else {"host": placed.host, "placed_at": format_instant(placed.since)},
            "pin": encode_pin(memory.pins.get(self._name), self._snapshot.taken_at),
            "downtimes_s": {host: list(found) for host, found in downtimes.items()},
            "decision": None if self._step is None else encode_decision(self._step),
            "events": [encode_event(event) for event in self._events or ()],
        }


def _list_spec_fields(stated: Task) -> list[Field]:
    handoff = stated.handoff
    checks = {"safe when": handoff.safe_when, "hold": handoff.hold, "release": handoff.release}
    hooks = [f"{what} {_format_check(check)}" for what, check in checks.items() if check is not None]
    return [
        ("Template", stated.template if stated.template != stated.name else ""),
        ("Kind", stated.kind.value if stated.managed else f"{stated.kind.value}, not managed"),
        ("Command", stated.command),
        ("Image", _format_image(stated.image)),
        ("Workdir", stated.workdir or ""),
        ("Nodes", ", ".join(list_node_names(stated))),
        ("Robots", ", ".join(stated.robots)),
        ("Needs", ", ".join(f"{need.task} ({need.until})" for need in stated.needs)),
        ("Priority", f"{stated.priority:g}" if stated.priority else ""),
        ("Deadline", _format_deadline(stated)),
        ("Latency", _format_latency_rule(stated.latency)),
        ("Heard", _format_heard(stated.heard)),
        ("Labels", format_pairs(stated.labels)),
        ("Hosts", _format_host_rules(stated)),
        ("Ready", _format_check(stated.ready)),
        ("Alive", _format_check(stated.alive.check if stated.alive is not None else None)),
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
                    *_list_state_parts(stated),
                ]
            ),
        ),
        ("Standby", describe_standby_rule(stated)),
        ("State", describe_state_rule(stated)),
        ("Unreachable", _format_unreachable_policy(stated)),
        ("Limits", _format_task_limits(stated)),
        ("Environment", format_pairs(stated.env)),
        ("Env command", " ".join(stated.env_command)),
    ]


def _format_image(image: ContainerImage | None) -> str:
    """The container of a task; what is at its default is left out."""
    if image is None:
        return ""
    parts = [image.name, *([image.engine.value] if image.engine is not None else [])]
    parts += [f"gpus {image.gpus}"] if image.gpus is not None else []
    parts += [f"user {image.user}"] if image.user is not None else []
    parts += [
        f"{name} {value}"
        for name, value in (("network", image.network), ("ipc", image.ipc))
        if value != "host"
    ]
    parts += [f"pull {image.pull.value}"] if image.pull is not PullPolicy.MISSING else []
    return ", ".join([*parts, *image.devices, *image.volumes, *image.args])


def _format_deadline(stated: Task) -> str:
    if stated.deadline is None:
        return ""
    return format_duration(stated.deadline) + (", hard" if stated.hard_deadline else "")


def _format_latency_rule(rule: LatencyRule | None) -> str:
    if rule is None:
        return ""
    return f"metric {rule.metric}" if rule.metric else f"{rule.stamp} of topic {rule.topic} on {rule.on}"


def _format_heard(heard: HeardRule | None) -> str:
    if heard is None:
        return ""
    what = f"topic {heard.topic}" if heard.topic else repr(heard.command)
    return f"{what} on robot within {format_duration(heard.within)}"


def _format_check(check: Check | None) -> str:
    if check is None:
        return ""
    asked = repr(check.command) if check.ros is None else check.describe()
    return f"{asked} on {check.on} within {format_duration(check.timeout)}"


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
        ("Pinned", _format_pin(memory.pins.get(name), value.taken_at)),
        ("Deferred", memory.deferred.get(name, "")),
        ("Decision", describe_reason(step) if step is not None else ""),
        *(
            (f"Standby on {each.host or '-'}", describe_standby(name, each))
            for each in (step.standbys if step is not None else ())
        ),
    ]


def _format_pin(pin: Pin | None, now: float) -> str:
    if pin is None or not pin.is_active(now):
        return ""
    return describe_pin(pin).removeprefix("pinned ") + f", since {format_instant(int(pin.since))}"


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


def _render_run_rows(sample: TaskSample, now: float, state: Cell | None = None) -> list[Row]:
    since = _format_ago(sample.started_at, now) if sample.started_at else ""
    found: list[Field] = [
        ("State:", state or Cell(format_task_state(sample), TASK_STATE_STYLES[sample.state])),
        ("Since:", since),
        ("Ended:", "" if sample.ended_at is None else _format_ago(sample.ended_at, now)),
        ("Process:", str(sample.pid or "")),
        ("Container:", sample.container),
        ("Restarts:", str(sample.restarts)),
        ("Last exit:", "" if sample.last_exit is None else str(sample.last_exit)),
        ("Exit code:", "" if sample.exit_code is None else str(sample.exit_code)),
        ("Limits:", sample.limits),
        ("Generation:", str(sample.generation or "")),
        ("Instance:", sample.instance),
    ]
    return [field for field in found if field[1]]


def _render_latency(latency: LatencySample | None) -> list[Row]:
    if latency is None:
        return []
    if latency.error or not latency.count:
        return [("State:", latency.error or "no value yet")]
    percentiles = {"p50": latency.p50_ms, "p95": latency.p95_ms, "p99": latency.p99_ms, "max": latency.max_ms}
    recent = ", ".join(
        f"{name} {format_ms(value)}" for name, value in percentiles.items() if value is not None
    )
    values = f"{latency.recent_count} values in {format_duration(latency.recent_s)}"
    found: list[Row] = [
        ("Recent:", f"{recent} of {values}" if recent else "no value in the last minutes"),
        ("Mean:", f"{format_ms(latency.sum_ms / latency.count)} of {latency.count} values of this instance"),
    ]
    if latency.bound_ms is not None:
        missed = f"{latency.recent_misses} recently, {latency.misses} of this instance"
        found.append(("Misses:", f"{missed} above {format_ms(latency.bound_ms)}"))
    if latency.age_s is not None:
        found.append(("Last value:", f"{format_duration(latency.age_s)} ago"))
    return found


def _format_ago(at: float, now: float) -> str:
    """An instant, and the time that has passed since."""
    return f"{format_instant(int(at))} ({format_duration(max(0.0, now - at))})"


def _render_usage_rows(sample: TaskSample, demand: Amounts) -> list[Row]:
    excess = subtract_demand(sample, demand)
    rows: list[Row] = []
    for resource in RESOURCES:
        name, show = resource.name, resource.unit.format
        if resource.optional and name not in demand:
            continue
        used = "-" if resource.optional else show(sample.used[name])
        if resource.per_link:
            used = format_traffic(used, sample.partial)
        difference = render_difference(excess.get(name), demand.get(name), show)
        rows.append((name, used, format_or_dash(demand.get(name), show), difference))
    return [head("resource", "used", "demand", "excess"), *rows] if sample.state.alive else []


def _list_state_parts(stated: Task) -> list[str]:
    """What takes the state of a task along in a move."""
    rule = stated.state
    if rule is None:
        return []
    parts = {"save": _format_check(rule.save), "load": _format_check(rule.load), "state of": rule.topic}
    return [f"{what} {text}" for what, text in parts.items() if text]


def _encode_task_spec(stated: Task) -> Document:
    handoff = stated.handoff
    hooks = {"safe_when": handoff.safe_when, "hold": handoff.hold, "release": handoff.release}
    if stated.state is not None:
        hooks |= {"save": stated.state.save, "load": stated.state.load}
    return {
        "template": stated.template,
        "task_kind": stated.kind.value,
        "managed": stated.managed,
        "command": stated.command,
        "image": None if stated.image is None else stated.image.name,
        "node_names": list(list_node_names(stated)),
        "robot_names": list(stated.robots),
        "needs": [{"task": need.task, "until": need.until.value} for need in stated.needs],
        "priority": stated.priority,
        "deadline_s": stated.deadline,
        "hard_deadline": stated.hard_deadline,
        "labels": dict(stated.labels),
        "restart": stated.restart.value,
        "handoff": {
            "order": handoff.order.value,
            **{key: check.command for key, check in hooks.items() if check is not None},
            **({} if stated.state is None or stated.state.topic is None else {"topic": stated.state.topic}),
        },
        "on_unreachable": stated.on_unreachable.value,
        "env": {key: str(text) for key, text in stated.env.items()},
    }


def encode_decision(step: Step) -> Document:
    """What a plan decided of a task, in short."""
    decision = step.decision
    return {
        "action": step.action.value,
        "reason": describe_reason(step),
        "host": decision.host,
        "previous_host": decision.previous_host,
        "total": decision.total,
        "lead": decision.lead,
    }
