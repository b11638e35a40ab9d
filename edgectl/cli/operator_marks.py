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


def cordon_command(
    *,
    hosts: options.HostsArgument,
    drain: Annotated[bool, Option("--drain", help="Also move their tasks away at the next apply.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
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
    _report_hosts(hosts, loaded.inventory, act, already, dry_run=dry_run)


def uncordon_command(
    *,
    hosts: options.HostsArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
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
    _report_hosts(hosts, loaded.inventory, "uncordoned", already, dry_run=dry_run)


def fence_command(
    *,
    host: options.HostArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
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
    if operator_marks.is_fenced(fleet, host):
        if not dry_run:  # once more: it may be missing in etcd
            operator_marks.fence_hosts(fleet, [host])
        return _report_hosts([host], fleet.inventory, "fenced", {host}, dry_run=dry_run)
    silence_s = operator_marks.compute_silence_s(fleet, host)
    if silence_s is not None:
        console.print_message(
            f"note: {host} last answered {format_duration(silence_s)} ago; the fence ends when it answers"
        )
    if dry_run:
        return _report_hosts([host], fleet.inventory, "fenced", dry_run=True)
    apply_session.check_can_confirm(asked=not yes, first="check first: edgectl fence --dry-run")
    if not yes and not apply_session.ask_confirmation(
        f"If {host} of fleet {fleet.inventory.fleet} is still on, its tasks will run twice. "
        "Type its name if it is powered off: ",
        host,
    ):
        raise Exit(ExitCode.FAILED)
    operator_marks.fence_hosts(fleet, [host])
    return _report_hosts([host], fleet.inventory, "fenced")


def unfence_command(
    *,
    hosts: options.HostsArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
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
    _report_hosts(hosts, loaded.inventory, "unfenced", already, dry_run=dry_run)


def done_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
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
    _report_tasks(chosen, "marked as done", already, dry_run=dry_run)


def reopen_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
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
    _report_tasks(chosen, "reopened", already, dry_run=dry_run)
    raise Exit(ExitCode.PARTLY if silent else ExitCode.DONE)


def _report_hosts(
    names: Iterable[str],
    inventory: Inventory,
    act: str,
    already: Container[str] = (),
    *,
    dry_run: bool = False,
) -> None:
    for name in dict.fromkeys(names):
        role = inventory.hosts[name].role if name in inventory.hosts else "host"
        _report_mark(f"{role}/{name}", act, again=name in already, dry_run=dry_run)


def _report_tasks(names: Iterable[str], act: str, already: Container[str], *, dry_run: bool) -> None:
    for name in dict.fromkeys(names):
        _report_mark(f"task/{name}", act, again=name in already, dry_run=dry_run)


def _report_mark(named: str, act: str, *, again: bool, dry_run: bool) -> None:
    """As kubectl: a mark that is set already is no error."""
    suffix = options.DRY_RUN_SUFFIX if dry_run else ""
    console.print_text(f"{named} {'already ' if again else ''}{act}{suffix}\n")
