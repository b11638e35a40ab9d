"""Choice, reading and writing of the user's files."""

import errno
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from stat import S_IMODE, S_ISLNK, S_ISREG
from tempfile import mkstemp
from typing import BinaryIO

from edgectl.cli.project import (
    INVENTORY_VARIABLE,
    TASKS_DIRECTORY,
    TASKS_VARIABLE,
    ChosenFiles,
    choose_files,
    find_only_file,
    is_context_given,
    is_insecure_allowed,
    list_yaml_files,
    read_environment_paths,
)
from edgectl.dataclass import dataclass
from edgectl.errors import FileError, InputError, Problem, UsageError
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks

PRIVATE_FILE_MODE = 0o600
# Of files that another account has to read: node_exporter, systemd.
PUBLIC_FILE_MODE = 0o644
_MAX_LINKS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedInputs:
    """Inventory and tasks as read, and the path of the inventory, or of the first of several.

    ``exposed``: warnings about the files that others may write.
    """

    inventory: Inventory
    tasks: Tasks
    path: Path
    exposed: tuple[Problem, ...] = ()


def load_inputs(
    inventory: Sequence[Path] | None,
    tasks: Sequence[Path] | None,
    *,
    every_warning: bool = False,
    quiet: bool = False,
    needs_tasks: bool = True,
) -> LoadedInputs:
    """Load the files, given or found; warnings go to stderr unless ``quiet`` or said with more detail by a
    plan or by ``validate`` and ``doctor``.

    Not ``needs_tasks``: there are no tasks if no task file is given and tasks/ does not hold exactly one.

    Raises:
        UsageError: none is given and none can be chosen.
        InputError: everything that is wrong with them, or with the settings that choose them.
    """
    from edgectl.cli.console import print_input_warnings
    from edgectl.config.load import load_inventory_and_tasks as read
    from edgectl.config.problems import ProblemCode

    chosen = choose_files(inventory, tasks)
    optional = not needs_tasks and not chosen.tasks
    found = list_yaml_files(chosen.folder / TASKS_DIRECTORY) if optional else []
    paths = [] if optional and len(found) != 1 else list_task_paths(chosen)
    fleet, work, warnings = read(chosen.inventories, paths)
    elsewhere = (
        () if every_warning else (ProblemCode.NO_DEMAND, ProblemCode.UNNAMED_FLEET, ProblemCode.EXPOSED)
    )
    print_input_warnings(warning for warning in warnings if not quiet and warning.code not in elsewhere)
    return LoadedInputs(
        inventory=fleet, tasks=work, path=chosen.inventories[0], exposed=select_exposed(warnings)
    )


def load_named_inputs(
    inventory: Sequence[Path] | None,
    tasks: Sequence[Path] | None,
    named_inventory: Path | None,
    named_tasks: Path | None,
) -> LoadedInputs:
    """The same for a mission file, which names its own; options and variables come first."""
    own_inventory = named_inventory is not None and not (
        inventory or is_context_given() or read_environment_paths(INVENTORY_VARIABLE)
    )
    own_tasks = named_tasks is not None and not (tasks or read_environment_paths(TASKS_VARIABLE))
    return load_inputs(
        [named_inventory] if own_inventory and named_inventory else inventory,
        [named_tasks] if own_tasks and named_tasks else tasks,
    )


def select_exposed(warnings: Iterable[Problem]) -> tuple[Problem, ...]:
    """The warnings about files that others may write."""
    from edgectl.config.problems import ProblemCode

    return tuple(warning for warning in warnings if warning.code == ProblemCode.EXPOSED)


def refuse_exposed_files(exposed: Sequence[Problem]) -> None:
    """Refuse to act on files that others may write, unless ``--insecure-files`` is given.

    Raises:
        InputError: there are such files.
    """
    if exposed and not is_insecure_allowed():
        raise InputError([replace(warning, warning=False) for warning in exposed])


def list_task_paths(chosen: ChosenFiles) -> list[Path]:
    """The named task files and directories, or the only file in tasks/ of the project."""
    if chosen.tasks and list_task_files(chosen):
        return list(chosen.tasks)
    return [find_only_file("task file", chosen.folder, TASKS_DIRECTORY, "-t")]


def list_task_files(chosen: ChosenFiles) -> list[Path]:
    """The named task files (of a directory: all of its YAML files), or the only one in tasks/."""
    if not chosen.tasks:
        return [find_only_file("task file", chosen.folder, TASKS_DIRECTORY, "-t")]
    return [file for path in chosen.tasks for file in (_get_yaml_files(path) if path.is_dir() else [path])]


def _get_yaml_files(directory: Path) -> list[Path]:
    files = list_yaml_files(directory)
    if not files:
        raise UsageError(f"no YAML file in {directory}", hint=f"name a file, or write {directory}/tasks.yaml")
    return files


def save_file(path: Path, text: str | bytes | Iterable[str], *, mode: int = PRIVATE_FILE_MODE) -> None:
    """Write a user's file, whole or not at all; directly to a pipe or a device.

    ``text`` may come in parts. ``mode``: permissions of the file, whatever the umask. A link is followed only
    if it belongs to the caller or to root: another user of the directory may have made it.

    Raises:
        FileError: it cannot be written, or is a link of another user.
    """
    try:
        target = _follow_own_links(path)
        if target.exists() and not target.is_file():
            _write_to_device(target, text)
        else:
            _write_atomically(target, text, mode)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror}") from error


def _follow_own_links(path: Path) -> Path:
    """The file that ``path`` names; the last link itself if it is one of /proc that names no path."""
    for _ in range(_MAX_LINKS):
        try:
            descriptor = os.open(path, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC)
        except FileNotFoundError:
            return path
        try:
            status = os.fstat(descriptor)
            if not S_ISLNK(status.st_mode):
                return path
            if status.st_uid not in (0, os.geteuid()):
                raise FileError(
                    f"cannot write {path}: it is a link that belongs to user {status.st_uid}",
                    hint="remove it, or name another file",
                )
            # of the link that was examined, even if another one has its name by now
            following = path.parent / os.readlink("", dir_fd=descriptor)
        finally:
            os.close(descriptor)
        if path.exists() and not following.exists():
            return path
        path = following
    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))


def make_directory(directory: Path) -> None:
    """Create the directory if it is missing.

    Raises:
        FileError: it cannot be created.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot create {directory}: {error.strerror}") from error


def replace_file_text(path: Path, before: str, after: str) -> None:
    """Write ``after`` to a user's file that still holds ``before``, whole or not at all; permissions and byte
    order mark stay.

    Raises:
        FileError: it changed meanwhile, or cannot be written.
    """
    mark = "\ufeff"
    try:
        now, mode = path.read_bytes().decode("utf-8"), S_IMODE(path.stat().st_mode)
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"cannot read {path}: {error}") from error
    if now.removeprefix(mark) != before:
        raise FileError(f"{path} changed meanwhile; it was not written", hint="run the command again")
    save_file(path, mark * now.startswith(mark) + after, mode=mode)


def _write_to_device(path: Path, text: str | bytes | Iterable[str]) -> None:
    """Write to what is no regular file, even if its name was given to one meanwhile."""
    follow = path.is_relative_to("/proc")
    descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW))
    with os.fdopen(descriptor, "wb") as file:
        if S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EEXIST, os.strerror(errno.EEXIST))
        _write_content(file, text)


def _write_atomically(path: Path, text: str | bytes | Iterable[str], mode: int) -> None:
    # a name that nobody can foresee, opened with O_EXCL and O_NOFOLLOW
    descriptor, name = mkstemp(prefix=".edgectl-", dir=path.parent)
    partial = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            _write_content(file, text)
            os.fchmod(descriptor, mode)
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _write_content(file: BinaryIO, text: str | bytes | Iterable[str]) -> None:
    if isinstance(text, bytes):
        file.write(text)
        return
    for part in [text] if isinstance(text, str) else text:
        file.write(part.encode())
