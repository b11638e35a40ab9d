"""events."""

import time
from typing import Annotated

from typer import Option

from edgectl.cli import console, options
from edgectl.cli.complete import hosts, tasks
from edgectl.cli.inputs import load
from edgectl.cli.until import told
from edgectl.errors import UsageError
from edgectl.model.names import known
from edgectl.views.form import Form

_EVERY_S = 1.0
_HostOption = Annotated[str | None, Option("--host", metavar="HOST", autocompletion=hosts, help="Only of this host.")]
_TaskOption = Annotated[str | None, Option("--task", metavar="TASK", autocompletion=tasks, help="Only of this task.")]


def events_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FieldsOutput = Form.TABLE,
    since: Annotated[str, Option("--since", metavar="TIME", help="Not older than this.")] = "24h",
    host: _HostOption = None,
    task: _TaskOption = None,
    watch: Annotated[bool, Option("--watch", "-w", help="Go on as more happens, until Ctrl-C.")] = False,
) -> None:
    """Say what happened: hosts lost and back, tasks started, moved, failed, and what an apply did. No host is asked.

    What is seen is what some edgectl saw: a probe, a plan, an apply or a watch. With -w, -o json prints one object per line.

    Examples:
        edgectl events
        edgectl events --since 7d --task slam-robot1
        edgectl events -w -o json
    """
    from edgectl.cli.reach import reach, seconds
    from edgectl.usecases.events import Wanted, events, follow

    if watch and output is Form.YAML:
        raise UsageError("no yaml form of events as they come", hint="write -o json, for one object per line")
    fleet = reach(load(inventory, tasks))
    wanted = Wanted(since=time.time() - seconds(since, "--since"), host=host, task=task)
    if watch:
        with told(_EVERY_S) as end:
            console.show_all(output, "events_more", ((found, number == 0) for number, found in enumerate(follow(fleet, wanted, end))))
        return
    found = events(fleet, wanted)
    if not found:
        # Not before: a host or a task that left the files has a history too.
        known([host] if host else [], fleet.inventory.hosts, "host")
        known([task] if task else [], fleet.tasks.tasks, "task")
    console.show(output, "events", found)
