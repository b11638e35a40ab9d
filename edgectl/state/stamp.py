"""Whether another edgectl changed what is remembered of a fleet since it was last looked at."""

from pathlib import Path

from edgectl.state.journal import NAME as JOURNAL
from edgectl.state.memory import NAME as MEMORY

Stamp = tuple[tuple[int, int, int] | None, ...]


def stamp(fleet_dir: Path) -> Stamp:
    """What changes whenever the memory or the journal of a fleet is written."""
    return tuple(_of(fleet_dir / name) for name in (MEMORY, JOURNAL))


def _of(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
