# SPDX-License-Identifier: Apache-2.0
"""Hint to the folder of a fleet, where the current one is none."""

import os
from pathlib import Path

from edgectl.cli.project import INVENTORIES_DIRECTORY, PROJECT_FILE, list_yaml_files
from edgectl.names import format_name_list


def suggest_project(folder: Path) -> str:
    """What to do where no inventory is found: a folder above may be a fleet that is not marked as one."""
    for parent in folder.absolute().parents:
        if list_yaml_files(parent / INVENTORIES_DIRECTORY):
            return (
                f"mark {parent} as the project: echo 'version: 1' > "
                f"{Path(os.path.relpath(parent)) / PROJECT_FILE}"
            )
    below = sorted(path for path in _list_folders(folder) if _is_fleet(path))
    if below:
        return f"enter the folder of the fleet: cd {format_name_list(list(map(str, below)))}"
    return "create an example fleet: edgectl init ."


def _list_folders(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if not path.name.startswith(".") and path.is_dir()]
    except OSError:
        return []


def _is_fleet(folder: Path) -> bool:
    """Whether a project file or an inventory lies in ``folder``."""
    try:
        return (folder / PROJECT_FILE).is_file() or bool(list_yaml_files(folder / INVENTORIES_DIRECTORY))
    except OSError:
        return False
