# SPDX-License-Identifier: Apache-2.0
"""logs command."""

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated

from typer import Exit, Option

from edgectl.cli import console, options
from edgectl.cli.task_names import select_task_names
from edgectl.cli.user_files import load_inputs
from edgectl.errors import EdgectlError, ExitCode, UsageError
from edgectl.units import QuantityError, parse_instant

if TYPE_CHECKING:
    from edgectl.usecases.fleet import Fleet

_DEFAULT_TAIL = 100


def logs_command(
    *,
    names: options.TasksArgument = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    selector: options.SelectorOption = None,
    follow: Annotated[bool, Option("--follow", "-f", help="Keep printing until Ctrl-C.")] = False,
    tail: Annotated[
        int | None,
        Option(
            "--tail",
            "-n",
            metavar="N",
            min=0,
            help="Last N lines; else 100, or all with --since.",
            show_default=False,
        ),
    ] = None,
    since: Annotated[
        str | None,
        Option("--since", metavar="TIME", help="Only lines newer than 10m, or than an instant (UTC)."),
    ] = None,
    previous: Annotated[
        bool, Option("--previous", "-p", help="The run before the present one, on the same host.")
    ] = False,
    prefix: Annotated[bool, Option("--prefix", help="Begin each line with its task, as of several.")] = False,
    raw: Annotated[bool, Option("--raw", help="Leave control sequences of the task in.")] = False,
) -> None:
    """Print the logs of tasks from the hosts where they run or ran last, without control sequences.

    Of several tasks each line begins with [task/NAME]; a task without a log is named, and the exit code is 4.
    -f follows up to 32 at once. A run ends when its command does: a crash, a restart or a stop.

    Examples:
        edgectl logs slam-robot1
        edgectl logs slam-robot1 -f --since 10m
        edgectl logs slam-robot1 --previous --tail 20
        edgectl logs -l robot=robot1 --tail 1
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.transport.connections import SessionPool

    fleet = build_fleet(load_inputs(inventory, tasks))
    chosen = select_task_names(names or (), selector, fleet.tasks)
    if follow and previous:
        raise UsageError("--previous is of a run that has ended: it cannot be followed")
    since_s = _parse_since(since) if since is not None else None
    if tail is None and since is None:
        tail = _DEFAULT_TAIL
    read = partial(_read_one, tail=tail, since_s=since_s, raw=raw)
    with SessionPool(fleet.transport) as pool:
        # The question where a task is, and that for its log, over one login.
        held = dataclasses.replace(fleet, transport=pool)
        if follow and len(chosen) > 1:
            raise Exit(_follow_several(held, chosen, partial(read, follow=True, previous=False, prefix=True)))
        if len(chosen) > 1:
            raise Exit(
                _print_several(chosen, partial(read, held, follow=False, previous=previous, prefix=True))
            )
        for text in read(held, chosen[0], follow=follow, previous=previous, prefix=prefix):
            if not console.print_part(text):
                return


def _parse_since(text: str) -> float:
    """The age (s) of a duration, or of an instant on the clock of this machine."""
    from edgectl.cli.connect import parse_duration_option

    try:
        return max(0.0, time.time() - parse_instant(text))
    except QuantityError:
        return parse_duration_option(text, "--since")


def _print_several(names: Sequence[str], read: Callable[[str], Iterator[str]]) -> ExitCode:
    """The logs one after the other; what a task lacks costs that task alone."""
    code = ExitCode.DONE
    for name in names:
        try:
            text = "".join(read(name))
        except EdgectlError as error:
            _print_failure(name, error)
            code = ExitCode.PARTLY
            continue
        if not console.print_part(text):
            break
    return code


def _print_failure(name: str, error: EdgectlError) -> None:
    console.print_message(f"task/{name}: {error.message}")
    if error.hint:
        console.print_message(f"hint: {error.hint}")


def _follow_several(fleet: "Fleet", names: Sequence[str], read: "Callable[..., Iterator[str]]") -> ExitCode:
    """The new lines of all tasks as they come, each whole, until Ctrl-C, or until none is left to follow."""
    from edgectl.usecases.logs import MAX_FOLLOWED, merge_streams

    if len(names) > MAX_FOLLOWED:
        raise UsageError(
            f"-f follows at most {MAX_FOLLOWED} tasks, and this is {len(names)}",
            hint="name fewer, or: -l robot=NAME",
        )
    code = ExitCode.DONE
    for name, text in merge_streams({name: partial(read, fleet, name) for name in names}):
        if isinstance(text, EdgectlError):
            _print_failure(name, text)
            code = ExitCode.PARTLY
        elif not console.print_part(text):
            break
    return code


def _read_one(
    fleet: "Fleet",
    name: str,
    *,
    tail: int | None,
    since_s: float | None,
    previous: bool,
    follow: bool,
    raw: bool,
    prefix: bool,
) -> Iterator[str]:
    from edgectl.usecases import logs
    from edgectl.views.text import decode_log, prefix_lines

    if follow:
        parts = decode_log(logs.follow_log(fleet, name, tail=tail, since_s=since_s), raw=raw)
    else:
        text = logs.read_log(fleet, name, tail=tail, since_s=since_s, previous=previous)
        if not text:
            console.print_message(_describe_empty_log(name if prefix else "", since_s, previous=previous))
        parts = decode_log([text.encode()], raw=raw)
    return prefix_lines(parts, f"[task/{name}] ") if prefix else parts


def _describe_empty_log(name: str, since_s: float | None, *, previous: bool) -> str:
    what = "the previous run" if previous else "the log"
    of = f" of {name}" if name else ""
    return f"{what}{of} is empty" if since_s is None else f"{what}{of} has no lines of that time"
