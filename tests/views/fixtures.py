# SPDX-License-Identifier: Apache-2.0
"""One plan of each interesting kind, decided for real from the committed snapshot."""

from dataclasses import replace
from functools import cache
from pathlib import Path

from edgectl.config.documents import load_snapshot
from edgectl.config.load import load_inventory_and_tasks
from edgectl.executor.diff import plan_from_assignment
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.assign import assign
from edgectl.views.notes import render_notes
from edgectl.views.output import View, render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.text import PLAIN, RenderOptions

ROOT = Path(__file__).parents[2]
SNAPSHOT = ROOT / "docs" / "examples" / "snapshot.json"


@cache
def fleet() -> tuple[Inventory, Tasks, Snapshot]:
    inventory, tasks, _ = load_inventory_and_tasks(
        ROOT / "inventories" / "local.yaml", [ROOT / "tasks" / "demo.yaml"]
    )
    return inventory, tasks, load_snapshot(SNAPSHOT)


def age_tasks(snapshot: Snapshot, seconds: float) -> Snapshot:
    """The snapshot with all tasks started, and placed, so much earlier: past start-up and dwell."""
    manager = snapshot.manager or ManagerState()
    placements = {
        task: replace(each, since=each.since - seconds) for task, each in manager.placements.items()
    }
    hosts = {
        name: replace(
            host,
            tasks={
                task: replace(run, started_at=run.started_at - seconds) for task, run in host.tasks.items()
            },
        )
        for name, host in snapshot.hosts.items()
    }
    return replace(snapshot, hosts=hosts, manager=replace(manager, placements=placements))


@cache
def plan() -> Plan:
    inventory, tasks, found = fleet()
    snapshot = age_tasks(found, 3600.0)
    memory = snapshot.manager or ManagerState()
    return plan_from_assignment(
        inventory,
        tasks,
        snapshot,
        memory,
        assign(inventory, tasks, snapshot, memory, tasks.policy, snapshot.taken_at),
    )


def show(view: View, form: OutputFormat = OutputFormat.TABLE, look: RenderOptions = PLAIN) -> str:
    """The output in ``form``, and below a table its notes."""
    noted = form in (OutputFormat.TABLE, OutputFormat.WIDE)
    return render_view(view, form, look) + (render_notes(view.notes(), look) if noted else "")
