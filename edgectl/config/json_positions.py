# SPDX-License-Identifier: Apache-2.0
"""Positions in JSON text; computed only for invalid documents, so that reading a valid one costs nothing."""

import json
import re
from collections.abc import Collection
from dataclasses import dataclass, field

from edgectl.formats.document import FieldPath

_TOKEN_PATTERN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\],:]|[^\s{}\[\],:"]+')
_MAX_INTEGER_DIGITS = 4300  # maximum digits of an integer in Python
_NON_FINITE_WORDS = ("NaN", "Infinity", "-Infinity")


@dataclass(slots=True)
class JsonPositions:
    """Result of a walk: spans of the requested paths, duplicate keys (first, second), numbers that are not
    JSON.
    """

    spans: dict[FieldPath, tuple[int, int]] = field(default_factory=dict)
    duplicates: list[tuple[tuple[int, int], tuple[int, int]]] = field(default_factory=list)
    constants: list[tuple[int, int]] = field(default_factory=list)


@dataclass(slots=True)
class _OpenContainer:
    """An open object or list: the last part of its path, and the keys seen."""

    is_object: bool
    part: str | int = 0
    key_next: bool = True
    keys: dict[str, tuple[int, int]] = field(default_factory=dict)


def find_json_positions(text: str, wanted: Collection[FieldPath]) -> JsonPositions:
    """Walk ``text`` (JSON except for the faults to locate) once."""
    places = JsonPositions()
    levels: list[_OpenContainer] = []
    for token in _TOKEN_PATTERN.finditer(text):
        word, span = token[0], token.span()
        level = levels[-1] if levels else None
        if word == ":":
            continue
        if word == ",":
            _advance_entry(level)
        elif word in ("}", "]"):
            levels.pop() if levels else None
        elif level is not None and level.is_object and level.key_next:
            _visit_key(level, word, span, places)
        else:
            _visit_value(levels, word, span, wanted, places)
    return places


def _advance_entry(level: _OpenContainer | None) -> None:
    if level is not None and level.is_object:
        level.key_next = True
    elif level is not None and isinstance(level.part, int):
        level.part += 1


def _visit_key(level: _OpenContainer, word: str, span: tuple[int, int], places: JsonPositions) -> None:
    key = _unquote_key(word)
    if key in level.keys:
        places.duplicates.append((level.keys[key], span))
    level.keys[key] = span
    level.part, level.key_next = key, False


def _visit_value(
    levels: list[_OpenContainer],
    word: str,
    span: tuple[int, int],
    wanted: Collection[FieldPath],
    places: JsonPositions,
) -> None:
    path = tuple(level.part for level in levels)
    if path in wanted:
        places.spans[path] = span
    if word in _NON_FINITE_WORDS or (len(word.lstrip("-")) > _MAX_INTEGER_DIGITS and word[-1].isdigit()):
        places.constants.append(span)
    if word in ("{", "["):
        levels.append(_OpenContainer(is_object=word == "{"))


def _unquote_key(word: str) -> str:
    try:
        return str(json.loads(word)) if "\\" in word else word[1:-1]
    except ValueError:
        return word
