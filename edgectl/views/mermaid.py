"""Pictures for Markdown pages: Mermaid."""

from edgectl.model.plan import Plan
from edgectl.model.task import Tasks
from edgectl.views.graph import build_task_graph
from edgectl.views.text import PLAIN, RenderOptions


def graph(plan: Plan, tasks: Tasks, _look: RenderOptions = PLAIN) -> str:
    """A flowchart: a box per host with its tasks in it, an arrow per need."""
    shown = build_task_graph(plan, tasks)
    ids = {
        task: f"t{number}"
        for number, task in enumerate(task for each in shown.hosts.values() for task, _ in each)
    }
    lines = ["flowchart LR"]
    for number, (host, each) in enumerate(shown.hosts.items()):
        lines += [
            f'  subgraph h{number}["{host}"]',
            *(f'    {ids[task]}["{task}<br/>{label}"]' for task, label in each),
            "  end",
        ]
    lines += [f"  {ids[before]} --> {ids[task]}" for before, task in shown.needs]
    return "\n".join(lines) + "\n"
