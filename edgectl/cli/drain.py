# SPDX-License-Identifier: Apache-2.0
"""drain command."""

from typing import Annotated

from typer import Exit, Option

from edgectl.cli import apply_session, console, exit_codes, options
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode
from edgectl.model.plan import Action
from edgectl.views.output_format import OutputFormat


def drain_command(
    *,
    hosts: options.HostsArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    yes: options.YesOption = False,
    dry_run: options.DryRunOption = False,
    timeout: Annotated[str, Option("--timeout", metavar="TIME", help="How long to retry.")] = "5m",
    max_parallel: options.MaxParallelOption = 16,
    fail_fast: options.FailFastOption = False,
    lock_timeout: options.LockTimeoutOption = None,
) -> None:
    """Cordon hosts and move their tasks away now, through their handoff contracts; exit 4 if tasks are left.

    Examples:
        edgectl drain edge1
        edgectl drain edge1 --yes --timeout 10m
        edgectl drain edge1 --dry-run
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option, parse_lock_timeout
    from edgectl.usecases.drain import drain_hosts
    from edgectl.views.other_tasks import list_foreign_notes
    from edgectl.views.reasons import describe_reason
    from edgectl.views.results import DrainView

    first = "check first: edgectl drain --dry-run"
    asked = apply_session.check_can_confirm(asked=not (yes or dry_run), first=first)
    loaded = load_inputs(inventory, tasks)
    fleet = build_fleet(loaded)
    with apply_session.open_apply_session(
        quiet=False, output=output, asked=asked, dry_run=dry_run, fleet=fleet.inventory.fleet
    ) as act:
        chosen = act.options(
            lock_timeout=parse_lock_timeout(lock_timeout),
            max_parallel=max_parallel,
            fail_fast=fail_fast,
        )
        drained = drain_hosts(
            fleet,
            loaded.tasks.policy,
            hosts,
            act.confirm,
            chosen,
            timeout=parse_duration_option(timeout, "--timeout"),
        )
    if dry_run:
        raise Exit(apply_session.print_requests(fleet, drained.applied.plan, output))
    passes = [each.results for each in drained.passes if each.results is not None]
    if passes:
        console.print_view(
            DrainView(passes, drained.left, done=drained.done, fleet=fleet.inventory.fleet), output
        )
    else:
        act.report(drained.applied)
    kept = {step.task: step for step in drained.applied.plan.steps if step.action is Action.KEEP}
    for task, host in drained.left:
        why = f" ({describe_reason(kept[task]).removeprefix('keep: ')})" if task in kept else ""
        console.print_message(f"still on {host}: {task}{why}")
    console.print_notes(list_foreign_notes(drained.applied.plan.snapshot, hosts))
    code = exit_codes.of_applied(drained.applied, allow_unreachable=True)
    raise Exit(code or (ExitCode.DONE if drained.done else ExitCode.PARTLY))
