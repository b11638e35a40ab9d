"""What stands in a journal."""

from pathlib import Path

from edgectl.state.journal_reader import JournalEntry, read_journal


def entries(path: Path) -> list[JournalEntry]:
    """Its entries, oldest first."""
    found: list[JournalEntry] = []
    read_journal(path, found.append)
    return found
