"""describe edge, robot and task."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit

from edgectl.cli import console, exits, options
from edgectl.cli.complete import hosts
from edgectl.cli.inputs import Loaded, load
from edgectl.model.inventory import Host
from edgectl.model.names import known
from edgectl.views.form import Form

if TYPE_CHECKING:
    from edgectl.model.snapshot import Snapshot

_EVENTS = 10
_Name = Annotated[str, Argument(metavar="NAME", autocompletion=hosts, help="Name in the inventory.", show_default=False)]


def describe_edge_command(
    *,
    name: _Name,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FieldsOutput = Form.TABLE,
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Say everything that is known of an edge: address, labels, capacity, limits, use, links, tasks and its last events.

    Examples:
        edgectl describe edge edge1
    """
    loaded = load(inventory, tasks)
    _host("edge", name, loaded.inventory.edges, loaded, output, allow_unreachable=allow_unreachable)


def describe_robot_command(
    *,
    name: _Name,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FieldsOutput = Form.TABLE,
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Say everything that is known of a robot: address, labels, capacity, limits, use, tasks and its last events.

    Examples:
        edgectl describe robot robot1
    """
    loaded = load(inventory, tasks)
    _host("robot", name, loaded.inventory.robots, loaded, output, allow_unreachable=allow_unreachable)


def _host(role: str, name: str, among: Iterable[Host], loaded: Loaded, output: Form, *, allow_unreachable: bool) -> None:
    from edgectl.cli.reach import reach
    from edgectl.usecases.look import last_events
    from edgectl.usecases.probe import probe

    known([name], [host.name for host in among], role)
    fleet = reach(loaded)
    snapshot = probe(fleet)
    happened = last_events(fleet, _EVENTS, host=name)
    console.show(output, "host_details", name, snapshot, fleet.inventory, fleet.tasks, happened)
    raise Exit(exits.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def describe_task_command(
    *,
    task: options.TaskArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FieldsOutput = Form.TABLE,
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Say everything that is known of a task: what its file says, where it runs, its use against its demand, downtimes, last events.

    Secrets show as ***. "Decision" is what a plan would do now.

    Examples:
        edgectl describe task slam-robot1 -o yaml
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases.look import last_events
    from edgectl.usecases.plan import plan
    from edgectl.usecases.probe import probe

    fleet = reach(load(inventory, tasks))
    snapshot = probe(fleet)
    known([task], [*fleet.tasks.tasks, *_running(snapshot)], "task")
    decided = plan(fleet, fleet.tasks.policy, snapshot=snapshot)
    step = next((each for each in decided.steps if each.task == task), None)
    happened = last_events(fleet, _EVENTS, task=task)
    console.show(output, "task_details", task, snapshot, fleet.inventory, fleet.tasks, step, happened)
    raise Exit(exits.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def _running(snapshot: "Snapshot") -> list[str]:
    return [name for host in snapshot.hosts.values() for name in host.tasks]
