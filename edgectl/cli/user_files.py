"""Choice, reading and writing of the user's files."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from stat import S_IMODE

from edgectl.errors import FileError, UsageError
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks

_YAML_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedInputs:
    """Inventory and tasks as read, and the path of the inventory."""

    inventory: Inventory
    tasks: Tasks
    path: Path


def load_inputs(
    inventory: Path | None, tasks: Sequence[Path] | None, *, every_warning: bool = False, quiet: bool = False
) -> LoadedInputs:
    """Load both files, given or found; warnings go to stderr unless ``quiet`` or said with more detail by a
    plan or by ``validate`` and ``doctor``.

    Raises:
        UsageError: none is given and none can be chosen.
        InputError: everything that is wrong with them.
    """
    from edgectl.cli.console import print_input_warnings
    from edgectl.config.load import load_inventory_and_tasks as read
    from edgectl.config.problems import ProblemCode

    path, paths = resolve_inventory_path(inventory), choose_task_paths(tasks)
    fleet, work, warnings = read(path, paths)
    elsewhere = () if every_warning else (ProblemCode.NO_DEMAND, ProblemCode.UNNAMED_FLEET)
    print_input_warnings(warning for warning in warnings if not quiet and warning.code not in elsewhere)
    return LoadedInputs(inventory=fleet, tasks=work, path=path)


def resolve_inventory_path(given: Path | None) -> Path:
    """The given inventory, or the only one in inventories/."""
    return given if given is not None else _get_only_file("inventory", "inventories", "-i")


def choose_task_paths(given: Sequence[Path] | None) -> list[Path]:
    """The given task files and directories, each of which holds one; or the only file in tasks/."""
    return list(given) if given and resolve_task_paths(given) else resolve_task_paths(None)


def resolve_task_paths(given: Sequence[Path] | None) -> list[Path]:
    """The given task files (of a directory: all of its YAML files), or the only one in tasks/."""
    if not given:
        return [_get_only_file("task file", "tasks", "-t")]
    return [file for path in given for file in (_get_yaml_files(path) if path.is_dir() else [path])]


def _list_yaml_files(directory: Path) -> list[Path]:
    return sorted(path for path in directory.glob("*") if path.suffix in _YAML_SUFFIXES and path.is_file())


def _get_yaml_files(directory: Path) -> list[Path]:
    files = _list_yaml_files(directory)
    if not files:
        raise UsageError(f"no YAML file in {directory}", hint=f"name a file, or write {directory}/tasks.yaml")
    return files


def _get_only_file(what: str, directory: str, option: str) -> Path:
    files = _list_yaml_files(Path(directory))
    if len(files) == 1:
        return files[0]
    if not files:
        raise UsageError(
            f"no {what} given, and there is none in {directory}/",
            hint=f"pass {option} FILE, or create an example fleet: edgectl init .",
        )
    names = ", ".join(file.name for file in files)
    raise UsageError(
        f"no {what} given, and {directory}/ holds {len(files)}: {names}", hint=f"pass {option} {files[0]}"
    )


def save_file(path: Path, text: str | bytes | Iterable[str], *, mode: int | None = None) -> None:
    """Write a user's file, whole or not at all; through a link, and directly to a pipe or a device.

    ``text`` may come in parts. ``mode``: permissions of the file; by the umask if None.

    Raises:
        FileError: it cannot be written.
    """
    try:
        if path.exists() and not path.is_file():
            _write_content(path, text)
        else:
            _write_atomically(path.resolve(), text, mode)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror}") from error


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


def _write_content(path: Path, text: str | bytes | Iterable[str]) -> None:
    if isinstance(text, bytes):
        path.write_bytes(text)
        return
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines([text] if isinstance(text, str) else text)


def _write_atomically(path: Path, text: str | bytes | Iterable[str], mode: int | None) -> None:
    partial = path.with_name(f".{path.name}.partial")
    try:
        if mode is not None:
            partial.touch(mode)  # never with wider permissions than the final ones
        _write_content(partial, text)
        if mode is not None:
            partial.chmod(mode)
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
