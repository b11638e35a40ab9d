# SPDX-License-Identifier: Apache-2.0
"""logs command."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, options
from edgectl.cli.completion import complete_tasks
from edgectl.cli.task_names import select_task_names
from edgectl.cli.user_files import load_inputs
from edgectl.errors import EdgectlError, ExitCode, UsageError

if TYPE_CHECKING:
    from edgectl.usecases.fleet import Fleet


def logs_command(
    *,
    names: Annotated[
        list[str] | None,
        Argument(
            metavar="[TASK...]",
            autocompletion=complete_tasks,
            parser=options.strip_task_kind,
            help="Names of tasks.",
            show_default=False,
        ),
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    selector: options.SelectorOption = None,
    follow: Annotated[bool, Option("--follow", "-f", help="Keep printing until Ctrl-C.")] = False,
    tail: Annotated[
        int, Option("--tail", "-n", metavar="N", min=0, help="Number of last lines to print.")
    ] = 100,
    prefix: Annotated[bool, Option("--prefix", help="Begin each line with its task, as of several.")] = False,
    raw: Annotated[bool, Option("--raw", help="Leave control sequences of the task in.")] = False,
) -> None:
    """Print the logs of tasks from the hosts where they run or ran last, without control sequences.

    Of several tasks each line begins with [task/NAME]; a task without a log is said, and the exit code is 4.

    Examples:
        edgectl logs slam-robot1
        edgectl logs slam-robot1 --tail 20
        edgectl logs slam-robot1 -f
        edgectl logs -l robot=robot1 --tail 1
    """
    from edgectl.cli.connect import build_fleet

    fleet = build_fleet(load_inputs(inventory, tasks))
    chosen = select_task_names(names or (), selector, fleet.tasks)
    if follow and len(chosen) > 1:
        raise UsageError(
            f"-f follows one task, and this is {len(chosen)}", hint=f"edgectl logs -f {chosen[0]}"
        )
    if len(chosen) == 1:
        for text in _read_one(fleet, chosen[0], tail=tail, follow=follow, raw=raw, prefix=prefix):
            if not console.print_part(text):
                return
        return
    raise Exit(_print_several(fleet, chosen, tail=tail, raw=raw))


def _print_several(fleet: "Fleet", names: Sequence[str], *, tail: int, raw: bool) -> ExitCode:
    """The logs one after the other; what a task lacks costs that task alone."""
    code = ExitCode.DONE
    for name in names:
        try:
            text = "".join(_read_one(fleet, name, tail=tail, follow=False, raw=raw, prefix=True))
        except EdgectlError as error:
            console.print_message(f"task/{name}: {error.message}")
            code = ExitCode.PARTLY
            continue
        if not console.print_part(text):
            break
    return code


def _read_one(
    fleet: "Fleet", name: str, *, tail: int, follow: bool, raw: bool, prefix: bool
) -> Iterator[str]:
    from edgectl.usecases import logs
    from edgectl.views.text import decode_log, prefix_lines

    if follow:
        parts = decode_log(logs.follow_log(fleet, name, tail=tail), raw=raw)
    else:
        text = logs.read_log(fleet, name, tail=tail)
        if not text:
            console.print_message(f"the log of {name} is empty" if prefix else "the log is empty")
        parts = decode_log([text.encode()], raw=raw)
    return prefix_lines(parts, f"[task/{name}] ") if prefix else parts
