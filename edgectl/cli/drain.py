"""drain."""

from typing import Annotated

from typer import Exit, Option

from edgectl.cli import acting, console, exits, options
from edgectl.cli.inputs import load
from edgectl.errors import ExitCode
from edgectl.views.form import Form


def drain_command(
    *,
    hosts: options.HostsArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ResultOutput = Form.TABLE,
    yes: options.YesOption = False,
    timeout: Annotated[str, Option("--timeout", metavar="TIME", help="How long to try again.")] = "5m",
    max_parallel: options.ParallelOption = 16,
    fail_fast: options.FailFastOption = False,
    lock_timeout: options.LockOption = "0s",
) -> None:
    """Close hosts to new tasks and move theirs away now, through their handoff contracts; exit 4 if something is left there.

    Examples:
        edgectl drain edge1
        edgectl drain edge1 --yes --timeout 10m
    """
    from edgectl.cli.reach import reach, seconds
    from edgectl.usecases.drain import drain

    asked = acting.answerable(asked=not yes)
    loaded = load(inventory, tasks)
    fleet = reach(loaded)
    with acting.session(quiet=False, output=output, asked=asked) as act:
        chosen = act.options(lock_timeout=seconds(lock_timeout, "--lock-timeout"), max_parallel=max_parallel, fail_fast=fail_fast)
        drained = drain(fleet, loaded.tasks.policy, hosts, act.confirm, chosen, timeout=seconds(timeout, "--timeout"))
    passes = [each.results for each in drained.passes if each.results is not None]
    console.show(output, "drained", passes, drained.left, drained.done) if passes else act.report(drained.applied)
    for task, host in drained.left:
        console.tell(f"still on {host}: {task}")
    code = exits.of_applied(drained.applied)
    raise Exit(code or (ExitCode.DONE if drained.done else ExitCode.PARTLY))
