# SPDX-License-Identifier: Apache-2.0
"""The memory of a task in a move: what goes along, what stays behind, and how it went last time."""

from collections.abc import Iterator, Mapping, Sequence

from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import ActionResult
from edgectl.model.standby import SaveMoment
from edgectl.model.task import Task, Tasks
from edgectl.units import format_bytes, format_duration
from edgectl.views.glossary import head
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns

LastMoves = Mapping[str, ActionResult]
"""By task, the last move that took its state along."""


def explain_taken_along(step: Step, task: Task | None, last: ActionResult | None) -> Iterator[str]:
    """One sentence on what this step, or else a move, does with the memory of the task; one on last time."""
    if task is None or not task.managed:
        return
    if task.state is None:
        if _is_move(step):
            yield "This move transfers nothing: the file of the task states no state."
        return
    subject = {Action.RESTART: "A move, unlike this restart,"}.get(step.action, "A move")
    subject = f"This move to {step.decision.host}" if _is_move(step) else subject
    yield f"{subject} transfers its state ({_describe_rule(task)}); {_describe_left(task)}."
    if last is not None:
        yield f"Last time: {describe_last_move(last)}."


def render_taken_along(plan: Plan, tasks: Tasks, last: LastMoves, look: RenderOptions = PLAIN) -> str:
    """By task that moves, starts anew or has state: what a move transfers, and how it went last time."""
    rows: list[Row] = [(*head("task", "now_host", "next_host"), *_HEAD)]
    for step in plan.steps:
        task = tasks.tasks.get(step.task)
        if task is None or not task.managed or not (task.state or _is_move(step)):
            continue
        moved = last.get(step.task)
        decision = step.decision
        rows.append(
            (
                Cell(step.task, "name"),
                decision.previous_host or "-",
                decision.host or "-",
                _describe_step(step, task),
                describe_last_move(moved) if moved is not None else "-",
            )
        )
    title = "State that moves transfer:\n"
    return title + render_columns(rows, look, wrap={3, 4}) if len(rows) > 1 else ""


_HEAD: Sequence[Cell] = (Cell("TRANSFERRED", "head"), Cell("LAST TIME", "head"))


def describe_last_move(action: ActionResult) -> str:
    """``10.0MB from edge1 to edge2, 0.4s old when loaded; save 0.1s, transfer 2.0s, load 0.2s``."""
    state = action.state
    if state is None:
        return "-"
    source = f" from {action.previous_host}" if action.previous_host else ""
    return (
        f"{format_bytes(state.size_bytes)}{source} to {state.host}, {format_duration(state.age_s)} old when "
        f"loaded; save {format_duration(state.save_s)}, transfer {format_duration(state.transfer_s)}, "
        f"load {format_duration(state.load_s)}"
    )


def _is_move(step: Step) -> bool:
    return step.action is Action.MOVE


def _describe_step(step: Step, task: Task) -> str:
    if task.state is None:
        return "nothing: its file states no state"
    if step.action is Action.RESTART:
        return "nothing: a restart begins empty"
    if step.action is Action.START:
        return "nothing, unless an interrupted move has left it"
    return _describe_rule(task) if _is_move(step) else f"nothing moves now; {_describe_rule(task)}"


def _describe_rule(task: Task) -> str:
    if task.state is None:
        return ""
    what = f"the last message of {task.state.topic}" if task.state.topic else "what save prints"
    return f"{what}, {_describe_moment(task)}"


def _describe_moment(task: Task) -> str:
    if _is_saved_inactive(task):
        return "while no instance is active"
    return "while the old instance is active" if task.standby is not None else "while the old instance runs"


def _describe_left(task: Task) -> str:
    """What stays behind."""
    if _is_saved_inactive(task):
        return "none of its output is lost"
    end = "its deactivation" if task.standby is not None else "its stop"
    return f"what changes between save and {end} is lost"


def _is_saved_inactive(task: Task) -> bool:
    """Whether the state of a warm move is saved once the old instance is inactive."""
    rule = task.state
    return task.standby is not None and rule is not None and rule.moment is SaveMoment.INACTIVE
