# SPDX-License-Identifier: Apache-2.0
"""Loading of inventory and task files into the model: all problems of all files at once, warnings apart."""

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from edgectl.config.expansion import expand_templates
from edgectl.config.fields import Fields
from edgectl.config.inventory_merge import read_inventories
from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.config.source import read_source
from edgectl.config.task_file import TaskTemplate, merge_policy, read_templates
from edgectl.config.yaml_parser import parse_yaml
from edgectl.errors import Problem
from edgectl.formats.digest import digest_tasks
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks

StrPath = str | Path
# A host keeps the id in a record of 2 KiB, beside the digests of 20 fields.
_MAX_FILE_ID = 200


def load_inventory(paths: StrPath | Iterable[StrPath]) -> Inventory:
    """Load the inventory from a file, or from several that make one fleet together.

    Raises:
        InputError: everything that is wrong with it.
    """
    problems = Problems()
    inventory = _read_inventory_files(_list_paths(paths), problems)
    problems.check()
    return inventory or Inventory(hosts={})


def load_tasks(paths: StrPath | Iterable[StrPath], inventory: Inventory, *, base: StrPath = ".") -> Tasks:
    """Load the tasks of a fleet from files, or from all ``*.yaml`` and ``*.yml`` of directories.

    ``base``: the directory of the inventory, relative to which task files are identified.

    Raises:
        InputError: everything that is wrong with them.
    """
    problems = Problems()
    tasks = _read_task_files(_list_paths(paths), inventory, problems, Path(base))
    problems.check()
    return tasks


def load_inventory_and_tasks(
    inventory_paths: StrPath | Iterable[StrPath], tasks_paths: StrPath | Iterable[StrPath]
) -> tuple[Inventory, Tasks, tuple[Problem, ...]]:
    """Load both, with the warnings.

    Raises:
        InputError: everything that is wrong with either.
    """
    problems = Problems()
    paths = _list_paths(inventory_paths)
    inventory = _read_inventory_files(paths, problems)
    tasks = _read_task_files(_list_paths(tasks_paths), inventory, problems, find_task_base(paths))
    problems.check()
    if inventory is not None and not inventory.is_fleet_named:
        _warn_of_unnamed_fleet(paths[0], inventory.fleet, problems)
    return inventory or Inventory(hosts={}), tasks, problems.warnings


def _warn_of_unnamed_fleet(path: Path, fleet: str, problems: Problems) -> None:
    start = Mark(Source(file=str(path), text="", lines=()), 1, 1)
    message = f"no fleet name: {fleet} stands for the path of this file, which may change"
    problems.add(start, ProblemCode.UNNAMED_FLEET, message, f"add fleet: {fleet}", warning=True)


def _list_paths(paths: StrPath | Iterable[StrPath]) -> list[Path]:
    return [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]


def find_task_base(inventories: Sequence[Path]) -> Path:
    """The directory relative to which task files are identified: that of the inventory, or the one that
    several have in common.
    """
    if len(inventories) == 1:
        return inventories[0].parent
    return Path(os.path.commonpath([path.resolve().parent for path in inventories]))


def _read_inventory_files(paths: Sequence[Path], problems: Problems) -> Inventory | None:
    """The inventory of all files; None if one of them cannot be read, or none names a host."""
    nodes = []
    for path in dict.fromkeys(paths):
        source = read_source(path, problems)
        nodes.append(parse_yaml(source, problems) if source is not None else None)
    found = [node for node in nodes if node is not None]
    if not found or len(found) < len(nodes):
        return None
    inventory = read_inventories(found, problems)
    # Without any host every name in a task file is unknown, which is no mistake of that file.
    return inventory if inventory.hosts else None


def _read_task_files(paths: list[Path], inventory: Inventory | None, problems: Problems, base: Path) -> Tasks:
    """The tasks; if the inventory could not be read, only their shape is checked."""
    templates: dict[str, TaskTemplate] = {}
    files: list[Fields] = []
    given = dict.fromkeys(file for path in paths for file in _list_task_files(path, problems))
    for file in given:
        source = read_source(file, problems)
        node = parse_yaml(source, problems) if source is not None else None
        if node is not None:
            files.append(read_templates(node, problems, templates, identify_path(file, base)))
    policy = merge_policy(files, problems)
    tasks = Tasks(
        tasks=expand_templates(templates, inventory, problems) if inventory is not None else {},
        policy=policy,
        files=frozenset(identify_path(file, base) for file in given),
        folders=frozenset(identify_path(path, base) for path in paths if path.is_dir()),
    )
    return replace(tasks, digest=digest_tasks(tasks))


def identify_path(path: Path, base: Path) -> str:
    """The id of a task file or of a directory of them: its path relative to ``base``, the directory of the
    inventory, with links resolved (ADR 0039).

    The same in every clone of a repository. One that is too long for the record on a host is known by its
    digest there, and so is never found through its directory.
    """
    relative = Path(os.path.relpath(path.resolve(), base.resolve())).as_posix()
    if len(json.dumps(relative)) <= _MAX_FILE_ID:
        return relative
    return f"sha256:{hashlib.sha256(relative.encode()).hexdigest()}"


def _list_task_files(path: Path, problems: Problems) -> list[Path]:
    if not path.is_dir():
        return [path]
    inside = sorted(
        entry for entry in path.iterdir() if entry.suffix in (".yaml", ".yml") and entry.is_file()
    )
    if not inside:
        nowhere = Mark(Source(file=str(path), text="", lines=()), 0, 0)
        problems.add(
            nowhere,
            ProblemCode.EMPTY,
            "no .yaml file in this directory",
            "name a task file, or create one: edgectl init DIR",
        )
    return inside
