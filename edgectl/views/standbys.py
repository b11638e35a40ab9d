# SPDX-License-Identifier: Apache-2.0
"""Inactive copies of tasks: their steps in plans, and their states, in words and rows."""

from collections.abc import Callable, Iterator, Sequence

from edgectl.formats.document import Document
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan, Step
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.standby_plan import StandbyAction, StandbyReason, StandbyStep
from edgectl.model.task import Task, Tasks
from edgectl.rules.median import compute_median
from edgectl.units import format_duration
from edgectl.views.rows import compute_task_age, encode_run_row
from edgectl.views.state import TASK_STATE_STYLES, format_task_state
from edgectl.views.text import Cell, Row
from edgectl.views.usage import Amounts

# What stands in the column of the task in rows of its copies.
STANDBY_LABEL = "  standby"
_SYMBOLS = {
    StandbyAction.KEEP: ("=", "dim"), StandbyAction.START: ("+", "good"), StandbyAction.STOP: ("-", "bad"),
    StandbyAction.RESTART: ("^", "warn"), StandbyAction.ACTIVATE: ("~", "warn"),
    StandbyAction.DEACTIVATE: ("~", "warn"), StandbyAction.NONE: ("!", "bad"),
}  # fmt: skip
_READY_STATES = (TaskState.READY, TaskState.RUNNING)
_TEXTS: dict[StandbyReason, Callable[[StandbyStep], str]] = {
    StandbyReason.RUNNER_UP: lambda _: "the best host besides that of the task",
    StandbyReason.STILL_BEST: lambda _: "still the best host besides that of the task",
    StandbyReason.BELOW_MARGIN: lambda step: (
        f"{step.subject} leads by {step.amount or 0.0:.3f}, below move margin"
    ),
    StandbyReason.DWELL: lambda step: (
        f"{step.subject} leads; {format_duration(step.amount or 0.0)} left of min_dwell"
    ),
    StandbyReason.MOVES_FROZEN: lambda _: "too many edges do not answer; no standby is started",
    StandbyReason.HELD: lambda _: "its task is held",
    StandbyReason.OUTRANKED: lambda step: f"{step.subject or 'another host'} is better",
    StandbyReason.EXCLUDED: lambda _: "the task may not run there now",
    StandbyReason.NO_ROOM: lambda step: (
        f"no room on {step.subject}, the best host left" if step.subject else "no room there"
    ),
    StandbyReason.NO_HOST: lambda _: "no other host may run the task",
    StandbyReason.FAILED: lambda _: (
        "it failed there; edgectl reopen TASK, or a changed spec, starts it again"
    ),
    StandbyReason.NOT_WANTED: lambda _: "the task asks for none",
    StandbyReason.NOT_PLACED: lambda _: "its task has no host",
    StandbyReason.TASK_HERE: lambda step: (
        "it becomes the task" if step.action is StandbyAction.ACTIVATE else "the task starts there"
    ),
    StandbyReason.SPEC_CHANGED: lambda _: "its spec changed",
    StandbyReason.ORPHANED: lambda _: "its supervisor was lost",
    StandbyReason.LEFT_FILE: lambda _: "its task left the file",
    StandbyReason.OPERATOR: lambda _: "requested",
}


def describe_standby(task: str, step: StandbyStep) -> str:
    """The action on one copy and its reason, in one line."""
    word = "no standby" if step.action is StandbyAction.NONE else step.action.value
    reserved = format_reserved(step)
    text = _TEXTS[step.reason](step).replace("TASK", task)
    return f"{word}: {text}" + (f"; {reserved} reserved" if reserved else "")


def format_reserved(step: StandbyStep) -> str:
    """What is reserved for a copy: ``0.1 cores and 400Mi``; empty: nothing."""
    found = [
        resource.unit.format_in_text(step.demand[resource.name])
        for resource in HOST_RESOURCES
        if step.demand[resource.name]
    ]
    return " and ".join(found)


def render_standby_rows(step: Step, total: Callable[[float | None], str]) -> list[Row]:
    """The copies of a task below its row in the table of a plan."""
    rows: list[Row] = []
    for each in step.standbys:
        symbol, style = _SYMBOLS[each.action]
        now = each.host if each.instance and each.action is not StandbyAction.DEACTIVATE else None
        then = each.host if each.action.stays else None
        reason = Cell(describe_standby(step.task, each), style)
        rows.append(
            (Cell(symbol, style), STANDBY_LABEL, now or "-", then or "-", total(each.total), "", reason)
        )
    return rows


def count_standby_actions(value: Plan) -> list[str]:
    """``2 standbys to start``, for the line that counts the actions of a plan."""
    words = {
        StandbyAction.START: "to start", StandbyAction.RESTART: "to restart", StandbyAction.STOP: "to stop",
    }  # fmt: skip
    counts = {
        word: sum(each.action is action for step in value.steps for each in step.standbys)
        for action, word in words.items()
    }
    lacking = sum(each.host is None for step in value.steps for each in step.standbys)
    found = [f"{_count(number)} {word}" for word, number in counts.items() if number]
    return found + ([f"{_count(lacking)} without a host"] if lacking else [])


def _count(number: int) -> str:
    return f"{number} standby" + ("s" if number != 1 else "")


def explain_standbys(step: Step, manager: ManagerState | None) -> Iterator[str]:
    """One sentence for each copy that stands after the plan, with what it costs and what it saves."""
    for each in step.standbys:
        if each.host is None or not each.action.stays:
            yield f"Standby{f' on {each.host}' if each.host else ''}: {describe_standby(step.task, each)}."
            continue
        reserved = format_reserved(each) or "nothing"
        known = manager.downtimes.get((step.task, each.host), ()) if manager is not None else ()
        gap = f"; would be active in {_format_gap(compute_median(known))}" if known else ""
        yield f"Standby on {each.host} ({each.action.value}): {reserved} reserved{gap}."


def _format_gap(seconds: float) -> str:
    return f"{seconds * 1000.0:.0f}ms" if seconds < 1.0 else format_duration(seconds)


def list_standby_runs(value: Snapshot) -> list[tuple[str, str, TaskSample]]:
    """(task, host, sample) of every copy that any host reports, by task, then host."""
    return sorted(
        ((name, host, copy) for host, each in value.hosts.items() for name, copy in each.standbys.items()),
        key=lambda run: run[:2],
    )


def render_standby_state(copy: TaskSample) -> Cell:
    """``standby``, or what is wrong with it."""
    if copy.state in _READY_STATES:
        return Cell("standby", "good")
    return Cell(f"standby, {format_task_state(copy)}", TASK_STATE_STYLES[copy.state])


def describe_standby_fault(copy: TaskSample) -> str:
    """Why a copy could not be activated now; empty where it could."""
    if copy.state in _READY_STATES:
        return ""
    remedy = "; edgectl reopen, or a changed spec, starts it again" if copy.given_up else ""
    return f"{format_task_state(copy)}{remedy}"


def list_standby_faults(tasks: Tasks, value: Snapshot) -> list[str]:
    """The copies that could not be activated now, and the running tasks that have fewer than they ask for."""
    faults = [
        f"{name} on {host} ({format_task_state(copy)}{_format_age(copy, value)})"
        for name, host, copy in list_standby_runs(value)
        if copy.state not in _READY_STATES
    ]
    seen = list_standby_runs(value)
    for name, task in tasks.tasks.items():
        count = sum(each == name for each, _, _ in seen)
        if task.standby is not None and count < task.standby.hosts and _is_running(name, value):
            faults.append(f"{name} has {count} of {task.standby.hosts}")
    return faults


def _format_age(copy: TaskSample, value: Snapshot) -> str:
    age = compute_task_age(copy, value)
    return f" for {format_duration(age)}" if age is not None and copy.state.alive else ""


def _is_running(name: str, value: Snapshot) -> bool:
    return any(name in host.tasks and host.tasks[name].state.alive for host in value.hosts.values())


def encode_standby_row(name: str, host: str, copy: TaskSample, demand: Amounts, value: Snapshot) -> Document:
    """One copy as JSON types."""
    return encode_run_row(name, host, copy, demand, value) | {"standby": True}


def encode_standby_steps(step: Step) -> list[Document]:
    """What becomes of the copies of a task, as JSON types."""
    return [
        {
            "host": each.host,
            "action": each.action.value,
            "reason": describe_standby(step.task, each),
            "total": each.total,
            **{
                resource.name: {f"demand_{resource.unit.name}": each.demand[resource.name]}
                for resource in HOST_RESOURCES
                if each.demand[resource.name]
            },
        }
        for each in step.standbys
    ]


def describe_standby_rule(task: Task | None) -> str:
    """How many hosts keep a copy, and how it becomes active; empty: none is asked for."""
    if task is None or task.standby is None:
        return ""
    rule = task.standby.activation
    hosts = "1 host" if task.standby.hosts == 1 else f"{task.standby.hosts} hosts"
    if rule.lifecycle is not None:
        return f"on {hosts}; lifecycle of {rule.lifecycle}"
    commands: Sequence[str] = [
        f"{word} {check.command!r}"
        for word, check in (("activate", rule.activate), ("deactivate", rule.deactivate))
        if check is not None
    ]
    return "; ".join([f"on {hosts}", *commands])


def describe_state_rule(task: Task | None) -> str:
    """What a move takes along; empty: nothing."""
    if task is None or task.state is None:
        return ""
    if task.state.topic is not None:
        return f"topic {task.state.topic}"
    save, load = task.state.save, task.state.load
    moment = f"while {task.state.moment.value}"
    return f"save {save.command if save else ''!r} {moment}; load {load.command if load else ''!r}"
