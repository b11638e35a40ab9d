"""Pictures for Graphviz: ``edgectl graph -o dot | dot -Tsvg``."""

from edgectl.model.plan import Plan
from edgectl.model.task import Tasks
from edgectl.views.graph import build_task_graph
from edgectl.views.text import PLAIN, RenderOptions


def graph(plan: Plan, tasks: Tasks, _look: RenderOptions = PLAIN) -> str:
    """A directed graph: a cluster per host with its tasks in it, an arrow per need."""
    shown = build_task_graph(plan, tasks)
    lines = ["digraph fleet {", "  rankdir=LR;", '  node [shape=box, fontname="sans-serif"];']
    for number, (host, each) in enumerate(shown.hosts.items()):
        nodes = [f'    "{task}" [label="{task}\\n{label}"];' for task, label in each]
        lines += [f"  subgraph cluster_{number} {{", f'    label="{host}";', *nodes, "  }"]
    lines += [f'  "{before}" -> "{task}";' for before, task in shown.needs]
    return "\n".join([*lines, "}"]) + "\n"
