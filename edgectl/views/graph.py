# SPDX-License-Identifier: Apache-2.0
"""The task graph: tasks, their needs and their hosts, as Mermaid, as DOT and as a document."""

from collections.abc import Iterable, Mapping, Sequence

from edgectl.dataclass import dataclass
from edgectl.formats.document import Document
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.task import Tasks
from edgectl.views.notes import list_snapshot_notes
from edgectl.views.output import ListView
from edgectl.views.output_format import GRAPH_FORMATS
from edgectl.views.plan_sections import format_utility

UNPLACED_GROUP = "unplaced"


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskGraph:
    """``hosts``: of each host (unplaced last) its tasks with a label. ``needs``: (predecessor, task)."""

    hosts: Mapping[str, tuple[tuple[str, str], ...]]
    needs: tuple[tuple[str, str], ...]

    def mermaid(self) -> str:
        """A flowchart for Markdown pages: a box per host with its tasks in it, an arrow per need."""
        ids = {
            task: f"t{number}"
            for number, task in enumerate(task for each in self.hosts.values() for task, _ in each)
        }
        lines = ["flowchart LR"]
        for number, (host, each) in enumerate(self.hosts.items()):
            lines += [
                f'  subgraph h{number}["{host}"]',
                *(f'    {ids[task]}["{task}<br/>{label}"]' for task, label in each),
                "  end",
            ]
        lines += [f"  {ids[before]} --> {ids[task]}" for before, task in self.needs]
        return "\n".join(lines) + "\n"

    def dot(self) -> str:
        """A directed graph for Graphviz: ``edgectl graph -o dot | dot -Tsvg``."""
        lines = ["digraph fleet {", "  rankdir=LR;", '  node [shape=box, fontname="sans-serif"];']
        for number, (host, each) in enumerate(self.hosts.items()):
            nodes = [f'    "{task}" [label="{task}\\n{label}"];' for task, label in each]
            lines += [f"  subgraph cluster_{number} {{", f'    label="{host}";', *nodes, "  }"]
        lines += [f'  "{before}" -> "{task}";' for before, task in self.needs]
        return "\n".join([*lines, "}"]) + "\n"


class TaskGraphView(ListView):
    """The tasks of the graph, each with its host and its needs."""

    kind = "graph-task"
    formats = GRAPH_FORMATS

    def __init__(self, plan: Plan, tasks: Tasks) -> None:
        self._plan, self._tasks = plan, tasks

    def warnings(self) -> Sequence[str]:
        """The remarks on the snapshot."""
        return list_snapshot_notes(self._plan.snapshot)

    def items(self) -> Sequence[Document]:
        """The tasks as JSON types."""
        return [self._encode_step(step) for step in _list_shown_steps(self._plan)]

    def _encode_step(self, step: Step) -> Document:
        stated = self._tasks.tasks.get(step.task)
        needs = stated.needs if stated is not None else ()
        return {
            "task": step.task,
            "host": step.decision.host,
            "action": step.action.value,
            "total": step.decision.total,
            "needs": [{"task": need.task, "until": need.until.value} for need in needs],
        }


def _list_shown_steps(plan: Plan) -> list[Step]:
    """Without tasks that end or have ended."""
    return [step for step in plan.steps if step.action not in (Action.STOP, Action.COMPLETE, Action.NONE)]


def build_task_graph(plan: Plan, tasks: Tasks) -> TaskGraph:
    """The graph after the plan; tasks that end or have ended are left out."""
    shown = _list_shown_steps(plan)
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
