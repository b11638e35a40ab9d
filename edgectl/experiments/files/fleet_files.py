"""Inventory and task file that an experiment or a scenario names."""

from pathlib import Path

from edgectl.config.fields import Fields
from edgectl.config.problems import Problems


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
