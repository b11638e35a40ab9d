# SPDX-License-Identifier: Apache-2.0
"""init, validate, version and completion commands."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from edgectl.cli import console
from edgectl.cli.options import InventoryOption, ItemOutput, Shell, TasksOption, ValidateOutput
from edgectl.cli.project import load_settings
from edgectl.cli.user_files import load_inputs
from edgectl.errors import FileError
from edgectl.views.output_format import OutputFormat

# Of one folder; of more only their count.
_MAX_FILES_LISTED = 3


def init_command(
    directory: Annotated[
        Path,
        Argument(metavar="DIR", help="Created if missing; existing files are kept.", show_default=False),
    ],
) -> None:
    """Create an example fleet on this machine (inventories/, tasks/, README.md) that plans and applies at
    once.

    Examples:
        edgectl init demo
        edgectl init .
    """
    from edgectl.cli.schema import render_editor_schemas
    from edgectl.scaffold.write import write_scaffold

    try:
        written = write_scaffold(directory, render_editor_schemas())
    except OSError as error:
        raise FileError(f"cannot write {error.filename or directory}: {error.strerror}") from error
    console.print_text("".join(f"{line}\n" for line in _list_written(written)))
    enter = "" if directory.resolve() == Path.cwd() else f"cd {shlex.quote(str(directory))} && "
    console.print_message(f"next: {enter}edgectl plan")


def _list_written(written: Mapping[Path, bool]) -> list[str]:
    """A line per file, and one for the many of a folder, so that the next command stays on the screen."""
    groups: dict[tuple[Path, bool], list[Path]] = {}
    for path, new in written.items():
        groups.setdefault((path.parent, new), []).append(path)
    return [
        f"{'wrote' if new else 'kept '} {shown}"
        for (folder, new), paths in groups.items()
        for shown in (
            [f"{folder}/ ({len(paths)} files)"] if len(paths) > _MAX_FILES_LISTED else map(str, paths)
        )
    ]


def validate_command(
    inventory: InventoryOption = None, tasks: TasksOption = None, output: ValidateOutput = OutputFormat.TABLE
) -> None:
    """Check inventory and task files offline: all problems at once, with positions and hints. No host is
    contacted.

    Examples:
        edgectl validate
        edgectl validate -i inventories/local.yaml -t tasks/demo.yaml
        edgectl validate -o github
        edgectl validate -o gitlab
    """
    from edgectl.usecases.validate import list_uneven_demands
    from edgectl.views.demands import list_demand_spread_notes
    from edgectl.views.validation import ValidationView

    loaded = load_inputs(inventory, tasks, every_warning=True)
    _check_settings()
    for line in list_demand_spread_notes(list_uneven_demands(loaded.inventory, loaded.tasks)):
        console.print_message(f"note: {line}")
    if output is OutputFormat.GITLAB:
        from edgectl.views.gitlab import render_report

        console.print_text(render_report(()))
    elif output is not OutputFormat.GITHUB:
        console.print_view(ValidationView(loaded.inventory, loaded.tasks), output)


def _check_settings() -> None:
    """Check what the settings files name besides the chosen files."""
    settings = load_settings()
    files = [file for file in (settings.project, settings.user) if file is not None]
    if files:
        from edgectl.config.project_file import check_settings_files

        check_settings_files(files)


def version_command(output: ItemOutput = OutputFormat.TABLE) -> None:
    """Print the version of edgectl and of its Python.

    Examples:
        edgectl version
        edgectl version -o json
    """
    from platform import python_version

    from edgectl import __version__
    from edgectl.views.validation import VersionView

    console.print_view(VersionView({"edgectl": __version__, "python": python_version()}), output)


def completion_command(
    shell: Annotated[
        Shell | None,
        Argument(metavar="[SHELL]", help="bash, zsh or fish; default: $SHELL.", show_default=False),
    ] = None,
    *,
    install: Annotated[
        bool, Option("--install", help="Install it, and the man pages, for this user.")
    ] = False,
) -> None:
    """Print the completion script of a shell, or install it with the man pages (man edgectl-plan). Names come
    from local files; completion never contacts a host.

    Examples:
        edgectl completion --install
        edgectl completion zsh --install
        edgectl completion bash
    """
    from edgectl.cli.shell_setup import find_shell, get_completion_text, install_completion

    wanted = find_shell(shell)
    if not install:
        console.print_text(get_completion_text(wanted))
        return
    written = install_completion(wanted)
    pages = sum(path.suffix == ".1" for path in written)
    for path in written:
        if path.suffix != ".1":
            console.print_message(f"wrote {path}")
    console.print_message(f"wrote {pages} man pages to {written[-1].parent}; open a new {wanted}")
