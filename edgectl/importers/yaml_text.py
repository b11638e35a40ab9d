# SPDX-License-Identifier: Apache-2.0
"""Text of inventory and task files with comments, for people to read and edit."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from edgectl.config.yaml_parser import resolve_scalar

# Plain in any place of a block mapping; texts that contain ": " or " #" are not.
_PLAIN = re.compile(r"[A-Za-z0-9_/.][\w ./:=~@%+$()<>;&|*?!^'\"{}\[\],-]*")
_PLAIN_IN_FLOW = re.compile(r"[A-Za-z0-9_/.][\w ./=~@%+$()-]*(?::[\w./=~@%+$()-]+)*")
_TRUTH_WORDS = {"yes", "no", "on", "off", "y", "n"}


@dataclass(frozen=True, slots=True, kw_only=True)
class FileEntry:
    """One host or task: its keys, and the lines of comment above it."""

    name: str
    values: Mapping[str, object]
    comments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class FileText:
    """A file: comments at its top, keys in front, and sections of entries."""

    comments: tuple[str, ...]
    keys: Mapping[str, object] = field(default_factory=dict)
    sections: Mapping[str, Sequence[FileEntry]] = field(default_factory=dict)


def render_file(file: FileText) -> str:
    """The text of the file. Sections without entries are left out."""
    lines = [f"# {_to_comment(line)}" for line in file.comments]
    lines += [f"{key}: {_render_value(value)}" for key, value in file.keys.items()]
    for section, entries in file.sections.items():
        if entries:
            lines.append(f"{section}:")
        for entry in entries:
            lines += [f"  # {_to_comment(line)}" for line in entry.comments]
            lines += _render_entry(entry, section)
    return "\n".join(lines) + "\n"


def _render_entry(entry: FileEntry, section: str) -> list[str]:
    if section != "tasks":
        return [f"  {render_scalar(entry.name)}: {_render_flow(entry.values)}"]
    return [
        f"  {render_scalar(entry.name)}:",
        *(f"    {key}: {_render_value(value)}" for key, value in entry.values.items()),
    ]


def _to_comment(text: str) -> str:
    return "".join(char if char.isprintable() else "?" for char in text)


def _render_value(value: object) -> str:
    if isinstance(value, Mapping | list | tuple):
        return _render_flow(value)
    # with both kinds of quotes in it, a text is easiest to read without quotes around it
    text = render_scalar(value)
    return f"|-\n      {value}" if text[0] == "'" and "''" in text[1:-1] else text


def _render_flow(value: object) -> str:
    if isinstance(value, Mapping):
        inner = (f"{render_scalar(str(key), flow=True)}: {_render_flow(each)}" for key, each in value.items())
        return "{" + ", ".join(inner) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_render_flow(each) for each in value) + "]"
    return render_scalar(value, flow=True)


def render_scalar(value: object, *, flow: bool = False) -> str:
    """A scalar as YAML: plain if it means the same so, else in quotes."""
    if not isinstance(value, str):
        return json.dumps(value)
    if _is_plain(value, flow=flow):
        return value
    if value.isprintable():
        return "'" + value.replace("'", "''") + "'"
    return "".join(_escape(char) for char in json.dumps(value, ensure_ascii=False))


def _escape(char: str) -> str:
    if char.isprintable():
        return char
    return f"\\u{ord(char):04x}" if ord(char) < 0x10000 else f"\\U{ord(char):08x}"


def _is_plain(text: str, *, flow: bool) -> bool:
    pattern = _PLAIN_IN_FLOW if flow else _PLAIN
    if not text.isascii() or not pattern.fullmatch(text) or text.lower() in _TRUTH_WORDS:
        return False
    ends_well = not text.endswith((" ", ":")) and ": " not in text and " #" not in text
    return ends_well and isinstance(resolve_scalar(text), str)
