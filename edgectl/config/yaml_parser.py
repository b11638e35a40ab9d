# SPDX-License-Identifier: Apache-2.0
"""YAML parser: text to nodes with positions; YAML 1.2 core scalars, no merge keys, no tags, with bounds.

Works on the parser's events, so that a bomb is rejected after ``MAX_VALUES`` values before it is expanded.
"""

import re
from collections.abc import Iterator
from typing import Any, TypeAlias

from edgectl.config.node import Node, Scalar
from edgectl.config.problems import Mark, ProblemCode, Problems, Source, mark_from_span
from edgectl.config.yaml_errors import explain_yaml_error
from edgectl.config.yaml_library import EVENT_PARSER, yaml

YamlEvent: TypeAlias = Any  # the stubs do not declare the attributes of the parser's events
MAX_VALUES = 100_000
MAX_DEPTH = 50
_TOO_DEEP = (f"nested more than {MAX_DEPTH} deep", "no file of edgectl needs that; check the brackets")
# What libyaml 0.2.6 says at a thousand brackets, which it counts before it reports the first.
_PARSER_TOO_DEEP = "maximum nesting depth"
_KEYWORDS: dict[str, Scalar] = {
    "": None,
    "~": None,
    "null": None,
    "Null": None,
    "NULL": None,
    "true": True,
    "True": True,
    "TRUE": True,
    "false": False,
    "False": False,
    "FALSE": False,
}
_INT_PATTERN = re.compile(r"[-+]?(?:0|[1-9][0-9]{0,24})")
_PREFIXED_INT_PATTERN = re.compile(r"0o[0-7]{1,20}|0x[0-9a-fA-F]{1,20}")
_FLOAT_PATTERN = re.compile(r"[-+]?(?:\.[0-9]+|(?:0|[1-9][0-9]*)(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_NON_FINITE_PATTERN = re.compile(r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
# Three classes: of one with all of it Python makes a table, in 3 ms.
_FORBIDDEN_CHARACTER = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f]|[\ud800-\udfff]|[\ufffe\uffff]"
)
_NUMERIC_START = frozenset("+-.0123456789")


def parse_yaml(source: Source, problems: Problems, *, merge_keys: bool = False) -> Node | None:
    """The document of a file, or None with the cause collected. Duplicate keys are collected and reading
    continues. ``merge_keys``: files of another tool, in which ``<<`` is a key like others.
    """
    wrong = _FORBIDDEN_CHARACTER.search(source.text)
    if wrong is not None:
        problems.add(
            mark_from_span(source, *wrong.span()),
            ProblemCode.ENCODING,
            f"character {ord(wrong[0]):#04x} is not allowed in a file",
            "remove it",
        )
        return None
    try:
        return _NodeBuilder(source, problems, merge_keys=merge_keys).document()
    except _StopError as stop:
        problems.add(stop.mark, stop.code, str(stop), stop.hint)
    except yaml.YAMLError as error:
        mark, message, hint = explain_yaml_error(source, error)
        if _PARSER_TOO_DEEP in str(error):
            problems.add(mark, ProblemCode.BUDGET, *_TOO_DEEP)
        else:
            problems.add(mark, ProblemCode.SYNTAX, message, hint)
    return None


class _StopError(Exception):
    """The document cannot be read further."""

    def __init__(self, mark: Mark, code: ProblemCode, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.mark, self.code, self.hint = mark, code, hint


class _NodeBuilder:
    """Builds nodes from events. Tracks anchors and the number of values, including those reached through
    aliases.
    """

    def __init__(self, source: Source, problems: Problems, *, merge_keys: bool) -> None:
        self.merge_keys = merge_keys
        self.source = source
        self.problems = problems
        self.events: Iterator[YamlEvent] = yaml.parse(source.text, Loader=EVENT_PARSER)
        self.anchors: dict[str, Node | None] = {}
        self.values = 0

    def document(self) -> Node:
        next(self.events)
        first = next(self.events)
        if isinstance(first, yaml.StreamEndEvent):
            raise _StopError(
                Mark(self.source, 1, 1), ProblemCode.EMPTY, "the file is empty", "begin with: version: 1"
            )
        node = self.node(next(self.events), 1)
        next(self.events)
        after = next(self.events)
        if not isinstance(after, yaml.StreamEndEvent):
            message = "a second document begins here; a file has one"
            raise _StopError(
                self.mark(after), ProblemCode.YAML_FEATURE, message, "remove the --- line, or make two files"
            )
        return node

    def mark(self, event: YamlEvent) -> Mark:
        start, end = event.start_mark, event.end_mark
        length = (
            end.column - start.column
            if end.line == start.line
            else len(self.source.line(start.line + 1)) - start.column
        )
        return Mark(self.source, start.line + 1, start.column + 1, max(1, length))

    def node(self, event: YamlEvent, depth: int) -> Node:
        mark = self.mark(event)
        if isinstance(event, yaml.AliasEvent):
            return self.alias(event, mark)
        if depth > MAX_DEPTH:
            message, hint = _TOO_DEEP
            raise _StopError(mark, ProblemCode.BUDGET, message, hint)
        self.spend(1, mark)
        if event.tag is not None and event.tag != "!":
            message = f"tags such as {event.tag} are not supported"
            raise _StopError(
                mark, ProblemCode.YAML_FEATURE, message, "remove it; if it is text, put the value in quotes"
            )
        if event.anchor is not None:
            self.anchors[event.anchor] = None
        node = self.fresh(event, mark, depth)
        if event.anchor is not None:
            self.anchors[event.anchor] = node
        return node

    def fresh(self, event: YamlEvent, mark: Mark, depth: int) -> Node:
        if isinstance(event, yaml.ScalarEvent):
            return Node(
                resolve_scalar(event.value) if event.implicit[0] and not event.style else event.value,
                mark,
                event.value,
            )
        if isinstance(event, yaml.MappingStartEvent):
            return self.mapping(mark, depth)
        return self.sequence(mark, depth)

    def alias(self, event: YamlEvent, mark: Mark) -> Node:
        node = self.anchors.get(event.anchor)
        if node is None:
            message = (
                f"unknown anchor &{event.anchor}"
                if event.anchor not in self.anchors
                else f"*{event.anchor} contains itself"
            )
            raise _StopError(
                mark, ProblemCode.YAML_FEATURE, message, f'if it is text, put it in quotes: "*{event.anchor}"'
            )
        self.spend(node.size, mark)
        return Node(node.value, mark, node.text, node.keys, node.size)

    def spend(self, count: int, mark: Mark) -> None:
        self.values += count
        if self.values > MAX_VALUES:
            raise _StopError(
                mark,
                ProblemCode.BUDGET,
                f"more than {MAX_VALUES:,} values, counted through aliases",
                "split the file",
            )

    def sequence(self, mark: Mark, depth: int) -> Node:
        items = []
        for event in self.events:
            if isinstance(event, yaml.SequenceEndEvent):
                break
            items.append(self.node(event, depth + 1))
        return Node(items, mark, size=1 + sum(item.size for item in items))

    def mapping(self, mark: Mark, depth: int) -> Node:
        entries: dict[str, Node] = {}
        node = Node(entries, mark)
        for event in self.events:
            if isinstance(event, yaml.MappingEndEvent):
                break
            key = self.key(event)
            key_mark = self.mark(event)
            value = self.node(next(self.events), depth + 1)
            node.size += value.size
            if key in entries:
                self.duplicate(key, key_mark, node.keys[key])
            else:
                entries[key], node.keys[key] = value, key_mark
        return node

    def key(self, event: YamlEvent) -> str:
        if not isinstance(event, yaml.ScalarEvent):
            message = "a key must be a plain word"
            raise _StopError(
                self.mark(event),
                ProblemCode.YAML_FEATURE,
                message,
                "if { or [ or * begins a text, put it in quotes",
            )
        if event.tag is not None:
            raise _StopError(
                self.mark(event),
                ProblemCode.YAML_FEATURE,
                f"tags such as {event.tag} are not supported",
                "remove it",
            )
        if event.value == "<<" and not event.style and not self.merge_keys:
            message = "merge keys (<<) are not supported"
            raise _StopError(
                self.mark(event),
                ProblemCode.YAML_FEATURE,
                message,
                "write the keys out; an inventory has defaults: for shared settings",
            )
        return str(event.value)

    def duplicate(self, key: str, mark: Mark, first: Mark) -> None:
        message = f'duplicate key "{key}" (first defined on line {first.line})'
        self.problems.add(
            mark,
            ProblemCode.DUPLICATE_KEY,
            message,
            f"remove line {first.line} or line {mark.line}, or rename one of the two",
        )


def resolve_scalar(text: str) -> Scalar:
    """A plain scalar by the YAML 1.2 core schema, except that digits with a leading zero stay text (017 is an
    id).
    """
    if text in _KEYWORDS:
        return _KEYWORDS[text]
    if text[0] not in _NUMERIC_START:
        return text
    if _INT_PATTERN.fullmatch(text):
        return int(text)
    if _PREFIXED_INT_PATTERN.fullmatch(text):
        return int(text, 0)
    if _FLOAT_PATTERN.fullmatch(text):
        return float(text)
    return float(text.replace(".", "")) if _NON_FINITE_PATTERN.fullmatch(text) else text
