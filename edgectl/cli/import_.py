# SPDX-License-Identifier: Apache-2.0
"""import ros, ssh, ansible, compose and paper commands."""

import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from edgectl.cli import console, options
from edgectl.cli.completion import complete_hosts
from edgectl.errors import UsageError

if TYPE_CHECKING:
    from edgectl.usecases.import_result import Imported

_ASSIGNMENT = ":="


class TaskUnit(StrEnum):
    """What becomes one task."""

    NODE = "node"
    FILE = "file"


_OutOption = Annotated[
    Path | None,
    Option("--out", metavar="DIR", help="Write inventories/ and tasks/ there, not to stdout."),
]


def import_ros_command(
    *,
    files: Annotated[
        list[str] | None,
        Argument(metavar="[FILE.. [ARG:=VALUE..]]", help="Launch files, and args.", show_default=False),
    ] = None,
    live: Annotated[
        list[str] | None,
        Option(
            "--live",
            metavar="HOST",
            autocompletion=complete_hosts,
            help="Read the running graph; repeatable.",
        ),
    ] = None,
    group: Annotated[
        TaskUnit, Option("--group", metavar="UNIT", help="One task per node or per file.")
    ] = TaskUnit.NODE,
    package_path: Annotated[
        list[Path] | None,
        Option("--package-path", metavar="DIR", help="Where packages are; $ROS_PACKAGE_PATH, too."),
    ] = None,
    out: _OutOption = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    timeout: options.TimeoutOption = "20s",
) -> None:
    """Make tasks and an inventory from ROS launch files: .launch, .launch.xml, .launch.yaml, .launch.py.

    Nothing is started. A .launch.py is a program: it is run in a child process, without ROS. What is not
    imported is named on stderr. With --live, the nodes that run on a host of the inventory and are not
    edgectl's become tasks that are only measured (managed: false).

    Examples:
        edgectl import ros --live edge1
        edgectl import ros bringup.launch rate:=2
        edgectl import ros bringup.launch.py --out lab
        edgectl import ros bringup.launch --group file
    """
    from edgectl.cli.user_files import refuse_exposed_files
    from edgectl.usecases.import_files import import_ros

    if live:
        if files or package_path or group is not TaskUnit.NODE:
            raise UsageError("--live reads no files", hint="leave out the files, --group and --package-path")
        _import_live(live, out, inventory, tasks, timeout)
        return
    files = files or []
    paths = [word for word in files if _ASSIGNMENT not in word]
    if not paths:
        raise UsageError(
            "no launch file is named",
            hint="name it before the args: import ros FILE ARG:=VALUE; or --live HOST",
        )
    arguments = dict(word.split(_ASSIGNMENT, 1) for word in files if _ASSIGNMENT in word)
    roots = _list_package_roots(package_path or [])
    made = import_ros(
        paths, arguments, roots, by_file=group is TaskUnit.FILE, refuse_exposed=refuse_exposed_files
    )
    _put(made, out)


def _list_package_roots(given: list[Path]) -> list[str]:
    """The directories below which packages are: those given, then those of this shell's ROS."""
    found = [str(path) for path in given]
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        found += [part for part in os.environ.get(variable, "").split(os.pathsep) if part]
    return found


def _import_live(
    names: list[str], out: Path | None, inventory: list[Path] | None, tasks: list[Path] | None, timeout: str
) -> None:
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.cli.user_files import load_inputs
    from edgectl.usecases.import_live import import_live

    fleet = build_fleet(load_inputs(inventory, tasks, needs_tasks=False))
    _put(import_live(fleet, names, timeout=parse_duration_option(timeout, "--timeout")), out)


def import_ssh_command(
    *,
    patterns: Annotated[
        list[str], Argument(metavar="PATTERN..", help="Aliases, such as 'jetson-*'.", show_default=False)
    ],
    out: _OutOption = None,
) -> None:
    """Make an inventory of hosts in the ssh_config, with the files that it includes.

    The inventory names the aliases; their settings stay in the ssh_config and apply.

    Examples:
        edgectl import ssh 'jetson-*'
        edgectl import ssh jetson-a jetson-b --out lab
    """
    from edgectl.usecases.import_files import import_ssh

    _put(import_ssh(patterns), out)


def import_ansible_command(
    *,
    file: Annotated[Path, Argument(metavar="INVENTORY", help="INI or YAML.", show_default=False)],
    out: _OutOption = None,
) -> None:
    """Make an inventory from an Ansible inventory: hosts, address, port, user and key; groups become labels.

    Dynamic inventories are not run.

    Examples:
        edgectl import ansible hosts.ini
        edgectl import ansible hosts.ini --out lab
    """
    from edgectl.usecases.import_files import import_ansible

    _put(import_ansible(str(file)), out)


def import_compose_command(
    *,
    file: Annotated[Path, Argument(metavar="FILE", help="Such as compose.yaml.", show_default=False)],
    out: _OutOption = None,
) -> None:
    """Make tasks from a compose file: each service becomes a task with an image.

    Variables of the file are filled in from the environment. What is not imported is named on stderr.

    Examples:
        edgectl import compose compose.yaml
        edgectl import compose compose.yaml --out lab
    """
    from edgectl.usecases.import_files import import_compose

    _put(import_compose(str(file)), out)


def import_paper_command(
    *,
    file: Annotated[Path, Argument(metavar="FILE", help="Such as task_req.yaml.", show_default=False)],
    out: _OutOption = None,
) -> None:
    """Make tasks from a requirement file of the paper's authors: demands, predecessors, order and commands.

    Examples:
        edgectl import paper task_req.yaml
        edgectl import paper task_req.yaml --out lab
    """
    from edgectl.usecases.import_files import import_paper

    _put(import_paper(str(file)), out)


def _put(made: "Imported", out: Path | None) -> None:
    """Print the task file, or the inventory if there are no tasks; with ``out``, write all files."""
    console.print_input_warnings(made.notes)
    if not made.tasks and not made.inventory:
        console.print_message("note: no node is new, so there is no task file")
        return
    if out is None:
        console.print_text(made.tasks or made.inventory)
        if made.tasks and made.inventory:
            console.print_message("note: the inventory is written with --out DIR")
        return
    from edgectl.cli.user_files import PUBLIC_FILE_MODE, make_directory, save_file

    contents = {
        out / folder / f"{made.name}.yaml": text
        for folder, text in (("inventories", made.inventory), ("tasks", made.tasks))
        if text
    }
    for path in contents:
        if path.exists():
            raise UsageError(f"{path} exists", hint="remove it, or name another directory")
    for path, text in contents.items():
        make_directory(path.parent)
        save_file(path, text, mode=PUBLIC_FILE_MODE)
        console.print_text(f"wrote {path}\n")
    if len(contents) == 2:
        inventory, tasks = contents
        console.print_message(f"next: edgectl validate -i {inventory} -t {tasks}")
