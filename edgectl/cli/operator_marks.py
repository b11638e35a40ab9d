# SPDX-License-Identifier: Apache-2.0
"""Commands that mark hosts and tasks: cordon, uncordon, fence, unfence, done, reopen."""

from collections.abc import Container, Iterable
from typing import Annotated

from typer import Exit, Option

from edgectl.cli import apply_session, console, options
from edgectl.cli.task_names import select_task_names
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode
from edgectl.model.inventory import Inventory
from edgectl.names import check_known_names
from edgectl.units import format_duration
from edgectl.views.marks import Mark, MarksView
from edgectl.views.output_format import OutputFormat


def cordon_command(
    *,
    hosts: options.HostsArgument,
    drain: Annotated[bool, Option("--drain", help="Also move their tasks away at the next apply.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Mark hosts as unschedulable.

    Examples:
        edgectl cordon edge1
        edgectl cordon edge1 --drain
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases import operator_marks

    loaded = load_inputs(inventory, tasks)
    fleet = build_fleet(loaded)
    already = operator_marks.cordon_hosts(fleet, hosts, drain=drain, dry_run=dry_run)
    act = "cordoned" + ("; its tasks leave at the next apply" if drain else "")
    marks = _list_host_marks(hosts, loaded.inventory, act, already)
    console.print_view(MarksView("cordon", marks, dry_run=dry_run), output)


def uncordon_command(
    *,
    hosts: options.HostsArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Mark hosts as schedulable.

    Examples:
        edgectl uncordon edge1
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases import operator_marks

    loaded = load_inputs(inventory, tasks)
    fleet = build_fleet(loaded)
    already = operator_marks.uncordon_hosts(fleet, hosts, dry_run=dry_run)
    marks = _list_host_marks(hosts, loaded.inventory, "uncordoned", already)
    console.print_view(MarksView("uncordon", marks, dry_run=dry_run), output)


def fence_command(
    *,
    host: options.HostArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    yes: options.YesOption = False,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Declare a host powered off so that its tasks can be rescheduled by the next apply, although it does not
    answer.

    Check first: a task that still runs there would run twice. The fence is cleared when the host answers
    again.

    Examples:
        edgectl fence edge1 --yes
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases import operator_marks

    fleet = build_fleet(load_inputs(inventory, tasks))
    again = operator_marks.is_fenced(fleet, host)
    silence_s = None if again else operator_marks.compute_silence_s(fleet, host)
    if silence_s is not None:
        console.print_message(
            f"note: {host} last answered {format_duration(silence_s)} ago; the fence ends when it answers"
        )
    if not (again or dry_run):
        apply_session.check_can_confirm(asked=not yes, first="check first: edgectl fence --dry-run")
        if not yes and not apply_session.ask_confirmation(
            f"If {host} of fleet {fleet.inventory.fleet} is still on, its tasks will run twice. "
            "Type its name if it is powered off: ",
            host,
        ):
            raise Exit(ExitCode.FAILED)
    if not dry_run:  # also where it is fenced already: the fence may be missing in etcd
        operator_marks.fence_hosts(fleet, [host])
    marks = _list_host_marks([host], fleet.inventory, "fenced", {host} if again else ())
    console.print_view(MarksView("fence", marks, dry_run=dry_run), output)


def unfence_command(
    *,
    hosts: options.HostsArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Clear the fence of hosts.

    Examples:
        edgectl unfence edge1
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases import operator_marks

    loaded = load_inputs(inventory, tasks)
    already = operator_marks.unfence_hosts(build_fleet(loaded), hosts, dry_run=dry_run)
    marks = _list_host_marks(hosts, loaded.inventory, "unfenced", already)
    console.print_view(MarksView("unfence", marks, dry_run=dry_run), output)


def done_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Mark tasks as completed: the next apply stops them, and they stay stopped until reopened or changed.

    Examples:
        edgectl done navigation-robot1
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases import operator_marks

    fleet = build_fleet(load_inputs(inventory, tasks))
    chosen = select_task_names(names or (), selector, fleet.tasks)
    already = operator_marks.mark_tasks_done(fleet, chosen, dry_run=dry_run)
    marks = _list_task_marks(chosen, "marked as done", already)
    console.print_view(MarksView("done", marks, dry_run=dry_run), output)


def reopen_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Make completed or failed tasks schedulable again. Exit 4 if a host did not answer: a task that
    ended there stays as it is.

    Examples:
        edgectl reopen navigation-robot1
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases import operator_marks

    fleet = build_fleet(load_inputs(inventory, tasks))
    chosen = select_task_names(names or (), selector, fleet.tasks)
    check_known_names(chosen, fleet.tasks.tasks, "task")
    silent, already = (frozenset(), frozenset()) if dry_run else operator_marks.reopen_tasks(fleet, chosen)
    marks = _list_task_marks(chosen, "reopened", already)
    console.print_view(MarksView("reopen", marks, dry_run=dry_run), output)
    raise Exit(ExitCode.PARTLY if silent else ExitCode.DONE)


def _list_host_marks(
    names: Iterable[str], inventory: Inventory, act: str, already: Container[str] = ()
) -> list[Mark]:
    return [
        Mark(
            subject=inventory.hosts[name].role.value if name in inventory.hosts else "host",
            name=name,
            act=act,
            again=name in already,
        )
        for name in dict.fromkeys(names)
    ]


def _list_task_marks(names: Iterable[str], act: str, already: Container[str]) -> list[Mark]:
    return [Mark(subject="task", name=name, act=act, again=name in already) for name in dict.fromkeys(names)]
