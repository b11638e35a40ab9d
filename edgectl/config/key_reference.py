# SPDX-License-Identifier: Apache-2.0
"""The reference of ``edgectl explain``: keys of the files, codes of problems and checks of the doctor.

Its text is made from the pages (``python -m tests.docs.key_reference``).
"""

import re
from functools import cache
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.names import check_known_names

# Other words for the first part of a path: singular and plural, and what defaults and both roles share.
_ROOTS = {
    "edge": "host",
    "edges": "host",
    "robot": "host",
    "robots": "host",
    "hosts": "host",
    "links": "link",
    "checks": "check",
}
_CODE = re.compile(r"EC[0-9]{3}", re.IGNORECASE)
_STARTS = ("inventory", "host", "link", "tasks", "task", "check")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceEntry:
    """One key, code or check. ``values`` and ``default`` of a key; ``keys`` below it, with their meanings."""

    name: str
    values: str = ""
    default: str = ""
    meaning: str = ""
    keys: tuple["ReferenceEntry", ...] = ()


def is_reference_word(word: str) -> bool:
    """Whether ``word`` names a code (EC101), or a key or check by its path (task.demand.cpu, check.clock)."""
    root, dot, _ = word.partition(".")
    return bool(_CODE.fullmatch(word)) or (bool(dot) and _ROOTS.get(root, root) in _STARTS)


def find_reference(word: str) -> ReferenceEntry:
    """The entry of a code, a key or a check.

    Raises:
        UsageError: there is none; the hint has the nearest one.
    """
    entries = _load_entries()
    root, dot, rest = word.partition(".")
    path = word.upper() if _CODE.fullmatch(word) else _ROOTS.get(root, root) + dot + rest
    check_known_names([path], entries, "key, code or check")
    found = entries[path]
    below = tuple(
        entry
        for name, entry in entries.items()
        if name.rpartition(".")[0] == path and not _CODE.fullmatch(name)
    )
    return ReferenceEntry(
        name=path, values=found.values, default=found.default, meaning=found.meaning, keys=below
    )


def list_reference_words() -> list[str]:
    """Every path and code."""
    return list(_load_entries())


@cache
def _load_entries() -> dict[str, ReferenceEntry]:
    lines = Path(__file__).with_name("key_reference.tsv").read_text(encoding="utf-8").splitlines()
    rows = (line.split("\t") for line in lines)
    return {
        name: ReferenceEntry(name=name, values=values, default=default, meaning=meaning)
        for name, values, default, meaning in rows
    }
