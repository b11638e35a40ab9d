"""Shell completion from local files; no host is contacted."""

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from edgectl.errors import EdgectlError


def complete_hosts(incomplete: str) -> list[str]:
    """Names of hosts in the inventory."""
    from edgectl.cli.user_files import resolve_inventory_path
    from edgectl.config.load import load_inventory

    try:
        names = list(
            load_inventory(
                resolve_inventory_path(_find_named_file("-i", "--inventory", "EDGECTL_INVENTORY"))
            ).hosts
        )
    except EdgectlError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def complete_tasks(incomplete: str) -> list[str]:
    """Names of tasks in the task files."""
    from edgectl.cli.user_files import resolve_inventory_path, resolve_task_paths
    from edgectl.config.load import load_inventory_and_tasks

    named = _find_named_file("-t", "--tasks", "EDGECTL_TASKS")
    try:
        names = load_inventory_and_tasks(
            resolve_inventory_path(_find_named_file("-i", "--inventory", "EDGECTL_INVENTORY")),
            resolve_task_paths([named] if named else None),
        )[1].tasks
    except EdgectlError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def _find_named_file(short: str, long: str, variable: str) -> Path | None:
    """The file named on the line being completed, or in the environment."""
    words = _split_completed_line()
    following = [after for word, after in pairwise(words) if word in (short, long)]
    text = following[-1] if following else os.environ.get(variable)
    return Path(text) if text else None


def _split_completed_line() -> Sequence[str]:
    return (os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS") or "").split()
