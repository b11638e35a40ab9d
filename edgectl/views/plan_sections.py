# SPDX-License-Identifier: Apache-2.0
"""Parts of a plan as text: header, expected load, notes and summary."""

import dataclasses
from collections.abc import Collection

from edgectl.model.assignment import ExpectedLoad
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan
from edgectl.model.resource import HOST_RESOURCES, RESOURCES_BY_NAME
from edgectl.model.snapshot import (
    COUNTERS_INSTALLED,
    HostSample,
    LinkSample,
    Snapshot,
)
from edgectl.names import natural_key
from edgectl.rules.other_managers import describe_unlisted_host, list_tasks_on_unlisted_hosts
from edgectl.rules.slack import compute_slack
from edgectl.units import format_rate
from edgectl.views.demands import list_demand_notes
from edgectl.views.glossary import head_of_resource
from edgectl.views.notes import (
    join_first_words,
    join_words,
    list_lost_task_notes,
    list_unreachable_notes,
)
from edgectl.views.reasons import (
    describe_pin,
    describe_reason,
    is_left_out,
    is_not_found,
)
from edgectl.views.standbys import count_standby_actions
from edgectl.views.text import (
    PLAIN,
    Cell,
    RenderOptions,
    Row,
    escape_unprintable,
    render_columns,
    style_text,
    wrap_text,
)
from edgectl.views.usage import describe_capacity

# A link below this share of its nominal capacity is noted, up to so many of them.
_SLOW_LINK_SHARE, _MAX_LINKS = 0.9, 3
ACTION_STYLES = {
    Action.START: "good",
    Action.STOP: "bad",
    Action.MOVE: "warn",
    Action.RESTART: "warn",
    Action.ADOPT: "warn",
    Action.COMPLETE: "good",
    Action.KEEP: "dim",
    Action.NONE: "dim",
    Action.HOLD: "warn",
    Action.UNPLACED: "bad",
    Action.DEFER: "warn",
}


def format_utility(value: float | None, *, signed: bool = False) -> str:
    """A utility with three decimals, or a dash; never -0.000."""
    if value is None:
        return "-"
    shown = round(value, 3) + 0.0
    return f"{shown:+.3f}" if signed else f"{shown:.3f}"


def render_expected_load(value: Plan, look: RenderOptions = PLAIN) -> str:
    """Load of each host after the plan, against its measured or declared capacity."""
    rows: list[Row] = [("HOST", *map(head_of_resource, HOST_RESOURCES), "LINKS")]
    rows += [
        _render_expected_load_row(name, load, value.snapshot.hosts.get(name))
        for name, load in value.expected.items()
    ]
    return "Expected load after this plan:\n" + render_columns(rows, look) if value.expected else ""


def _render_expected_load_row(name: str, load: ExpectedLoad, sample: HostSample | None) -> Row:
    usage, links = (sample.usage, sample.links) if sample else ({}, {})
    return (
        Cell(name, "name"),
        *(
            _render_load_cell(
                load.used[resource.name],
                usage[resource.name].capacity if resource.name in usage else None,
                resource.unit.format(load.used[resource.name]),
            )
            if resource.name in usage or load.used[resource.name] or not resource.optional
            else Cell("-")
            for resource in HOST_RESOURCES
        ),
        ", ".join(
            _format_expected_link(robot, rate, links.get(robot)) for robot, rate in load.links.items() if rate
        )
        or "-",
    )


def _format_expected_link(robot: str, rate: float, link: LinkSample | None) -> str:
    return f"{robot} {format_rate(rate)}" + (
        f" ({rate / link.capacity_bytes_per_s:.0%})" if link and link.capacity_bytes_per_s else ""
    )


def _render_load_cell(used: float, capacity: float | None, shown: str) -> Cell:
    if not capacity:
        return Cell(shown)
    share = used / capacity
    return Cell(f"{shown} ({share:.0%})", "bad" if share > 1 else "")


def list_plan_notes(value: Plan) -> list[str]:
    """Notes on hosts, deferred tasks and demands."""
    lines = list_unreachable_notes(value.snapshot) + list_operator_mark_notes(value.snapshot)
    lines += list_lost_task_notes(value.snapshot, {step.task for step in value.steps})
    deferred = value.snapshot.manager.deferred if value.snapshot.manager else {}
    changing = (step.task for step in value.steps if step.action.changes)
    lines += [
        f"{task}: deferred by the last apply, unchanged: {deferred[task]}"
        for task in changing
        if task in deferred
    ]
    if value.frozen:
        lines.append("too many edges do not answer: no moves; starts are still allowed")
    if not value.settled:
        lines.append("no settled plan exists; running tasks stay where they are")
    if value.unseen:
        lines.append(
            f"first plan of this fleet: tasks on {join_words(value.unseen)} are not known "
            "and count as not running"
        )
    if value.certificate is not None:
        lines.append(value.certificate.describe())
    return (
        lines
        + list_load_notes(value)
        + list_down_link_notes(value.snapshot)
        + list_link_notes(value.snapshot)
        + list_partial_notes(value.snapshot)
        + list_demand_notes(value)
        + list_left_alone_notes(value)
    )


def list_link_notes(snapshot: Snapshot) -> list[str]:
    """Links that carry clearly less than their nominal capacity, the worst first."""
    slow = sorted(
        (link.capacity_bytes_per_s / link.nominal, edge, robot)
        for edge, sample in snapshot.hosts.items()
        for robot, link in sample.links.items()
        if link.nominal and link.capacity_bytes_per_s < _SLOW_LINK_SHARE * link.nominal
    )
    lines = [
        f"link {edge} - {robot} carries {describe_capacity(snapshot.hosts[edge].links[robot])}"
        for _, edge, robot in slow[:_MAX_LINKS]
    ]
    more = len(slow) - len(lines)
    return lines + ([f"{more} more links carry less than nominal: edgectl get links"] if more else [])


def list_down_link_notes(snapshot: Snapshot) -> list[str]:
    """Links that are down although both ends answer the manager."""
    down = [
        f"{edge} - {robot}"
        for edge, sample in snapshot.hosts.items()
        for robot, link in sample.links.items()
        if not link.capacity_bytes_per_s and robot in snapshot.hosts and snapshot.hosts[robot].ok
    ]
    if not down:
        return []
    return [f"link down, no task of the robot can run there: {join_first_words(down)}"]


def list_partial_notes(snapshot: Snapshot) -> list[str]:
    """Links whose traffic is seen only in part, by what it lacks: there the declared demand stands."""
    found: dict[str, list[str]] = {}
    for edge, sample in snapshot.hosts.items():
        for robot, link in sample.links.items():
            if link.partial:
                found.setdefault(link.partial, []).append(f"{edge} - {robot}")
    return [
        *(
            f"partial: {gap} on {join_first_words(links)}; the declared throughput stands there"
            for gap, links in found.items()
        ),
        *(
            f"byte counters of {edge} cannot be read: {sample.counters}"
            for edge, sample in snapshot.hosts.items()
            if sample.counters not in ("", COUNTERS_INSTALLED)
        ),
    ]


def list_load_notes(value: Plan) -> list[str]:
    """Tasks that use more than they declare, what the fleet lacks, and how far noisy hosts are overloaded."""
    return [
        *(found.describe() for found in value.shortages),
        *(found.describe_run() for found in value.overuses),
        *list_slack_notes(value, {step.task for step in value.steps}),
    ]


def list_slack_notes(value: Plan, tasks: Collection[str]) -> list[str]:
    """The slack of each host of ``tasks`` that is over capacity and whose noise widens it (ADR 83)."""
    known = value.snapshot.manager.noise if value.snapshot.manager is not None else {}
    over = {step.decision.host for step in value.steps if step.decision.overcommitted and step.task in tasks}
    return [
        f"{host} may be up to {compute_slack(RESOURCES_BY_NAME[name], noise):.1%} above its {name} capacity "
        f"before a task leaves: its readings vary by {noise:.1%}"
        for host in sorted((host for host in over if host is not None), key=natural_key)
        for name, noise in known.get(host, {}).items()
        if name in RESOURCES_BY_NAME
    ]


def list_left_alone_notes(value: Plan) -> list[str]:
    """One line that counts the tasks of other task files, which the plan leaves alone."""
    count = len(value.tasks_left_alone)
    if not count:
        return []
    files = sorted({file for file in value.tasks_left_alone.values() if file}, key=natural_key)
    where = f" ({join_first_words(files)})" if files else ""
    return [
        f"1 task of another file{where} runs on; --prune stops it: {next(iter(value.tasks_left_alone))}"
        if count == 1
        else f"{count} tasks of other files{where} run on; --prune stops them: "
        + join_first_words(value.tasks_left_alone)
    ]


def list_operator_mark_notes(value: Snapshot) -> list[str]:
    """One line for each mark of the operator with its hosts, and for each pinned task."""
    memory = value.manager or ManagerState()
    pinned = sorted(
        (task for task, pin in memory.pins.items() if pin.is_active(value.taken_at)), key=natural_key
    )
    fenced, draining = sorted(memory.fenced, key=natural_key), sorted(memory.draining, key=natural_key)
    cordoned = sorted(memory.cordons - memory.draining, key=natural_key)
    lines = [f"cordoned, no new tasks: {join_words(cordoned)} (edgectl uncordon)"] if cordoned else []
    lines += [f"draining, tasks move away: {join_words(draining)} (edgectl uncordon)"] if draining else []
    lines += [f"fenced, treated as powered off: {join_words(fenced)} (edgectl unfence)"] if fenced else []
    return lines + [f"{task} is {describe_pin(memory.pins[task])} (edgectl unpin {task})" for task in pinned]


def render_plan_summary(value: Plan, look: RenderOptions = PLAIN) -> str:
    """One line that counts the actions."""
    counts = value.summary
    aside = sum(is_left_out(step) for step in value.steps)
    missing = sum(is_not_found(step) for step in value.steps)
    copies = any(each.host is None for step in value.steps for each in step.standbys)
    if (
        not copies
        and not value.changes
        and not aside
        and not missing
        and not counts.get(Action.UNPLACED)
        and not counts.get(Action.HOLD)
    ):
        return style_text("No changes." + _describe_unchanged_tasks(len(value.steps)), "good", look) + "\n"
    text = (
        f"Plan: {counts.get(Action.START, 0)} to start, {counts.get(Action.MOVE, 0)} to move, "
        f"{_count_stops(value)} to stop, "
        f"{counts.get(Action.KEEP, 0)} kept, {counts.get(Action.UNPLACED, 0)} unplaced"
    )
    rare = {**counts, Action.NONE: counts.get(Action.NONE, 0) - aside - missing}
    extra = [f"{rare[action]} {word}" for action, word in _RARE_ACTION_TEXTS.items() if rare.get(action)]
    extra += [f"{missing} not managed and found nowhere"] if missing else []
    extra += [f"{aside} left out"] if aside else []
    extra += count_standby_actions(value)
    return (
        style_text(wrap_text(", ".join([text, *extra]) + ".", look).removesuffix("\n"), "bold", look) + "\n"
    )


_RARE_ACTION_TEXTS = {
    Action.RESTART: "to restart",
    Action.ADOPT: "to adopt",
    Action.HOLD: "held",
    Action.COMPLETE: "to complete",
    Action.DEFER: "deferred",
    Action.NONE: "completed before",
}


def _count_stops(value: Plan) -> int:
    return value.summary.get(Action.STOP, 0) + sum(
        1 for step in value.steps if step.stop and step.action in (Action.KEEP, Action.HOLD, Action.NONE)
    )


def _describe_unchanged_tasks(count: int) -> str:
    return (
        ""
        if not count
        else " 1 task is where it should be."
        if count == 1
        else f" {count} tasks are where they should be."
    )


def render_unreachable_hosts(value: Snapshot, names: Collection[str]) -> str:
    """The hosts of ``names``, each with the cause, the remedy and the time since the last contact."""
    hosts = {name: host for name, host in value.hosts.items() if name in names}
    return "".join(
        f"{escape_unprintable(line)}\n"
        for line in list_unreachable_notes(dataclasses.replace(value, hosts=hosts))
    )


def render_lost_tasks(value: Plan) -> str:
    """The tasks whose place the inventory no longer reaches, or may not know, each with the remedy."""
    unlisted = list_tasks_on_unlisted_hosts(value)
    lines = [f"{task} {describe_unlisted_host(host)}" for task, host in unlisted.items()]
    lines = [*list_lost_task_notes(value.snapshot), *lines]
    return "".join(f"{escape_unprintable(line)}\n" for line in lines)


def render_unplaced_tasks(value: Plan) -> str:
    """The tasks that have no host."""
    return "".join(
        f"{escape_unprintable(f'{step.task}: {describe_reason(step)}')}\n"
        for step in value.steps
        if step.action is Action.UNPLACED
    )
