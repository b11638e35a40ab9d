# SPDX-License-Identifier: Apache-2.0
"""Choice of inventory, tasks and defaults: options, environment, project file, user (ADR 139)."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edgectl.dataclass import dataclass
from edgectl.errors import UsageError
from edgectl.names import check_known_names

if TYPE_CHECKING:
    from edgectl.config.project_file import Context, NamedPath, SettingsFile

PROJECT_FILE, _USER_FILE = "edgectl.yaml", "config.yaml"
INVENTORY_VARIABLE, TASKS_VARIABLE, CONTEXT_VARIABLE = (
    "EDGECTL_INVENTORY",
    "EDGECTL_TASKS",
    "EDGECTL_CONTEXT",
)
INSECURE_FILES_VARIABLE = "EDGECTL_INSECURE_FILES"
INVENTORIES_DIRECTORY, TASKS_DIRECTORY = "inventories", "tasks"
_YAML_SUFFIXES = (".yaml", ".yml")
# Of this call, by the root of the command line.
_given_context: list[str] = []


class PreferredOutput(str):
    """A default form of output: a command that has not got it keeps its own."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The settings files that apply in the current folder."""

    project: "SettingsFile | None" = None
    user: "SettingsFile | None" = None

    @property
    def folder(self) -> Path:
        """The folder of the project; the current one without a project."""
        return self.project.path.parent if self.project else Path()

    @property
    def contexts(self) -> "Mapping[str, Context]":
        """Contexts by name; those of the project hide those of the user."""
        return {
            name: context
            for file in (self.user, self.project)
            if file is not None
            for name, context in file.contexts.items()
        }

    @property
    def defaults(self) -> Mapping[str, str | int | bool]:
        """Defaults of options by parameter."""
        files = (file for file in (self.user, self.project) if file is not None)
        return {key: value for file in files for key, value in file.defaults.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenFiles:
    """The inventories and where their choice comes from; ``tasks``: what is named, empty where tasks/ of
    ``folder`` holds it.
    """

    inventories: tuple[Path, ...]
    tasks: tuple[Path, ...]
    folder: Path
    context: str = ""
    inventory_origin: str = ""
    tasks_origin: str = ""


def use_context_option(name: str | None) -> None:
    """Remember ``--context`` of this call."""
    _given_context[:] = [name] if name else []


def is_context_given() -> bool:
    """Whether this call has ``--context``."""
    return bool(_given_context)


def is_insecure_allowed() -> bool:
    """Whether files that others may write are used nevertheless."""
    return os.environ.get(INSECURE_FILES_VARIABLE, "0") not in ("", "0")


def load_settings() -> Settings:
    """The project file of the current folder and the user's configuration, as far as they exist.

    Raises:
        InputError: one of them has mistakes, or others may write it.
    """
    project_path, user_path = find_project_path(), get_user_file()
    user_exists = user_path is not None and os.path.lexists(user_path)
    if project_path is None and not user_exists:
        return Settings()
    from edgectl.config.project_file import load_settings_file

    user = load_settings_file(user_path, of_user=True) if user_path is not None and user_exists else None
    if project_path is None:
        return Settings(user=user)
    if not is_insecure_allowed():
        from edgectl.config.project_owner import check_project_owner

        check_project_owner(project_path, user.safe_directories if user else (), user_path)
    return Settings(project=load_settings_file(project_path), user=user)


def find_project_file(folder: Path) -> Path | None:
    """The nearest ``edgectl.yaml`` in ``folder`` or above it; the nearest one hides all others."""
    for parent in (folder, *folder.parents):
        path = parent / PROJECT_FILE
        if os.path.lexists(path):
            return path
    return None


def get_user_file() -> Path | None:
    """Path of the user's configuration, whether it exists or not; None for a user without a home."""
    stated = os.environ.get("XDG_CONFIG_HOME", "")
    base = Path(stated if os.path.isabs(stated) else os.path.expanduser("~/.config"))  # noqa: PTH111, PTH117
    return base / "edgectl" / _USER_FILE if base.is_absolute() else None


def load_option_defaults() -> dict[str, Any]:
    """Defaults of options by parameter, as the parser of the command line takes them."""
    defaults = dict(load_settings().defaults)
    if "output" in defaults:
        defaults["output"] = PreferredOutput(defaults["output"])
    return defaults


def find_project_path() -> Path | None:
    """The project file that applies in the current folder, relative to it where that is short."""
    try:
        here = Path.cwd()
    except OSError:
        return None  # the folder was removed
    found = find_project_file(here)
    return None if found is None else Path(os.path.relpath(found, here))


def read_environment_paths(variable: str) -> list[Path]:
    """The paths in a variable, separated by colons."""
    return [Path(word) for word in os.environ.get(variable, "").split(os.pathsep) if word]


def choose_files(
    inventory: Sequence[Path] | None, tasks: Sequence[Path] | None, context: str | None = None
) -> ChosenFiles:
    """The files of this call. ``context``: of ``--context``; None: as given to this process.

    Inventory and tasks come from one place, so that the tasks of one fleet never meet the hosts of another,
    unless an option or a variable names one of them. A context of the environment gives way to ``-i``.

    Raises:
        UsageError: none is given and none can be chosen, or two choices contradict each other.
        InputError: what is wrong with the settings files.
    """
    given = context or next(iter(_given_context), "")
    settings = load_settings()
    named = _find_named_inventories(inventory, given)
    variable = read_environment_paths(TASKS_VARIABLE)
    if named is not None:
        chosen = ChosenFiles(
            inventories=named[0],
            folder=settings.folder,
            tasks=_name_files(settings.project.tasks if settings.project else ()),
            inventory_origin=named[1],
            tasks_origin=find_place(settings.project, "tasks"),
        )
    else:
        chosen = _choose_by_settings(settings, given)
    if tasks:
        return _replace_tasks(chosen, tasks, "-t")
    if variable and not given:
        return _replace_tasks(chosen, variable, TASKS_VARIABLE)
    return chosen


def _find_named_inventories(
    inventory: Sequence[Path] | None, given: str
) -> tuple[tuple[Path, ...], str] | None:
    """The inventories that the call names or, without ``--context``, the environment; and by what."""
    if inventory:
        if given:
            raise UsageError("-i and --context both choose the inventory", hint="pass one of the two")
        return tuple(inventory), "-i"
    variable = read_environment_paths(INVENTORY_VARIABLE)
    if not variable or given:
        return None
    if os.environ.get(CONTEXT_VARIABLE):
        raise UsageError(
            f"{INVENTORY_VARIABLE} and {CONTEXT_VARIABLE} both choose the inventory",
            hint="unset one of the two",
        )
    return tuple(variable), INVENTORY_VARIABLE


def _replace_tasks(chosen: ChosenFiles, tasks: Sequence[Path], origin: str) -> ChosenFiles:
    return ChosenFiles(
        inventories=chosen.inventories,
        tasks=tuple(tasks),
        folder=chosen.folder,
        context=chosen.context,
        inventory_origin=chosen.inventory_origin,
        tasks_origin=origin,
    )


def choose_context(settings: Settings, given: str | None = None) -> tuple[str, str]:
    """The name of the context and where it is chosen; two empty texts if none is."""
    given = given or next(iter(_given_context), "")
    if given:
        return given, "--context"
    if os.environ.get(CONTEXT_VARIABLE):
        return os.environ[CONTEXT_VARIABLE], CONTEXT_VARIABLE
    for file in (settings.project, settings.user):
        if file is not None and file.context is not None:
            return file.context, find_place(file, "context")
        if file is settings.project and _has_own_inventory(settings):
            return "", ""  # nearer than the context of the user
    return "", ""


def _has_own_inventory(settings: Settings) -> bool:
    """Whether the project, or without one the current folder, has an inventory without any context."""
    named = settings.project is not None and settings.project.inventory
    return bool(named or list_yaml_files(settings.folder / INVENTORIES_DIRECTORY))


def _choose_by_settings(settings: Settings, given: str) -> ChosenFiles:
    name, origin = choose_context(settings, given)
    if name:
        return _choose_by_context(settings, name, origin)
    for file in (settings.project, settings.user):
        if file is not None and file.inventory:
            _check_files(file.inventory, "inventory")
            return ChosenFiles(
                inventories=_name_files(file.inventory),
                tasks=_name_files(file.tasks),
                folder=file.path.parent,
                inventory_origin=find_place(file, "inventory"),
                tasks_origin=find_place(file, "tasks"),
            )
        if file is settings.project and _has_own_inventory(settings):
            break
    folder = settings.folder
    return ChosenFiles(
        inventories=(find_only_file("inventory", folder, INVENTORIES_DIRECTORY, "-i"),),
        tasks=_name_files(settings.project.tasks if settings.project else ()),
        folder=folder,
        inventory_origin=f"{folder / INVENTORIES_DIRECTORY}/",
        tasks_origin=find_place(settings.project, "tasks"),
    )


def _choose_by_context(settings: Settings, name: str, origin: str) -> ChosenFiles:
    contexts = settings.contexts
    if name not in contexts:
        check_known_names([name], contexts, "context" if origin == "--context" else f"context ({origin})")
    context = contexts[name]
    owner = settings.project
    if owner is None or owner.contexts.get(name) is not context:
        owner = settings.user
    tasks = context.tasks or (owner.tasks if owner else ())
    _check_files(context.inventory, f"inventory of context {name}")
    _check_files(tasks, f"tasks of context {name}")
    return ChosenFiles(
        inventories=_name_files(context.inventory),
        tasks=_name_files(tasks),
        folder=owner.path.parent if owner else Path(),
        context=name,
        inventory_origin=_format_mark(context.inventory[0]),
        tasks_origin=_format_mark(tasks[0]) if tasks else "",
    )


def _check_files(named: "Sequence[NamedPath]", what: str) -> None:
    from edgectl.config.problems import Problems
    from edgectl.config.project_file import check_named_paths

    problems = Problems()
    check_named_paths(named, what, problems)
    problems.check()


def _name_files(named: "Sequence[NamedPath]") -> tuple[Path, ...]:
    return tuple(each.path for each in named)


def find_place(file: "SettingsFile | None", key: str) -> str:
    """FILE:LINE of a key; empty where the file does not have it."""
    mark = file.marks.get(key) if file is not None else None
    return f"{mark.source.file}:{mark.line}" if mark is not None else ""


def find_default_place(settings: Settings, key: str) -> str:
    """Where the default of an option stands."""
    return find_place(settings.project, f"defaults.{key}") or find_place(settings.user, f"defaults.{key}")


def _format_mark(named: "NamedPath") -> str:
    return f"{named.mark.source.file}:{named.mark.line}"


def list_yaml_files(directory: Path) -> list[Path]:
    """The YAML files in a directory, in order."""
    return sorted(path for path in directory.glob("*") if path.suffix in _YAML_SUFFIXES and path.is_file())


def find_only_file(what: str, folder: Path, directory: str, option: str) -> Path:
    """The only YAML file in ``directory`` of the project.

    Raises:
        UsageError: there is none, or more than one.
    """
    inside = folder / directory
    files = list_yaml_files(inside)
    if len(files) == 1:
        return files[0]
    if not files:
        own = directory == TASKS_DIRECTORY and list_yaml_files(folder / INVENTORIES_DIRECTORY)
        raise UsageError(
            f"no {what} given, and there is none in {inside}/",
            hint=f"pass {option} FILE, or "
            + (f"write {inside}/{own[0].name}" if own else _suggest_folder(folder)),
        )
    names = ", ".join(file.name for file in files)
    raise UsageError(
        f"no {what} given, and {inside}/ holds {len(files)}: {names}", hint=f"pass {option} {files[0]}"
    )


def _suggest_folder(folder: Path) -> str:
    from edgectl.cli.folder_hint import suggest_project

    return suggest_project(folder)
