"""Tasks, what they need and where they are placed, as a picture's parts."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from edgectl.model.plan import Action, Plan, Step
from edgectl.model.task import Tasks
from edgectl.views.sections import figure

NOWHERE = "unplaced"


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """``hosts``: by host (``NOWHERE`` last, where needed) its tasks with a label of one or two lines. ``needs``: (predecessor, task)."""

    hosts: Mapping[str, tuple[tuple[str, str], ...]]
    needs: tuple[tuple[str, str], ...]


def graph_of(plan: Plan, tasks: Tasks) -> Graph:
    """The plan as it will stand; tasks that end or have ended are left out."""
    shown = [step for step in plan.steps if step.action not in (Action.STOP, Action.COMPLETE, Action.NONE)]
    names = {step.task for step in shown}
    order = (*plan.expected, *sorted({step.decision.host for step in shown if step.decision.host} - set(plan.expected)))
    hosts = {host: _tasks(step for step in shown if step.decision.host == host) for host in order}
    lost = _tasks(step for step in shown if step.decision.host is None)
    needs = [(need.task, name) for name, task in tasks.tasks.items() for need in task.needs if {need.task, name} <= names]
    return Graph(hosts=hosts | ({NOWHERE: lost} if lost else {}), needs=tuple(needs))


def _tasks(steps: Iterable[Step]) -> tuple[tuple[str, str], ...]:
    return tuple((step.task, _label(step)) for step in steps)


def _label(step: Step) -> str:
    return f"{step.action} {figure(step.decision.total)}" if step.decision.total is not None else step.action.value
