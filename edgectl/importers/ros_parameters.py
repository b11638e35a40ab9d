# SPDX-License-Identifier: Apache-2.0
"""Values of ROS parameters in launch files and YAML, with the types that ROS would give them."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.config.yaml_parser import parse_yaml, resolve_scalar
from edgectl.importers.expression import ExpressionError, evaluate_expression
from edgectl.importers.fault import ImportFaultError
from edgectl.importers.ros1_substitution import infer_value

# Plain scalars of YAML 1.1, as PyYAML reads them for ROS; times in base 60 are left as texts.
_INTEGER = re.compile(r"[-+]?(?:0b[0-1_]+|0[0-7_]+|0|[1-9][0-9_]*|0x[0-9a-fA-F_]+)")
_FLOAT = re.compile(r"[-+]?[0-9][0-9_]*\.[0-9_]*(?:[eE][-+][0-9]+)?|\.[0-9][0-9_]*(?:[eE][-+][0-9]+)?")
_OCTAL = re.compile(r"[-+]?0[0-7]+")
_KEYWORDS: dict[str, bool | None] = {
    "": None,
    "~": None,
    **dict.fromkeys(("null", "Null", "NULL")),
    **{form: True for word in ("yes", "true", "on") for form in (word, word.title(), word.upper())},
    **{form: False for word in ("no", "false", "off") for form in (word, word.title(), word.upper())},
}
_ANGLE = re.compile(r"(deg|rad)\(([^()]*)\)")
_TYPES = ("auto", "bool", "boolean", "double", "float", "int", "str", "string", "yaml")


def parse_parameter_value(text: str, kind: str, mark: Mark) -> object:
    """The value of ``<param value= type=>`` of ROS 1; ``kind`` is empty where the file states no type.

    Raises:
        ImportFaultError: the type is unknown, or the text is not of it.
    """
    kind = kind.lower() or "auto"
    if kind not in _TYPES:
        message = f"unknown type {kind}"
        raise ImportFaultError(mark, ProblemCode.WORD, message, f"write one of {', '.join(_TYPES)}")
    try:
        return _convert(text, kind, mark)
    except ValueError as error:
        message = f"{text!r} is not of type {kind}"
        raise ImportFaultError(mark, ProblemCode.TYPE, message, "correct the value or its type") from error


def _convert(text: str, kind: str, mark: Mark) -> object:
    if kind in ("str", "string"):
        return text
    if kind == "int":
        return int(text)
    if kind in ("double", "float"):
        return float(text)
    if kind in ("bool", "boolean"):
        if text.strip().lower() not in ("true", "1", "false", "0"):
            raise ValueError(text)
        return text.strip().lower() in ("true", "1")
    if kind == "yaml":
        problems = Problems()
        value = read_parameter_text(
            text, 1, Source(file=mark.source.file, text=text, lines=()), problems, mark, is_named=True
        )
        if problems.errors:
            raise ValueError(text)
        return value
    return infer_value(text)


def read_parameter_text(
    text: str, line: int, source: Source, problems: Problems, mark: Mark, *, is_named: bool
) -> object:
    """The value of a YAML text that begins on ``line`` of ``source``; problems are collected.

    ``is_named``: a name is stated besides it, so that it need not be a mapping.
    """
    if not text.strip():
        problems.add(mark, ProblemCode.EMPTY, "there are no parameters here", "write NAME: VALUE")
        return {}
    node = parse_yaml(replace(source, text="\n" * (line - 1) + text), problems)
    if node is None:
        return {}
    if not is_named and not isinstance(node.value, dict):
        hint = 'write NAME: VALUE, or state the name: param=".."'
        problems.add(node.mark, ProblemCode.TYPE, "parameters must be a mapping of names", hint)
        return {}
    return read_parameter_node(node)


def read_parameter_node(node: Node) -> object:
    """The value of a node as ROS reads it: by YAML 1.1, and ``deg(90)`` are radians."""
    if isinstance(node.value, dict):
        return {key: read_parameter_node(inner) for key, inner in node.value.items()}
    if isinstance(node.value, list):
        return [read_parameter_node(inner) for inner in node.value]
    return node.value if _is_quoted(node) else parse_yaml_scalar(node.text)


def parse_yaml_scalar(text: str) -> object:
    """The value of a plain text by YAML 1.1: ``on`` is true, ``010`` is 8, ``1e3`` is a text."""
    text = text.strip()
    plain = text.replace("_", "")
    if text in _KEYWORDS:
        return _KEYWORDS[text]
    if _INTEGER.fullmatch(text):
        return int(plain, 8 if _OCTAL.fullmatch(plain) else 0)
    if _FLOAT.fullmatch(text):
        return float(plain)
    return _read_angle(text) if _ANGLE.fullmatch(text) else text


def is_plain_text(text: str) -> bool:
    """Whether it is a text by YAML 1.1, by YAML 1.2 and by the rule of roslaunch."""
    return all(isinstance(read(text), str) for read in (parse_yaml_scalar, resolve_scalar, infer_value))


def _read_angle(text: str) -> object:
    found = _ANGLE.fullmatch(text)
    if found is None:
        return text
    try:
        angle = float(evaluate_expression(found[2], {}, {}))
    except (ExpressionError, TypeError, ValueError):
        return text
    return math.radians(angle) if found[1] == "deg" else angle


def _is_quoted(node: Node) -> bool:
    lines = _split_lines(node.mark.source.text)
    line = lines[node.mark.line - 1] if node.mark.line <= len(lines) else ""
    return line[node.mark.column - 1 : node.mark.column] in ("'", '"', "|", ">")


@lru_cache(maxsize=4)
def _split_lines(text: str) -> tuple[str, ...]:
    """The lines of what was parsed, which may be a part of a file."""
    return tuple(text.splitlines())


def flatten_parameters(value: object, prefix: str = "", separator: str = "/") -> dict[str, object]:
    """Each value by its full name; lists and texts are values."""
    if not isinstance(value, Mapping):
        return {prefix: value} if prefix else {}
    flat: dict[str, object] = {}
    for key, inner in value.items():
        flat |= flatten_parameters(inner, f"{prefix}{separator}{key}" if prefix else str(key), separator)
    return flat
