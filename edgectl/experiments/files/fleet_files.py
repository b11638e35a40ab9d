# SPDX-License-Identifier: Apache-2.0
"""Inventory and task file that an experiment or a scenario names, and references to what is in them."""

from collections.abc import Iterable
from pathlib import Path

from edgectl.config.fields import Fields
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems


def resolve_fleet_files(
    path: Path, fields: Fields | None, problems: Problems
) -> tuple[Path | None, Path | None]:
    """Paths of the inventory and the task file named in the file ``path``, relative to it; None if not named.

    Raises:
        InputError: all faults of the file's structure.
    """
    problems.check()
    named = [fields.values.get(key) if fields else None for key in ("inventory", "tasks")]
    inventory, tasks = (None if name is None else path.parent / name for name in named)
    return inventory, tasks


def check_name_exists(node: Node, word: str, known: Iterable[str], what: str, problems: Problems) -> bool:
    """Whether ``word`` is one of ``known``; otherwise a problem at that key of ``node``, or at the node."""
    if word in known:
        return True
    problems.add(
        node.key_mark(word),
        ProblemCode.UNKNOWN_NAME,
        f"unknown {what} {word}",
        problems.did_you_mean(word, known, f"{what}s:"),
    )
    return False
