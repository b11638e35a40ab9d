# SPDX-License-Identifier: Apache-2.0
"""Readers of scalars. A reader takes a node, reports its problems, and returns its value or ``INVALID``."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from typing import Any, Final

from edgectl.agent.link import protocol
from edgectl.config.node import Node, describe_node_type
from edgectl.config.problems import Mark, ProblemCode, Problems
from edgectl.config.quantities import suggest_quantity
from edgectl.config.schema import describe_as, describe_reader, get_reader_schema, limit_quantity_schema
from edgectl.units import QuantityError, parse_duration

INVALID: Final = object()
NodeReader = Callable[[Node, Problems], Any]
FILE_VERSION = 1
MAX_NAME_LENGTH = protocol.MAX_NAME_LENGTH
NAME_PATTERN = re.compile(protocol.NAME_PATTERN)


@describe_as(lambda: {"const": FILE_VERSION})
def read_version(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    """The format version of a file, which must be 1."""
    if node.value == FILE_VERSION and not isinstance(node.value, bool):
        return FILE_VERSION
    problems.add(
        node.mark,
        ProblemCode.VERSION,
        f"version {node.text or '?'} is not known to this edgectl",
        f"write version: {FILE_VERSION}",
    )
    return INVALID


def report_wrong_type(node: Node, problems: Problems, message: str, hint: str = "") -> Any:  # noqa: ANN401 - INVALID stands for any type
    """Note that a value has the wrong type."""
    problems.add(
        node.mark,
        ProblemCode.TYPE,
        f"{message}, not {describe_node_type(node)}"
        if node.value is not None
        else f"{message}, but is empty",
        hint,
    )
    return INVALID


@describe_as(lambda: {"type": "string", "pattern": r"^[^\0]*[^\s\0][^\0]*$"})
def read_text(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A string that is not empty and has no NUL."""
    if not isinstance(node.value, str):
        scalar = not isinstance(node.value, dict | list) and node.value is not None
        hint = f"put it in quotes: {json.dumps(node.text)}" if scalar else _suggest_quotes(node)
        return report_wrong_type(node, problems, "must be a string", hint)
    if not node.value.strip():
        problems.add(node.mark, ProblemCode.TEXT, "must not be empty", "write a value, or remove the key")
        return INVALID
    return _reject_nul(node, problems)


@describe_as(lambda: {"type": "string", "pattern": r"^$|^[^\0]*[^\s\0][^\0]*$"})
def read_text_or_empty(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A string, possibly empty, without NUL."""
    return _reject_nul(node, problems) if node.value == "" else read_text(node, problems)


def _reject_nul(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if "\0" in str(node.value):
        problems.add(
            node.mark, ProblemCode.TEXT, "must not contain a NUL character", "remove \\0 or \\x00 from it"
        )
        return INVALID
    return node.value


def _suggest_quotes(node: Node) -> str:
    rest = node.mark.source.line(node.mark.line)[node.mark.column - 1 :].strip()
    starts_here = isinstance(node.value, dict | list) and rest[:1] in ("{", "[")
    return (
        "put it in quotes: '" + _cut_after_bracket(rest).replace("'", "''") + "'"
        if starts_here
        else "write a value, or remove the key"
    )


def _cut_after_bracket(rest: str) -> str:
    """``rest`` up to the bracket that closes its first one; all of it where that stands on another line."""
    depth, quote = 0, ""
    for index, char in enumerate(rest):
        if quote or char in "'\"":
            quote = ("" if char == quote else quote) if quote else char
            continue
        depth += (char in "[{") - (char in "]}")
        if depth == 0:
            return rest[: index + 1]
    return rest


@describe_as(lambda: {"type": "string", "pattern": r"^[^-\s\0][^\s\0]*$"})
def read_safe_argument(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """Text that may not begin with a dash: it could be taken for an option of a program."""
    value = read_text(node, problems)
    if isinstance(value, str) and (
        value.startswith("-") or any(char.isspace() or not char.isprintable() for char in value)
    ):
        what = "begin with -" if value.startswith("-") else "contain blanks"
        problems.add(
            node.mark,
            ProblemCode.TEXT,
            f"may not {what}: {value!r}",
            "write a name or an address, such as 192.168.1.20",
        )
        return INVALID
    return value


def address_reader(more: str = "") -> NodeReader:
    """An address, a host or a user: letters, digits and ``. _ - : % @ [ ]``, and the characters of ``more``.

    It reaches shells: as ``{robot_host}``, and as a token of ProxyCommand in ssh_config.
    """
    known = f"._:%@[]{more}-"
    alphabet = re.compile(rf"[A-Za-z0-9{re.escape(known)}]")

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        value = read_safe_argument(node, problems)
        wrong = (
            next((place for place, char in enumerate(value) if not alphabet.fullmatch(char)), None)
            if isinstance(value, str)
            else None
        )
        if wrong is None:
            return value
        problems.add(
            _mark_character(node, value, wrong),
            ProblemCode.TEXT,
            f"may not contain {value[wrong]}",
            f"use letters, digits and {' '.join(known)}",
        )
        return INVALID

    return describe_reader(
        read,
        lambda: {"type": "string", "pattern": rf"^(?!-)[A-Za-z0-9{re.escape(known)}]+$"},
    )


def _mark_character(node: Node, value: str, place: int) -> Mark:
    """The position of one character of a text; of the whole text where it is written with escapes."""
    mark = node.mark
    start = mark.source.line(mark.line).find(value, mark.column - 1)
    return mark if start < 0 else replace(mark, column=start + place + 1, length=1)


@describe_as(lambda: {"type": "string", "pattern": r"\S"})
def read_name(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A name of a host or task (a reference to one)."""
    return read_text(node, problems)


def check_name(key: str, node: Node, problems: Problems, what: str) -> None:
    """Note a key that is no valid name.

    What it names is read all the same, so that its other mistakes are shown too.
    """
    if NAME_PATTERN.fullmatch(key):
        return
    wished = re.sub(r"[^a-z0-9._-]+", "-", key.lower()).strip("-._")[:63]
    hint = (
        f"write {wished}"
        if NAME_PATTERN.fullmatch(wished)
        else "use 1 to 63 of a-z 0-9 . _ -, beginning with a letter or digit"
    )
    problems.add(node.key_mark(key), ProblemCode.NAME, f"{key!r} cannot be the name of {what}", hint)


@describe_as(lambda: {"type": "boolean"})
def read_bool(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """True or false."""
    if isinstance(node.value, bool):
        return node.value
    meant = {"yes": "true", "on": "true", "no": "false", "off": "false"}.get(
        node.text.lower(), "true or false"
    )
    return report_wrong_type(node, problems, "must be true or false", f"write {meant}")


def enum_reader(words: type[StrEnum], *more: str) -> NodeReader:
    """One of the words of an enum, or one of ``more`` (given back as it is)."""
    known = [*(entry.value for entry in words), *more]

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if isinstance(node.value, str) and node.value in known:
            return node.value if node.value in more else words(node.value)
        if not isinstance(node.value, str):
            return report_wrong_type(node, problems, "must be a word", "write one of " + ", ".join(known))
        problems.add(
            node.mark,
            ProblemCode.WORD,
            f"unknown word {node.value!r}",
            problems.did_you_mean(node.value, known, "write one of"),
        )
        return INVALID

    return describe_reader(read, lambda: {"enum": known})


def integer_reader(low: int, high: int) -> NodeReader:
    """A whole number from ``low`` to ``high``."""

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if isinstance(node.value, bool) or not isinstance(node.value, int):
            digits = isinstance(node.value, str) and node.value.isdecimal()
            return report_wrong_type(
                node,
                problems,
                "must be a whole number",
                f"write {int(node.text)} without quotes"
                if digits
                else f"write a number from {low} to {high}",
            )
        if not low <= node.value <= high:
            problems.add(
                node.mark,
                ProblemCode.QUANTITY,
                f"must be {low} to {high}, not {node.text}",
                f"write a number from {low} to {high}",
            )
            return INVALID
        return node.value

    return describe_reader(read, lambda: {"type": "integer", "minimum": low, "maximum": high})


def quantity_reader(
    parse: Callable[[object], Any], *, above_zero: bool = False, at_most: float | None = None
) -> NodeReader:
    """A quantity by one of the parsers of ``edgectl.units``."""

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if isinstance(node.value, dict | list) or node.value is None:
            return report_wrong_type(
                node, problems, "must be a quantity", "write a number, or one with a unit"
            )
        try:
            value = parse(node.value)
        except QuantityError as error:
            hint = suggest_quantity(node.value, parse) or error.hint
            problems.add(node.mark, ProblemCode.QUANTITY, error.message, hint)
            return INVALID
        if (above_zero and value <= 0) or (at_most is not None and value > at_most):
            limit = "above 0" if value <= 0 else f"{at_most:g} or less"
            problems.add(
                node.mark,
                ProblemCode.QUANTITY,
                f"must be {limit}, not {node.text}",
                f"write a quantity {limit}",
            )
            return INVALID
        return value

    return describe_reader(
        read, lambda: limit_quantity_schema(get_reader_schema(parse), above_zero=above_zero, at_most=at_most)
    )


# A time above zero.
read_duration = quantity_reader(parse_duration, above_zero=True)
