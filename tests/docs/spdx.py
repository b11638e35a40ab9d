# SPDX-License-Identifier: Apache-2.0
"""The licence line of each source file: ``python -m tests.docs.spdx`` adds the missing ones.

The agent travels to hosts, so the line is left out there when the agent is packed.
"""

from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
LINE = "# SPDX-License-Identifier: Apache-2.0\n"
# What users own: the files that edgectl init writes, and launch files as users write them.
_OF_USERS = ("edgectl/scaffold/inventories/", "edgectl/scaffold/tasks/", "tests/importers/launch/")


def list_sources() -> Iterator[Path]:
    """Python of edgectl and its tests, programs of CI, and the Makefile."""
    found = [*(ROOT / "edgectl").rglob("*.py"), *(ROOT / "tests").rglob("*.py"), *(ROOT / ".ci").iterdir()]
    for path in sorted([*found, ROOT / "Makefile"]):
        if path.is_file() and not path.relative_to(ROOT).as_posix().startswith(_OF_USERS):
            yield path


def has_line(path: Path) -> bool:
    """Whether the licence is on the first line, or on the second one of a program."""
    head = path.read_text().split("\n", 2)[:2]
    return LINE.rstrip() in (head[1:] if head[0].startswith("#!") else head[:1])


def add_line(path: Path) -> None:
    """Add the line."""
    text = path.read_text()
    first, rest = text.split("\n", 1) if text.startswith("#!") else ("", text)
    path.write_text((f"{first}\n" if first else "") + LINE + rest)


if __name__ == "__main__":
    for source in list_sources():
        if not has_line(source):
            add_line(source)
