# SPDX-License-Identifier: Apache-2.0
"""describe edge, robot and task commands."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

from typer import Argument, Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.completion import complete_entries, complete_hosts
from edgectl.cli.task_names import expand_task_names
from edgectl.cli.user_files import load_inputs
from edgectl.errors import UsageError
from edgectl.model.inventory import Inventory
from edgectl.names import check_known_names
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.model.snapshot import Snapshot
    from edgectl.usecases.fleet import Fleet
    from edgectl.views.output import ItemView

_EVENT_COUNT = 10
# Of names as -o name prints them; "host" is an edge or a robot.
_KINDS = ("edge", "robot", "task", "host")
_HostNamesArgument = Annotated[
    list[str],
    Argument(
        metavar="NAME...",
        autocompletion=complete_hosts,
        help="Names, or KIND/NAME of any kind.",
        show_default=False,
    ),
]
_TaskNamesArgument = Annotated[
    list[str],
    Argument(
        metavar="TASK...",
        autocompletion=complete_entries,
        help="Names, or KIND/NAME of any kind.",
        show_default=False,
    ),
]


def describe_edge_command(
    *,
    names: _HostNamesArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show details of edges: address, labels, capacity, limits, usage, links, tasks and recent events.

    Examples:
        edgectl describe edge edge1
        edgectl describe edge/edge1 robot/robot1 task/slam-robot1
    """
    _describe_named("edge", names, inventory, tasks, output, allow_unreachable=allow_unreachable)


def describe_robot_command(
    *,
    names: _HostNamesArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show details of robots: address, labels, capacity, limits, usage, tasks and recent events.

    Examples:
        edgectl describe robot robot1
    """
    _describe_named("robot", names, inventory, tasks, output, allow_unreachable=allow_unreachable)


def describe_task_command(
    *,
    names: _TaskNamesArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show details of tasks: spec, placement, usage against demand, downtimes, recent events.

    Secrets show as ***. "Decision" is the decision of a plan made now. -o json of one task is its item, of
    several a list.

    Examples:
        edgectl describe task slam-robot1 -o yaml
        edgectl describe task slam-robot1 slam-robot2
    """
    _describe_named("task", names, inventory, tasks, output, allow_unreachable=allow_unreachable)


def _describe_named(
    kind: str,
    words: Sequence[str],
    inventory: list[Path] | None,
    tasks: list[Path] | None,
    output: OutputFormat,
    *,
    allow_unreachable: bool,
) -> NoReturn:
    """Describe what ``words`` name, one after the other in their order; all from one probe."""
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.probe import probe_fleet
    from edgectl.views.describe import DetailsView

    asked = [_split_kind(word, kind) for word in words]
    loaded = load_inputs(inventory, tasks, needs_tasks=any(of == "task" for of, _ in asked))
    named = list(
        dict.fromkeys(
            (of, each)
            for of, name in asked
            for each in (expand_task_names([name], loaded.tasks) if of == "task" else [name])
        )
    )
    _check_hosts(named, loaded.inventory)
    fleet = build_fleet(loaded)
    snapshot = probe_fleet(fleet)
    views = _build_views(named, fleet, snapshot)
    console.print_view(
        views[0] if len(views) == 1 else DetailsView(views), output, fleet=fleet.inventory.fleet
    )
    raise Exit(exit_codes.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def _split_kind(word: str, kind: str) -> tuple[str, str]:
    """Kind and name of what is named alone, and then is a ``kind``, or as -o name prints it.

    Raises:
        UsageError: it is of another kind.
    """
    stated, slash, name = word.partition("/")
    if not slash:
        return kind, word
    if stated == "link":
        raise UsageError(
            f"describe takes edges, robots and tasks, not {word}", hint=f"edgectl get links {name} -o json"
        )
    check_known_names([stated], _KINDS, "kind")
    return stated, name


def _check_hosts(named: Iterable[tuple[str, str]], inventory: Inventory) -> None:
    among = {"edge": inventory.edges, "robot": inventory.robots, "host": inventory.hosts.values()}
    for kind, hosts in among.items():
        check_known_names([name for of, name in named if of == kind], [host.name for host in hosts], kind)


def _build_views(named: Sequence[tuple[str, str]], fleet: "Fleet", snapshot: "Snapshot") -> "list[ItemView]":
    from edgectl.usecases.plan import make_plan
    from edgectl.usecases.status import load_last_events
    from edgectl.views.describe_host import HostDetailsView
    from edgectl.views.describe_task import TaskDetailsView

    wanted = [name for kind, name in named if kind == "task"]
    running = [name for host in snapshot.hosts.values() for name in host.tasks]
    check_known_names(wanted, [*fleet.tasks.tasks, *running], "task")
    decided = make_plan(fleet, fleet.tasks.policy, snapshot=snapshot).steps if wanted else ()
    steps = {step.task: step for step in decided}

    def build(kind: str, name: str) -> "ItemView":
        if kind != "task":
            happened = load_last_events(fleet, _EVENT_COUNT, host=name)
            return HostDetailsView(name, snapshot, fleet.inventory, fleet.tasks, happened)
        happened = load_last_events(fleet, _EVENT_COUNT, task=name)
        return TaskDetailsView(name, snapshot, fleet.inventory, fleet.tasks, steps.get(name), happened)

    return [build(kind, name) for kind, name in named]
