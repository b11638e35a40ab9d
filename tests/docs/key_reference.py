# SPDX-License-Identifier: Apache-2.0
"""What ``edgectl explain KEY`` prints, made from the pages: ``python -m tests.docs.key_reference`` writes it.

The tables of docs/reference/files.md and docs/concepts/doctor.md are the one place where a key, a code and a check are
described; tests hold them against the readers of the files.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from edgectl.config import key_reference

DOCS = Path(__file__).parents[2] / "docs"
TARGET = Path(key_reference.__file__).with_name("key_reference.tsv")
# Heading of docs/reference/files.md -> the paths of its tables, in their order.
HEADINGS = {
    "Inventory": ("inventory",),
    "Coordination": ("inventory.coordination",),
    "Hosts": ("host", "host"),
    "ROS of a host": ("host.ros",),
    "Limits of a host": ("host.limits",),
    "Capacity": ("host.capacity",),
    "Base": ("host.base",),
    "Links": ("link",),
    "Tasks": ("tasks",),
    "A task": ("task",),
    "Image": ("task.image",),
    "Demand": ("task.demand",),
    "Needs": ("task.needs",),
    "Hosts of a task": ("task.hosts",),
    "Checks": ("task.ready",),
    "Liveness": ("task.alive",),
    "Latency": ("task.latency", "task.deadline"),
    "Jobs of a task": ("task.job", "task.service_time"),
    "Heard": ("task.heard",),
    "Detect": ("task.detect",),
    "Stop": ("task.stop",),
    "Handoff": ("task.handoff",),
    "Standby": ("task.standby",),
    "State of a task": ("task.state",),
    "Limits of a task": ("task.limits",),
    "Log": ("task.log",),
    "Unreachable hosts": ("task.on_unreachable",),
}
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_TABLE = re.compile(r"^\|(.*)\|\n\|[-|: ]+\|\n((?:\|.*\|\n)+)", re.MULTILINE)


def build_key_reference() -> str:
    """One line per key, code or check: name, values, default, meaning."""
    return "".join("\t".join(row) + "\n" for row in [*_list_keys(), *_list_codes(), *_list_checks()])


def _list_keys() -> Iterator[tuple[str, str, str, str]]:
    for heading, tables in _list_sections("reference/files.md"):
        described = [rows for head, rows in tables if head[:4] == ["key", "type", "default", "meaning"]]
        for path, rows in zip(HEADINGS.get(heading, ()), described, strict=heading in HEADINGS):
            yield from ((f"{path}.{key}", values, default, meaning) for key, values, default, meaning in rows)


def _list_codes() -> Iterator[tuple[str, str, str, str]]:
    tables = next(tables for heading, tables in _list_sections("reference/files.md") if heading == "Problems")
    yield from ((code, "", "", meaning) for code, meaning in tables[0][1])


def _list_checks() -> Iterator[tuple[str, str, str, str]]:
    found: dict[str, list[str]] = {}
    for name, text in _list_check_rows():
        found.setdefault(f"check.{name}", []).append(text)
    yield from ((name, "", "", "; ".join(texts)) for name, texts in found.items())


def _list_check_rows() -> Iterator[tuple[str, str]]:
    tables = next(
        tables for heading, tables in _list_sections("concepts/doctor.md") if heading == "The checks"
    )
    for names, warns, fails in tables[0][1]:
        where = re.search(r"\((.*)\)", names)
        parts = [
            where[1] if where else "",
            f"warns: {warns}" if warns else "",
            f"fails: {fails}" if fails else "",
        ]
        for name in names.partition("(")[0].split(","):
            yield name.strip().replace(" ", "-"), "; ".join(part for part in parts if part)


def _list_sections(page: str) -> Iterator[tuple[str, list[tuple[list[str], list[list[str]]]]]]:
    """Each heading with its tables: the heads and the rows, as plain text."""
    for section in re.split(r"^##+ ", (DOCS / page).read_text(), flags=re.MULTILINE)[1:]:
        heading, _, text = section.partition("\n")
        yield (
            heading,
            [
                (_split_row(found[1]), [_split_row(line.strip()) for line in found[2].splitlines()])
                for found in _TABLE.finditer(text)
            ],
        )


def _split_row(line: str) -> list[str]:
    cells = re.split(r"(?<!\\)\|", line.removeprefix("|").removesuffix("|"))
    return [_LINK.sub(r"\1", cell.strip()).replace("`", "").replace("\\|", "|") for cell in cells]


if __name__ == "__main__":
    TARGET.write_text(build_key_reference())
