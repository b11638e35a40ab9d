# SPDX-License-Identifier: Apache-2.0
"""history, show and rollback commands."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.completion import complete_revisions
from edgectl.cli.user_files import load_inputs
from edgectl.errors import UsageError
from edgectl.views.output_format import OutputFormat

# Before a number, as -o name prints it.
_REVISION = "revision/"


def _parse_revision(text: str) -> int:
    """A revision by its number, or as -o name prints it."""
    number = text.removeprefix(_REVISION)
    if not number.isdecimal() or int(number) == 0:
        raise UsageError(f"{text!r} is not a revision", hint="list their numbers: edgectl history")
    return int(number)


def history_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
) -> None:
    """List applied revisions: each apply, stop, restart, drain and rollback, with its time, user and outcome.

    Examples:
        edgectl history
        edgectl history -o json
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.history import list_shared_revisions
    from edgectl.views.history import HistoryView

    fleet = build_fleet(load_inputs(inventory, tasks))
    console.print_view(HistoryView(list_shared_revisions(fleet)), output, fleet=fleet.inventory.fleet)


def show_command(
    *,
    what: Annotated[
        str,
        Argument(
            metavar="REV|PLAN",
            autocompletion=complete_revisions,
            help="A number of edgectl history, or a saved plan (-: stdin).",
            show_default=False,
        ),
    ],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.PlanOutput = OutputFormat.TABLE,
    detailed: options.DetailedExitcodeOption = False,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show a revision (its actions, their phases and durations), or a saved plan. Nothing is contacted.

    Examples:
        edgectl show 1
        edgectl show next.plan
        edgectl show next.plan -o wide
        edgectl plan -o json | edgectl show - -o markdown
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.config.documents import load_plan
    from edgectl.usecases.history import get_revision
    from edgectl.views.history import RevisionView
    from edgectl.views.output_format import check_output_format
    from edgectl.views.plan import PlanView

    number = what.removeprefix(_REVISION)
    if number.isdecimal():
        check_output_format(output, RevisionView.formats)
        fleet = build_fleet(load_inputs(inventory, tasks))
        found = get_revision(fleet, int(number))
        console.print_view(RevisionView(found), output, fleet=fleet.inventory.fleet)
        return
    saved = load_plan(Path(what))
    console.print_view(PlanView(saved), output)
    raise Exit(exit_codes.of_plan(saved, detailed=detailed, allow_unreachable=allow_unreachable))


def rollback_command(
    *,
    revision: Annotated[
        int | None,
        Argument(
            metavar="[REV]",
            autocompletion=complete_revisions,
            parser=_parse_revision,
            help="Number of a revision; default: the one before the last.",
            show_default=False,
        ),
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    change: options.ChangeOptions,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Restore the placement of an earlier revision: plan, ask, apply. Commands and demands are those of the
    present files.

    Examples:
        edgectl rollback
        edgectl rollback 1 --yes
        edgectl rollback 1 --dry-run
    """
    from edgectl.cli import apply_session
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.history import plan_rollback, roll_back_fleet
    from edgectl.usecases.plan import keep_whole_plan
    from edgectl.usecases.plan_execution import ApplyOptions

    first = "check first: edgectl rollback --dry-run"
    asked = apply_session.check_can_confirm(asked=not change.yes and not change.dry_run, first=first)
    fleet = build_fleet(load_inputs(inventory, tasks))
    policy = fleet.tasks.policy
    if change.dry_run:
        raise Exit(
            apply_session.print_dry_run(
                fleet, policy, plan_rollback(fleet, policy, revision, ApplyOptions()), keep_whole_plan, output
            )
        )
    with apply_session.open_apply_session(
        quiet=change.quiet, output=output, asked=asked, fleet=fleet.inventory.fleet
    ) as act:
        applied = roll_back_fleet(fleet, policy, revision, act.confirm, act.options_from(change))
    code = exit_codes.of_applied(applied, allow_unreachable=allow_unreachable)
    act.report(applied, code)
    raise Exit(code)
