# SPDX-License-Identifier: Apache-2.0
"""Reading journals in tests."""

from pathlib import Path

from edgectl.state.journal_reader import JournalEntry, read_journal


def read_entries(path: Path) -> list[JournalEntry]:
    """Return the entries, oldest first."""
    found: list[JournalEntry] = []
    read_journal(path, found.append)
    return found
