"""Tasks, what they need and where they are placed, as a picture's parts."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from edgectl.model.plan import Action, Plan, Step
from edgectl.model.task import Tasks
from edgectl.views.plan_sections import format_utility

UNPLACED_GROUP = "unplaced"


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskGraph:
    """``hosts``: by host (``NOWHERE`` last, where needed) its tasks with a label of one or two lines. ``needs``: (predecessor, task)."""

    hosts: Mapping[str, tuple[tuple[str, str], ...]]
    needs: tuple[tuple[str, str], ...]


def build_task_graph(plan: Plan, tasks: Tasks) -> TaskGraph:
    """The plan as it will stand; tasks that end or have ended are left out."""
    shown = [step for step in plan.steps if step.action not in (Action.STOP, Action.COMPLETE, Action.NONE)]
    names = {step.task for step in shown}
    order = (
        *plan.expected,
        *sorted({step.decision.host for step in shown if step.decision.host} - set(plan.expected)),
    )
    hosts = {host: _label_tasks(step for step in shown if step.decision.host == host) for host in order}
    lost = _label_tasks(step for step in shown if step.decision.host is None)
    needs = [
        (need.task, name)
        for name, task in tasks.tasks.items()
        for need in task.needs
        if {need.task, name} <= names
    ]
    return TaskGraph(hosts=hosts | ({UNPLACED_GROUP: lost} if lost else {}), needs=tuple(needs))


def _label_tasks(steps: Iterable[Step]) -> tuple[tuple[str, str], ...]:
    return tuple((step.task, _format_task_label(step)) for step in steps)


def _format_task_label(step: Step) -> str:
    return (
        f"{step.action} {format_utility(step.decision.total)}"
        if step.decision.total is not None
        else step.action.value
    )
