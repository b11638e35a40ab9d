# SPDX-License-Identifier: Apache-2.0
"""Mappings and lists out of nodes. Tables of readers describe the mappings; other keys are errors."""

import re
import shlex
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from edgectl.config.node import Node, redact_node
from edgectl.config.problems import Mark, ProblemCode, Problems
from edgectl.config.scalars import (
    FILE_VERSION,
    INVALID,
    NodeReader,
    read_bool,
    read_text,
    read_text_or_empty,
    read_version,
    report_wrong_type,
)
from edgectl.config.schema import (
    Schema,
    build_mapping_schema,
    build_object_schema,
    describe_as,
    describe_reader,
    get_reader_schema,
)
from edgectl.dataclass import dataclass
from edgectl.model.secret import Secret

ENV_NAME_PATTERN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_LABEL_KEY_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._/-]{0,62}")
_SECRET_NAME_PATTERN = re.compile(
    r"(?:PASSWORD|PASSWD|PASSPHRASE|(?:^|_)(?:PASS|PWD|SECRET|TOKEN|API_?KEY|SECRET_?KEY|PRIVATE_?KEY|ACCESS_?KEY|CREDENTIALS?))$"
)
_PASSWORD_KEYS = (
    "password",
    "passwd",
    "pass",
    "passphrase",
    "ssh_pass",
    "ssh_password",
    "sudo_password",
    "ansible_password",
    "ansible_ssh_pass",
)


@dataclass(frozen=True, slots=True)
class Fields:
    """A mapping that was read: the valid values by key, and the node for the places."""

    node: Node
    values: dict[str, Any]

    def __contains__(self, key: str) -> bool:
        return isinstance(self.node.value, dict) and key in self.node.value

    def at(self, key: str) -> Node:
        """The node under ``key``, or the mapping itself."""
        inner = self.node.value.get(key) if isinstance(self.node.value, dict) else None
        return inner or self.node


def read_fields(
    node: Node,
    problems: Problems,
    table: Mapping[str, NodeReader],
    *,
    required: Iterable[str] = (),
    what: str,
) -> Fields:
    """The values of a mapping's known keys; unknown, missing and wrong ones are noted."""
    if not isinstance(node.value, dict):
        report_wrong_type(
            node,
            problems,
            f"{what} must be a mapping",
            f"write keys such as {next(iter(table))}: .. on lines of their own",
        )
        return Fields(node, {})
    values = {}
    for key, inner in node.value.items():
        read = table.get(key)
        if read is None:
            _report_unknown_key(node, key, problems, table, what)
            continue
        value = read(inner, problems)
        if value is not INVALID:
            values[key] = value
    for key in required:
        if key not in node.value:
            value = FILE_VERSION if table.get(key) is read_version else ".."
            problems.add(node.mark, ProblemCode.MISSING, f"{what} needs {key}", f"add {key}: {value}")
    return Fields(node, values)


def merge_keys(files: Iterable[Fields], keys: Iterable[str], problems: Problems) -> dict[str, Any]:
    """What several files state together under ``keys``; two different statements are a mistake."""
    stated: dict[str, Any] = {}
    places: dict[str, Mark] = {}
    for key, fields in ((key, fields) for fields in files for key in keys if key in fields.values):
        place = fields.node.key_mark(key)
        if stated.setdefault(key, fields.values[key]) != fields.values[key]:
            problems.add(
                place,
                ProblemCode.TAKEN,
                f"{key} is stated differently in {places[key].source.file}, line {places[key].line}",
                f"keep {key} in one file, or write the same in both",
            )
        places.setdefault(key, place)
    return stated


def _report_unknown_key(
    node: Node, key: str, problems: Problems, table: Mapping[str, NodeReader], what: str
) -> None:
    if key.lower() in _PASSWORD_KEYS:
        hint = 'use a key or the agent, or: password_command: ["pass", "show", "lab/edge1"]'
        problems.add(
            node.key_mark(key), ProblemCode.PASSWORD, "plaintext passwords are not allowed in files", hint
        )
    else:
        problems.add(
            node.key_mark(key),
            ProblemCode.UNKNOWN_KEY,
            f"unknown key {key} in {what}",
            problems.did_you_mean(key, table, "known keys:"),
        )


def record_reader(
    table: Mapping[str, NodeReader], build: Callable[..., Any], what: str, required: tuple[str, ...] = ()
) -> NodeReader:
    """A mapping with the keys of a table, built into a value; the table may be completed after this call."""

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        fields = read_fields(node, problems, table, required=required, what=what)
        complete = isinstance(node.value, dict) and all(key in fields.values for key in required)
        return build(**fields.values) if complete else INVALID

    return describe_reader(read, lambda: build_object_schema(table, required))


def keep_node(node: Node, _: Problems) -> Node:
    """The node itself, to be read later."""
    return node


def list_reader_with_nodes(read: NodeReader) -> NodeReader:
    """A list whose entries are read by ``read``; given back as a tuple of the valid ones with their nodes."""

    def read_list(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if not isinstance(node.value, list):
            hint = f"write [{node.text}]" if node.text else "write [..]"
            return report_wrong_type(node, problems, "must be a list", hint)
        values = ((read(inner, problems), inner) for inner in node.value)
        return tuple((value, inner) for value, inner in values if value is not INVALID)

    return describe_reader(read_list, lambda: {"type": "array", "items": get_reader_schema(read)})


def list_reader(read: NodeReader) -> NodeReader:
    """``items`` without the nodes."""
    listed = list_reader_with_nodes(read)

    def read_list(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        values = listed(node, problems)
        return values if values is INVALID else tuple(value for value, _ in values)

    return describe_reader(read_list, lambda: get_reader_schema(listed))


def mapping_reader(key_form: re.Pattern[str], what: str, read: NodeReader = read_text_or_empty) -> NodeReader:
    """A mapping of free keys of a form to values."""

    def read_mapping(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if not isinstance(node.value, dict):
            return report_wrong_type(node, problems, "must be a mapping", "write {NAME: value}")
        result = {}
        for key, inner in node.value.items():
            if not key_form.fullmatch(key):
                wished = re.sub(r"[^A-Za-z0-9_]", "_", key)
                hint = f"write {wished}" if key_form.fullmatch(wished) else "use letters, digits and _"
                problems.add(
                    node.key_mark(key), ProblemCode.NAME, f"{key!r} cannot be the name of {what}", hint
                )
            value = read(inner, problems)
            if value is not INVALID:
                result[key] = value
        return result

    return describe_reader(
        read_mapping, lambda: build_mapping_schema(key_form.pattern, get_reader_schema(read))
    )


def _describe_variable() -> Schema:
    return {
        "anyOf": [
            get_reader_schema(read_text_or_empty),
            build_object_schema(SECRET_KEYS, ("value", "secret")),
        ]
    }


@describe_as(_describe_variable)
def _read_variable(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A text, or ``{value: .., secret: true}``. A line on which a secret may stand is never shown."""
    if not isinstance(node.value, dict):
        return read_text_or_empty(node, problems)
    if not node.value.keys() <= SECRET_KEYS.keys():
        problems.add(
            node.mark.redact(),
            ProblemCode.UNKNOWN_KEY,
            "unknown key in an environment variable",
            "known keys: value, secret",
        )
        return INVALID
    fields = read_fields(
        redact_node(node), problems, SECRET_KEYS, required=("value", "secret"), what="an environment variable"
    )
    value, secret = fields.values.get("value", INVALID), fields.values.get("secret", INVALID)
    if INVALID in (value, secret):
        return INVALID
    return Secret(value) if secret else value


@describe_as(lambda: {"type": "string"})
def _read_secret_text(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if isinstance(node.value, str) and "\0" not in node.value:
        return node.value
    problems.add(node.mark, ProblemCode.TYPE, "must be a string without NUL", "put it in quotes")
    return INVALID


SECRET_KEYS: Mapping[str, NodeReader] = {"value": _read_secret_text, "secret": read_bool}
_read_variables = mapping_reader(ENV_NAME_PATTERN, "an environment variable", _read_variable)


@describe_as(lambda: get_reader_schema(_read_variables))
def read_environment(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """Variables by name. Plain text is refused where the name means a password; nothing of it is shown."""
    if not isinstance(node.value, dict):
        return _read_variables(node, problems)
    clear = [
        name
        for name, inner in node.value.items()
        if _SECRET_NAME_PATTERN.search(name.upper()) and _is_plaintext(inner)
    ]
    for name in clear:
        hint = (
            f"use env_command, or mark it: {name}: {{value: .., secret: true}} (secret: false if it is none)"
        )
        problems.add(
            node.key_mark(name).redact(),
            ProblemCode.PASSWORD,
            f"{name} looks like a secret in plain text",
            hint,
        )
    others = {name: inner for name, inner in node.value.items() if name not in clear}
    return _read_variables(Node(others, node.mark, keys=node.keys), problems)


def _is_plaintext(node: Node) -> bool:
    return not isinstance(node.value, dict) and node.value not in (None, "")


read_labels = mapping_reader(_LABEL_KEY_PATTERN, "a label", read_text)


@describe_as(lambda: {"type": "array", "items": get_reader_schema(read_text), "minItems": 1})
def read_argument_vector(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A program and its arguments, as a list: no shell reads it."""
    if isinstance(node.value, str) and node.value.strip():
        try:
            hint = "write " + str(shlex.split(node.value)).replace("'", '"')
        except ValueError:
            hint = 'write ["program", "argument"]'
        return report_wrong_type(node, problems, "must be a list of arguments", hint)
    arguments = list_reader(read_text)(node, problems)
    if arguments == ():
        problems.add(
            node.mark,
            ProblemCode.TEXT,
            "must name a program",
            'write ["program", "argument"], or remove the key',
        )
        return INVALID
    return arguments
