# SPDX-License-Identifier: Apache-2.0
"""The picture of a plan, in both languages."""

from edgectl.executor.diff import plan_from_assignment
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.scheduler.assign import assign
from edgectl.views.graph import TaskGraphView, build_task_graph
from tests.builders import NOW, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks

MERMAID = """\
flowchart LR
  subgraph h0["edge1"]
    t0["slam<br/>start 0.844"]
    t1["map-merge<br/>start 0.956"]
  end
  subgraph h1["edge2"]
  end
  subgraph h2["unplaced"]
    t2["huge<br/>unplaced"]
  end
  t0 --> t1
"""
DOT = """\
digraph fleet {
  rankdir=LR;
  node [shape=box, fontname="sans-serif"];
  subgraph cluster_0 {
    label="edge1";
    "slam" [label="slam\\nstart 0.844"];
    "map-merge" [label="map-merge\\nstart 0.956"];
  }
"""


def test_hosts_hold_their_tasks_and_needs_are_arrows() -> None:
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"))
    tasks = some_tasks(
        a_task("slam", cpu=0.5), a_task("map-merge", cpu=0.2, needs=["slam"]), a_task("huge", cpu=99.0)
    )
    world = a_snapshot(edge1=a_sample(), edge2=a_sample(used=3.0))
    plan = plan_from_assignment(
        inventory,
        tasks,
        world,
        ManagerState(),
        assign(inventory, tasks, world, ManagerState(), Policy(), NOW),
    )
    assert build_task_graph(plan, tasks).mermaid() == MERMAID
    assert build_task_graph(plan, tasks).dot().startswith(DOT)
    assert build_task_graph(plan, tasks).dot().endswith('  "slam" -> "map-merge";\n}\n')
    items = {item["task"]: item for item in TaskGraphView(plan, tasks).items()}
    assert {task: item["host"] for task, item in items.items()} == {
        "slam": "edge1",
        "map-merge": "edge1",
        "huge": None,
    }
    assert items["map-merge"]["needs"] == [{"task": "slam", "until": "ready"}]
