"""The default form: aligned columns for people, with units in the fields and a last line that sums up."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping

from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import ActionResult, Outcome, PhaseResult, Results
from edgectl.model.revision import Revision, RevisionOutcome
from edgectl.model.snapshot import (
    BandwidthMeasurement,
    HostSample,
    LinkSample,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.model.task import Task, Tasks
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views.describe_host import render_host_details as host_details  # noqa: F401
from edgectl.views.describe_task import render_task_details as task_details  # noqa: F401
from edgectl.views.diagnosis import render_diagnosis as diagnosis  # noqa: F401  (a form of its own module)
from edgectl.views.events import render_events as events  # noqa: F401
from edgectl.views.events import render_more_events as events_more  # noqa: F401
from edgectl.views.explanation import render_explanation as explanation  # noqa: F401  (a form of its own module)
from edgectl.views.listing import render_listing as listing  # noqa: F401
from edgectl.views.listing import render_listing_changes as listing_more  # noqa: F401
from edgectl.views.plan_sections import (
    ACTION_STYLES,
    format_utility,
    list_operator_mark_notes,
    list_unreachable_notes,
    render_expected_load,
    render_notes,
    render_plan_header,
    render_plan_notes,
    render_plan_summary,
)
from edgectl.views.profile import render_profiles as profile  # noqa: F401
from edgectl.views.profilers import render_profilers as profilers  # noqa: F401
from edgectl.views.reasons import describe_reason, is_left_out
from edgectl.views.state import (
    TASK_STATE_STYLES,
    format_silence,
    format_task_state,
    list_task_remarks,
    render_host_status,
    resolve_absent_task,
)
from edgectl.views.text import (
    PLAIN,
    Cell,
    RenderOptions,
    Row,
    escape_unprintable,
    is_within_width,
    render_columns,
    style_text,
)
from edgectl.views.top import render_top_hosts as top_hosts  # noqa: F401
from edgectl.views.top import render_top_tasks as top_tasks  # noqa: F401
from edgectl.views.usage import ResourceAmounts, compute_task_demand, format_or_dash

_OUTCOME_STYLES = {
    Outcome.DONE: "good",
    Outcome.FAILED: "bad",
    Outcome.DEFERRED: "warn",
    Outcome.SKIPPED: "dim",
}


def plan(value: Plan, look: RenderOptions = PLAIN) -> str:
    """What will be done and why, the load that is expected afterwards, and one line that sums up."""
    rows: list[Row] = [("", "TASK", "NOW", "NEXT", "UTILITY", "LEAD", "REASON")]
    rows += [_render_step_row(step) for step in value.steps]
    table = render_columns(rows, look, right={4, 5}, wrap={1, 2, 3}) if value.steps else ""
    head = render_plan_header(value, look) if value.expected else ""
    return "\n".join(
        part
        for part in (
            head,
            table,
            render_expected_load(value, look),
            render_plan_notes(value, look) + render_plan_summary(value, look),
        )
        if part
    )


def _render_step_row(step: Step) -> Row:
    decision, style = step.decision, ACTION_STYLES[step.action]
    return (
        Cell(step.action.symbol, style),
        Cell(step.task, "name"),
        decision.previous_host or "-",
        Cell(_find_next_host(step) or "-", "bold" if step.action.changes else ""),
        format_utility(decision.total),
        format_utility(decision.lead, signed=True),
        Cell(describe_reason(step), style),
    )


def _find_next_host(step: Step) -> str | None:
    """Where the task is after the plan."""
    if is_left_out(step):
        return step.decision.previous_host
    return None if step.action in (Action.STOP, Action.COMPLETE, Action.NONE) else step.decision.host


def snapshot(value: Snapshot, look: RenderOptions = PLAIN) -> str:
    """One line per host: what it has, what is in use, its links and tasks."""
    rows: list[Row] = [("NAME", "ROLE", "STATUS", "CPU", "MEMORY", "TASKS", "LINKS")]
    rows += [_render_snapshot_host_row(name, host, value) for name, host in value.hosts.items()]
    return render_columns(rows, look, wrap={0, 2}) + render_notes(list_unreachable_notes(value), look)


def _render_snapshot_host_row(name: str, host: HostSample, value: Snapshot) -> Row:
    if not host.ok or not host.measured:
        return (
            Cell(name, "name"),
            host.role,
            render_host_status(name, host, value.manager),
            "-",
            "-",
            "-",
            "-",
        )
    return (
        Cell(name, "name"),
        host.role,
        render_host_status(name, host, value.manager),
        _render_used_cell(host.usage["cpu"].used, host.usage["cpu"].capacity, format_cores),
        _render_used_cell(host.usage["memory"].used, host.usage["memory"].capacity, format_bytes),
        str(sum(task.state.alive for task in host.tasks.values())),
        ", ".join(_format_link_share(robot, link) for robot, link in host.links.items()) or "-",
    )


def _render_used_cell(used: float, capacity: float, show: Callable[[float], str]) -> Cell:
    share = used / capacity
    return Cell(f"{show(used)}/{show(capacity)} ({share:.0%})", "bad" if share > 1 else "")


def _format_link_share(robot: str, link: LinkSample) -> str:
    share = (
        f" {link.used_bytes_per_s / link.capacity_bytes_per_s:.0%}" if link.capacity_bytes_per_s else " down"
    )
    return f"{robot}{share}" + (f" {link.rtt_ms:.1f}ms" if link.rtt_ms is not None else "")


def status(value: Snapshot, inventory: Inventory, tasks: Tasks, look: RenderOptions = PLAIN) -> str:
    """What runs where, since when, and what it uses against its demand; tasks that do not run, and silent hosts, too."""
    rows: list[Row] = [
        ("TASK", "HOST", "STATE", "AGE", "CPU", "DEMAND", "MEMORY", "DEMAND", "NETWORK", "DEMAND")
    ]
    rows += [
        _render_status_row(name, host, sample, tasks.tasks.get(name), inventory, value)
        for name, host, sample in list_task_runs(value)
    ]
    seen = {name for name, _, _ in list_task_runs(value)}
    rows += [_render_absent_status_row(task, value) for task in tasks.tasks.values() if task.name not in seen]
    fitting = (
        rows
        if is_within_width([(*row[:2], TaskState.COMPLETED, *row[3:]) for row in rows], look)
        else _stack_demand_rows(rows)
    )  # a state may wrap
    return render_columns(fitting, look, wrap={0, 1, 2}) + render_notes(
        list_unreachable_notes(value) + list_operator_mark_notes(value) + list_task_remarks(value), look
    )


def _stack_demand_rows(rows: list[Row]) -> Iterator[Row]:
    """For a narrow terminal: the demands on a row of their own below what is used."""
    yield (*rows[0][:4], *rows[0][4::2])
    for row in rows[1:]:
        yield (*row[:4], *row[4::2])
        if any(demand != "-" for demand in row[5::2]):
            yield ("", "", "", "demand", *row[5::2])


def list_task_runs(value: Snapshot) -> list[tuple[str, str, TaskSample]]:
    """(task, host, sample) of every task that any host reports, by task, then host."""
    every = [
        (name, host, sample) for host, each in value.hosts.items() for name, sample in each.tasks.items()
    ]
    return sorted(every, key=lambda entry: entry[:2])


def _render_status_row(
    name: str, host: str, sample: TaskSample, task: Task | None, inventory: Inventory, value: Snapshot
) -> Row:
    demand = (
        compute_task_demand(task, inventory.hosts.get(host), value.hosts[host], value.manager)
        if task
        else ResourceAmounts()
    )
    state = Cell(format_task_state(sample), TASK_STATE_STYLES[sample.state])
    alive = sample.state.alive
    return (
        Cell(name, "name"),
        host,
        state,
        format_duration(max(0.0, value.taken_at - sample.started_at)) if sample.started_at else "-",
        format_cores(sample.used["cpu"]) if alive else "-",
        format_or_dash(demand.cores, format_cores),
        format_bytes(sample.used["memory"]) if alive else "-",
        format_or_dash(demand.bytes, format_bytes),
        format_rate(sample.used["network"]) if alive else "-",
        format_or_dash(demand.rate, format_rate),
    )


def _render_absent_status_row(task: Task, value: Snapshot) -> Row:
    """A task that no host reports: completed, on a host that does not answer, or not running."""
    known = resolve_absent_task(task, value)
    state = Cell(known.state + format_silence(known.contact, value.taken_at), "warn" if known.host else "dim")
    return (Cell(task.name, "name"), known.host or "-", state, "-", "-", "-", "-", "-", "-", "-")


def results(value: Results, look: RenderOptions = PLAIN) -> str:
    """How each action went, with its phases, and one line that sums up."""
    rows = [_render_result_row(action) for action in value.actions]
    done = sum(action.outcome is Outcome.DONE for action in value.actions)
    text = f"Applied {done} of {len(value.actions)} in {format_duration(value.seconds)}. Revision {value.revision}."
    stopped = " Interrupted." if value.interrupted else ""
    return (
        render_columns(rows, look, wrap={1})
        + style_text(text + stopped, "bold" if value.done else "bad", look)
        + "\n"
        + render_hints(value.actions)
    )


def drained(passes: Iterable[Results], _left: object, _done: object, look: RenderOptions = PLAIN) -> str:
    """Every pass of a drain."""
    return "\n".join(results(each, look) for each in passes)


def history(values: Iterable[Revision], look: RenderOptions = PLAIN) -> str:
    """One line per revision, oldest first."""
    rows: list[Row] = [("REV", "WHEN", "WHO", "VERB", "TOOK", "OUTCOME", "ACTIONS")]
    rows += [_render_revision_row(value) for value in values]
    return render_columns(rows, look, right={0, 4}) if len(rows) > 1 else "Nothing was applied yet.\n"


def _render_revision_row(value: Revision) -> Row:
    return (
        Cell(str(value.number), "name"),
        format_instant(math.floor(value.began_at)),
        value.user or "-",
        value.verb or "-",
        "-" if value.seconds is None else format_duration(value.seconds),
        Cell(value.ending.value, "good" if value.ending is RevisionOutcome.DONE else "bad"),
        ", ".join(f"{count} {action}" for action, count in value.counts.items()) or "-",
    )


def revision(value: Revision, look: RenderOptions = PLAIN) -> str:
    """One revision: when, who, how, and each action with its phases."""
    return (
        history([value], look)
        + "\n"
        + render_columns([_render_result_row(action) for action in value.actions], look, wrap={1})
    )


def _render_result_row(action: ActionResult) -> Row:
    return (
        Cell(action.action.symbol, ACTION_STYLES[action.action]),
        Cell(action.task, "name"),
        Cell(action.outcome.value, _OUTCOME_STYLES[action.outcome]),
        format_action_result(action),
    )


def format_action_result(action: ActionResult) -> str:
    """The phases of one action, the gap it caused, and its error."""
    parts = [" > ".join(_format_phase_result(phase) for phase in action.phases)] if action.phases else []
    if action.downtime_s is not None:
        parts.append(f"gap {format_duration(action.downtime_s)}")
    if action.error and not any(phase.detail == action.error for phase in action.phases if not phase.ok):
        parts.append(action.error)
    return "; ".join(parts) or str(action.action)


def _format_phase_result(phase: PhaseResult) -> str:
    failed = "" if phase.ok else " FAILED"
    return f"{phase.phase} {phase.host} {format_duration(phase.seconds)}{failed}" + (
        f" ({phase.detail})" if phase.detail and not phase.ok else ""
    )


def render_hints(actions: Iterable[ActionResult]) -> str:
    """The hints of the actions that did not go well, each once."""
    return "".join(
        f"hint: {escape_unprintable(hint)}\n"
        for hint in dict.fromkeys(action.hint for action in actions)
        if hint
    )


def validated(inventory: Inventory, tasks: Tasks, look: RenderOptions = PLAIN) -> str:
    """What two good files hold."""
    managed = sum(task.managed for task in tasks.tasks.values())
    unmanaged = f", {len(tasks.tasks) - managed} not managed" if managed < len(tasks.tasks) else ""
    sizes = {"edge": len(inventory.edges), "robot": len(inventory.robots), "task": len(tasks.tasks)}
    counts = (
        ", ".join(f"{count} {what}{'' if count == 1 else 's'}" for what, count in sizes.items()) + unmanaged
    )
    return style_text("ok:", "good", look) + f" {counts}\n"


def bandwidth(value: Snapshot, links: Iterable[BandwidthMeasurement], look: RenderOptions = PLAIN) -> str:
    """What each link was just measured to carry, then the snapshot."""
    return render_link_bandwidths(links, look) + "\n" + snapshot(value, look)


def render_link_bandwidths(links: Iterable[BandwidthMeasurement], look: RenderOptions = PLAIN) -> str:
    """What each link was measured to carry."""
    rows: list[Row] = [("EDGE", "ROBOT", "CARRIED")]
    rows += [(each.edge, each.robot, _render_bandwidth_cell(each)) for each in links]
    return render_columns(rows, look)


def _render_bandwidth_cell(value: BandwidthMeasurement) -> str | Cell:
    return Cell(value.error, "bad") if value.bytes_per_s is None else format_rate(value.bytes_per_s)


def commands(values: Iterable[Mapping[str, object]], look: RenderOptions = PLAIN) -> str:
    """What would be sent: for each request a heading, the command line and its standard input."""
    parts = []
    for value in values:
        heading = style_text(f"# {value['host']}: {value['phase']} {value['task']}", "dim", look)
        stdin = json.dumps(value["stdin"], ensure_ascii=True)
        parts.append(f"{heading}\n{escape_unprintable(str(value['command']))}\n<<< {stdin}\n")
    return "\n".join(parts) or "nothing to send\n"


def fields(values: Mapping[str, str], look: RenderOptions = PLAIN) -> str:
    """Names and values, one pair per line."""
    return render_columns([(Cell(name, "name"), text) for name, text in values.items()], look)
