# SPDX-License-Identifier: Apache-2.0
"""describe edge, robot and task commands."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.completion import complete_hosts
from edgectl.cli.task_names import resolve_task_name
from edgectl.cli.user_files import LoadedInputs, load_inputs
from edgectl.model.inventory import Host
from edgectl.names import check_known_names
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.model.snapshot import Snapshot

_EVENT_COUNT = 10
_HostNameArgument = Annotated[
    str,
    Argument(
        metavar="NAME",
        autocompletion=complete_hosts,
        parser=options.strip_host_kind,
        help="Name in the inventory.",
        show_default=False,
    ),
]


def describe_edge_command(
    *,
    name: _HostNameArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show details of an edge: address, labels, capacity, limits, usage, links, tasks and recent events.

    Examples:
        edgectl describe edge edge1
    """
    loaded = load_inputs(inventory, tasks)
    _describe_host("edge", name, loaded.inventory.edges, loaded, output, allow_unreachable=allow_unreachable)


def describe_robot_command(
    *,
    name: _HostNameArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show details of a robot: address, labels, capacity, limits, usage, tasks and recent events.

    Examples:
        edgectl describe robot robot1
    """
    loaded = load_inputs(inventory, tasks)
    _describe_host(
        "robot", name, loaded.inventory.robots, loaded, output, allow_unreachable=allow_unreachable
    )


def _describe_host(
    role: str,
    name: str,
    among: Iterable[Host],
    loaded: LoadedInputs,
    output: OutputFormat,
    *,
    allow_unreachable: bool,
) -> None:
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.probe import probe_fleet
    from edgectl.usecases.status import load_last_events
    from edgectl.views.describe_host import HostDetailsView

    check_known_names([name], [host.name for host in among], role)
    fleet = build_fleet(loaded)
    snapshot = probe_fleet(fleet)
    happened = load_last_events(fleet, _EVENT_COUNT, host=name)
    view = HostDetailsView(name, snapshot, fleet.inventory, fleet.tasks, happened)
    console.print_view(view, output, fleet=fleet.inventory.fleet)
    raise Exit(exit_codes.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def describe_task_command(
    *,
    task: options.TaskArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show details of a task: spec, placement, usage against demand, downtimes, recent events.

    Secrets show as ***. "Decision" is the decision of a plan made now.

    Examples:
        edgectl describe task slam-robot1 -o yaml
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.plan import make_plan
    from edgectl.usecases.probe import probe_fleet
    from edgectl.usecases.status import load_last_events
    from edgectl.views.describe_task import TaskDetailsView

    fleet = build_fleet(load_inputs(inventory, tasks))
    task = resolve_task_name(task, fleet.tasks)
    snapshot = probe_fleet(fleet)
    check_known_names([task], [*fleet.tasks.tasks, *_list_running_tasks(snapshot)], "task")
    decided = make_plan(fleet, fleet.tasks.policy, snapshot=snapshot)
    step = next((each for each in decided.steps if each.task == task), None)
    happened = load_last_events(fleet, _EVENT_COUNT, task=task)
    view = TaskDetailsView(task, snapshot, fleet.inventory, fleet.tasks, step, happened)
    console.print_view(view, output, fleet=fleet.inventory.fleet)
    raise Exit(exit_codes.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def _list_running_tasks(snapshot: "Snapshot") -> list[str]:
    return [name for host in snapshot.hosts.values() for name in host.tasks]
