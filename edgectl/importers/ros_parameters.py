"""Values of ROS parameters in launch files and YAML, with the types that ROS would give them."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace

from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems, Source
from edgectl.config.yaml_parser import parse_yaml, resolve_scalar
from edgectl.importers.expression import ExpressionError, evaluate_expression
from edgectl.importers.fault import ImportFaultError
from edgectl.importers.ros1_substitution import infer_value

# Words that the YAML 1.1 of ROS reads as truth values, besides those of YAML 1.2.
_TRUE, _FALSE = {"yes", "on"}, {"no", "off"}
_ANGLE = re.compile(r"(deg|rad)\(([^()]*)\)")
_TYPES = ("auto", "bool", "boolean", "double", "float", "int", "str", "string", "yaml")


def parse_parameter_value(text: str, kind: str, mark: Mark) -> object:
    """The value of ``<param value= type=>`` of ROS 1; ``kind`` is empty where the file states no type.

    Raises:
        ImportFaultError: the type is unknown, or the text is not of it.
    """
    kind = kind or "auto"
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
    """The value of a node as ROS reads it: ``on`` is true, ``deg(90)`` are radians."""
    if isinstance(node.value, dict):
        return {key: read_parameter_node(inner) for key, inner in node.value.items()}
    if isinstance(node.value, list):
        return [read_parameter_node(inner) for inner in node.value]
    if not isinstance(node.value, str) or _is_quoted(node):
        return node.value
    return _read_plain_text(node.value)


def parse_yaml_scalar(text: str) -> object:
    """The value of a plain text by YAML as ROS reads it."""
    value = resolve_scalar(text.strip())
    return _read_plain_text(value) if isinstance(value, str) else value


def _read_plain_text(text: str) -> object:
    if text.lower() in _TRUE | _FALSE:
        return text.lower() in _TRUE
    if found := _ANGLE.fullmatch(text):
        try:
            angle = float(evaluate_expression(found[2], {}, {}))
        except (ExpressionError, TypeError, ValueError):
            return text
        return math.radians(angle) if found[1] == "deg" else angle
    return text


def _is_quoted(node: Node) -> bool:
    line = node.mark.source.line(node.mark.line)
    return line[node.mark.column - 1 : node.mark.column] in ("'", '"', "|", ">")


def flatten_parameters(value: object, prefix: str = "", separator: str = "/") -> dict[str, object]:
    """Each value by its full name; lists and texts are values."""
    if not isinstance(value, Mapping):
        return {prefix: value} if prefix else {}
    flat: dict[str, object] = {}
    for key, inner in value.items():
        flat |= flatten_parameters(inner, f"{prefix}{separator}{key}" if prefix else str(key), separator)
    return flat
