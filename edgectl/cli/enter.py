# SPDX-License-Identifier: Apache-2.0
"""exec and ssh commands."""

import os
import shlex
import sys
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, options
from edgectl.cli.task_names import resolve_task_name
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode, UsageError
from edgectl.names import check_known_names

_DryRunOption = Annotated[bool, Option("--dry-run", help="Only print the command line.")]


def exec_command(
    *,
    task: options.TaskArgument,
    words: Annotated[
        list[str], Argument(metavar="-- CMD...", help="Command and arguments.", show_default=False)
    ],
    tty: Annotated[bool, Option("--tty", "-it", help="With a terminal, for a shell.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    dry_run: _DryRunOption = False,
) -> None:
    """Run a command where a task runs, in its environment and folder. The exit code is the command's; 125 if
    the task has just ended, 255 if ssh fails.

    The command is not part of the task: its limits and stops do not apply. No shell parses the command.

    Examples:
        edgectl exec slam-robot1 -- printenv
        edgectl exec slam-robot1 -it -- bash
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.enter import find_enter_command

    fleet = build_fleet(load_inputs(inventory, tasks))
    task = resolve_task_name(task, fleet.tasks)
    _become(find_enter_command(fleet, task, words, tty=_check_terminal(tty)), dry_run=dry_run)


def ssh_command(
    *,
    host: options.HostArgument,
    words: Annotated[
        list[str] | None, Argument(metavar="[-- CMD...]", help="Else a shell.", show_default=False)
    ] = None,
    tty: Annotated[bool, Option("--tty", "-it", help="With a terminal also for a command.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    dry_run: _DryRunOption = False,
) -> None:
    """Log in to a host by ssh, with the user, port, keys and jump hosts of the inventory; host keys are
    checked. A command runs in the login shell of the host. The exit code is that of ssh.

    Examples:
        edgectl ssh edge1
        edgectl ssh edge1 -- uptime
        edgectl ssh edge1 --dry-run
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.transport.shell_command import build_login_command

    fleet = build_fleet(load_inputs(inventory, tasks))
    check_known_names([host], fleet.inventory.hosts, "host")
    tty = _check_terminal(tty) or (not words and sys.stdin.isatty())
    _become(build_login_command(fleet.inventory.hosts[host], words or (), tty=tty), dry_run=dry_run)


def _check_terminal(tty: bool) -> bool:  # noqa: FBT001 - a check of the flag itself
    """``tty``, which needs a terminal here.

    Raises:
        UsageError: standard input is none.
    """
    if tty and not sys.stdin.isatty():
        raise UsageError("stdin is not a terminal", hint="leave -it out")
    return tty


def _become(command: list[str], *, dry_run: bool) -> None:
    """Replace this process by ``command``, which so has the terminal, the signals and the exit code."""
    if dry_run:
        console.print_text(shlex.join(command) + "\n")
        raise Exit(ExitCode.DONE)
    sys.stdout.flush()
    sys.stderr.flush()
    os.execvp(command[0], command)  # noqa: S606 - that is what it is for: no shell
