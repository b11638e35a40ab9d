# SPDX-License-Identifier: Apache-2.0
"""Project file ``edgectl.yaml`` and the user's ``config.yaml``: inventories, tasks, contexts and defaults of
options (ADR 139).
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import field
from enum import StrEnum
from pathlib import Path
from typing import Any

from edgectl.config.fields import Fields, keep_node, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems
from edgectl.config.scalars import (
    INVALID,
    NAME_PATTERN,
    NodeReader,
    check_name,
    enum_reader,
    integer_reader,
    read_bool,
    read_duration,
    read_name,
    read_text,
    read_version,
    report_wrong_type,
)
from edgectl.config.schema import (
    Schema,
    build_file_schema,
    build_mapping_schema,
    build_object_schema,
    describe_as,
    get_reader_schema,
)
from edgectl.config.source import read_source
from edgectl.config.yaml_parser import parse_yaml
from edgectl.dataclass import dataclass
from edgectl.names import format_name_list, suggest_name

# An optional file of a bounded size: it names others.
_MAX_BYTES = 2**16


class DefaultOutput(StrEnum):
    """The forms of output that may be the default of ``-o``; a command that has not got it keeps its own."""

    TABLE = "table"
    WIDE = "wide"
    JSON = "json"
    JSONL = "jsonl"
    YAML = "yaml"
    CSV = "csv"
    NAME = "name"


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedPath:
    """A path that a settings file names, and where; relative paths are relative to the file's folder."""

    path: Path
    mark: Mark


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """A fleet that a settings file gives a name to."""

    name: str
    inventory: tuple[NamedPath, ...]
    tasks: tuple[NamedPath, ...]
    mark: Mark


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingsFile:
    """One settings file as read.

    ``defaults``: values of options by the name of their parameter, as text of the command line or as a value.
    ``marks``: where each key and each default (``defaults.NAME``) stands.
    """

    path: Path
    inventory: tuple[NamedPath, ...] = ()
    tasks: tuple[NamedPath, ...] = ()
    context: str | None = None
    contexts: Mapping[str, Context] = field(default_factory=dict)
    defaults: Mapping[str, str | int | bool] = field(default_factory=dict)
    safe_directories: tuple[Path, ...] = ()
    marks: Mapping[str, Mark] = field(default_factory=dict)


@describe_as(lambda: get_reader_schema(read_name))
def _read_context_name(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The name of one of ``contexts``."""
    if isinstance(node.value, dict | list):
        hint = "write context: NAME, and contexts: {NAME: {inventory: inventories/lab.yaml}}"
        return report_wrong_type(node, problems, "context is the name of one of contexts", hint)
    return read_name(node, problems)


@describe_as(
    lambda: {
        "anyOf": [
            get_reader_schema(read_text),
            {"type": "array", "items": get_reader_schema(read_text), "minItems": 1},
        ]
    }
)
def _read_paths(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """One path, or a list of them: the nodes of the valid ones."""
    if isinstance(node.value, dict):
        return report_wrong_type(
            node, problems, "must be a path or a list of paths", "write FILE, or [FILE, FILE]"
        )
    listed = node.value if isinstance(node.value, list) else [node]
    if not listed:
        return report_wrong_type(node, problems, "must name a file", "write a path, or remove the key")
    return tuple(inner for inner in listed if read_text(inner, problems) is not INVALID)


DEFAULTS_KEYS: Mapping[str, NodeReader] = {
    "output": enum_reader(DefaultOutput),
    "every": read_duration,
    "window": read_duration,
    "timeout": read_duration,
    "lock_timeout": read_duration,
    "tail": integer_reader(0, 10**9),
    "max_parallel": integer_reader(1, 10**6),
    "fail_fast": read_bool,
    "allow_unreachable": read_bool,
}
CONTEXT_KEYS: Mapping[str, NodeReader] = {"inventory": _read_paths, "tasks": _read_paths}
PROJECT_KEYS: Mapping[str, NodeReader] = {
    "version": read_version,
    **CONTEXT_KEYS,
    "context": _read_context_name,
    "contexts": keep_node,
    "defaults": keep_node,
}
# Trust in folders is the user's to state: a folder cannot vouch for itself.
USER_KEYS: Mapping[str, NodeReader] = {**PROJECT_KEYS, "safe_directories": _read_paths}


def build_project_schema() -> Schema:
    """JSON Schema of a project file."""
    return _build_settings_schema("project file", PROJECT_KEYS)


def build_user_schema() -> Schema:
    """JSON Schema of the user's configuration."""
    return _build_settings_schema("user configuration", USER_KEYS)


def _build_settings_schema(title: str, keys: Mapping[str, NodeReader]) -> Schema:
    contexts = build_mapping_schema(NAME_PATTERN.pattern, build_object_schema(CONTEXT_KEYS, ("inventory",)))
    defaults = build_object_schema(DEFAULTS_KEYS)
    return build_file_schema(
        title, build_object_schema(keys, ("version",), contexts=contexts, defaults=defaults)
    )


def load_settings_file(path: Path, *, of_user: bool = False) -> SettingsFile:
    """The settings of a project file, or with ``of_user`` of the user's configuration.

    Raises:
        InputError: everything that is wrong with it.
    """
    problems = Problems()
    source = read_source(path, problems, max_bytes=_MAX_BYTES, maker="")
    node = parse_yaml(source, problems) if source is not None else None
    found = None if node is None else _read_settings(node, path, problems, of_user=of_user)
    problems.check()
    return found or SettingsFile(path=path)


def _read_settings(node: Node, path: Path, problems: Problems, *, of_user: bool) -> SettingsFile:
    what = "the user's configuration" if of_user else "a project file"
    keys = USER_KEYS if of_user else PROJECT_KEYS
    top = read_fields(node, problems, keys, required=("version",), what=what)
    defaults = (
        read_fields(top.at("defaults"), problems, DEFAULTS_KEYS, what="defaults")
        if "defaults" in top
        else Fields(node, {})
    )
    marks = {key: top.node.key_mark(key) for key in top.values}
    marks |= {f"defaults.{key}": defaults.node.key_mark(key) for key in defaults.values}
    if "context" in top.values:
        marks["context"] = top.at("context").mark
    return SettingsFile(
        path=path,
        inventory=_name_paths(top, "inventory", path.parent),
        tasks=_name_paths(top, "tasks", path.parent),
        context=top.values.get("context"),
        contexts=_read_contexts(top.at("contexts"), path.parent, problems) if "contexts" in top else {},
        defaults={key: _to_option_value(value) for key, value in defaults.values.items()},
        safe_directories=tuple(each.path for each in _name_paths(top, "safe_directories", path.parent)),
        marks=marks,
    )


def _read_contexts(node: Node, folder: Path, problems: Problems) -> dict[str, Context]:
    if not isinstance(node.value, dict):
        hint = "write NAME: {inventory: inventories/lab.yaml} on a line of its own"
        report_wrong_type(node, problems, "contexts must be a mapping of names", hint)
        return {}
    found = {}
    for name, inner in node.value.items():
        check_name(name, node, problems, "a context")
        fields = read_fields(inner, problems, CONTEXT_KEYS, required=("inventory",), what=f"context {name}")
        found[name] = Context(
            name=name,
            inventory=_name_paths(fields, "inventory", folder),
            tasks=_name_paths(fields, "tasks", folder),
            mark=node.key_mark(name),
        )
    return found


def _name_paths(fields: Fields, key: str, folder: Path) -> tuple[NamedPath, ...]:
    return tuple(
        NamedPath(path=folder / os.path.expanduser(inner.value), mark=inner.mark)  # noqa: PTH111
        for inner in fields.values.get(key, ())
    )


def _to_option_value(value: object) -> str | int | bool:
    """The value as the command line has it; a time is text with its unit."""
    return value if isinstance(value, str | int) else f"{value:g}s"


def check_settings_files(files: Iterable[SettingsFile]) -> None:
    """Check every path that the settings files name, chosen or not.

    Raises:
        InputError: some do not exist.
    """
    problems = Problems()
    for file in files:
        check_named_paths(file.inventory, "inventory", problems)
        check_named_paths(file.tasks, "tasks", problems)
        for context in file.contexts.values():
            check_named_paths(context.inventory, f"inventory of context {context.name}", problems)
            check_named_paths(context.tasks, f"tasks of context {context.name}", problems)
    problems.check()


def check_named_paths(named: Iterable[NamedPath], what: str, problems: Problems) -> None:
    """Note the files and directories that do not exist."""
    for each in named:
        if not each.path.exists():
            message = f"{what}: no such file: {each.path}"
            problems.add(each.mark, ProblemCode.UNREADABLE, message, _suggest_path(each.path))


def _suggest_path(path: Path) -> str:
    known = {entry.stem: entry.name for entry in path.parent.iterdir()} if path.parent.is_dir() else {}
    match = suggest_name(path.stem, known)  # the ending that all have in common is no likeness
    if match:
        return f"did you mean {known[match]}?"
    if known:
        return f"{path.parent} holds {format_name_list(sorted(known.values()))}"
    return "correct the path; it is relative to the folder of this file"
