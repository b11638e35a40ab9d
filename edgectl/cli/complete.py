"""What Tab offers: names from the files at hand. A host is never asked."""

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from edgectl.errors import EdgectlError


def hosts(incomplete: str) -> list[str]:
    """Hosts of the inventory."""
    from edgectl.cli.inputs import inventory_file
    from edgectl.config.load import load_inventory

    try:
        names = list(load_inventory(inventory_file(_named("-i", "--inventory", "EDGECTL_INVENTORY"))).hosts)
    except EdgectlError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def tasks(incomplete: str) -> list[str]:
    """Tasks of the task files."""
    from edgectl.cli.inputs import inventory_file, task_files
    from edgectl.config.load import load

    named = _named("-t", "--tasks", "EDGECTL_TASKS")
    try:
        names = load(inventory_file(_named("-i", "--inventory", "EDGECTL_INVENTORY")), task_files([named] if named else None))[1].tasks
    except EdgectlError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def _named(short: str, long: str, variable: str) -> Path | None:
    """The file that stands on the line being completed, or in the environment."""
    words = _line()
    following = [after for word, after in pairwise(words) if word in (short, long)]
    text = following[-1] if following else os.environ.get(variable)
    return Path(text) if text else None


def _line() -> Sequence[str]:
    return (os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS") or "").split()
