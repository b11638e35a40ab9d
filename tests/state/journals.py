"""What stands in a journal."""

from pathlib import Path

from edgectl.state.journal_read import Entry, read


def entries(path: Path) -> list[Entry]:
    """Its entries, oldest first."""
    found: list[Entry] = []
    read(path, found.append)
    return found
