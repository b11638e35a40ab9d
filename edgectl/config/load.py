"""Inventory and task files to the model: every mistake of all files at once, and warnings apart."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from edgectl.config.expand import expand
from edgectl.config.fields import Fields
from edgectl.config.inventory import read_inventory
from edgectl.config.problems import Code, Mark, Problems, Source
from edgectl.config.source import read_source
from edgectl.config.tasks import Template, merge_policy, read_templates
from edgectl.config.yaml12 import parse_yaml
from edgectl.errors import Problem
from edgectl.formats.digest import tasks_digest
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks

StrPath = str | Path


def load_inventory(path: StrPath) -> Inventory:
    """The inventory in a file.

    Raises:
        InputError: everything that is wrong with it.
    """
    problems = Problems()
    inventory = _inventory(Path(path), problems)
    problems.check()
    return inventory or Inventory(hosts={})


def load_tasks(paths: StrPath | Iterable[StrPath], inventory: Inventory) -> Tasks:
    """The tasks in files, or in all ``*.yaml`` and ``*.yml`` of directories, for a fleet.

    Raises:
        InputError: everything that is wrong with them.
    """
    problems = Problems()
    tasks = _tasks(_listed(paths), inventory, problems)
    problems.check()
    return tasks


def load(inventory_path: StrPath, tasks_paths: StrPath | Iterable[StrPath]) -> tuple[Inventory, Tasks, tuple[Problem, ...]]:
    """Both, and the warnings.

    Raises:
        InputError: everything that is wrong with either.
    """
    problems = Problems()
    inventory = _inventory(Path(inventory_path), problems)
    tasks = _tasks(_listed(tasks_paths), inventory, problems)
    problems.check()
    return inventory or Inventory(hosts={}), tasks, problems.warnings


def _listed(paths: StrPath | Iterable[StrPath]) -> list[Path]:
    return [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]


def _inventory(path: Path, problems: Problems) -> Inventory | None:
    source = read_source(path, problems)
    node = parse_yaml(source, problems) if source is not None else None
    return None if node is None else read_inventory(node, problems)


def _tasks(paths: list[Path], inventory: Inventory | None, problems: Problems) -> Tasks:
    """The tasks; where the inventory could not be read at all, only their shape is checked."""
    templates: dict[str, Template] = {}
    files: list[Fields] = []
    for file in dict.fromkeys(file for path in paths for file in _files(path, problems)):
        source = read_source(file, problems)
        node = parse_yaml(source, problems) if source is not None else None
        if node is not None:
            files.append(read_templates(node, problems, templates))
    policy = merge_policy(files, problems)
    tasks = Tasks(tasks=expand(templates, inventory, problems) if inventory is not None else {}, policy=policy)
    return replace(tasks, digest=tasks_digest(tasks))


def _files(path: Path, problems: Problems) -> list[Path]:
    if not path.is_dir():
        return [path]
    inside = sorted(entry for entry in path.iterdir() if entry.suffix in (".yaml", ".yml") and entry.is_file())
    if not inside:
        nowhere = Mark(Source(file=str(path), text="", lines=()), 0, 0)
        problems.add(nowhere, Code.EMPTY, "no .yaml file in this directory", "name a task file, or make one: edgectl init DIR")
    return inside
