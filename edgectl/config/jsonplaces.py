"""Where things stand in JSON text. Only walked when a document is wrong, so that reading a right one costs nothing."""

import json
import re
from collections.abc import Collection
from dataclasses import dataclass, field

from edgectl.formats.base import Path

_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\],:]|[^\s{}\[\],:"]+')
_LONGEST_NUMBER = 4300  # digits of an integer that Python reads
_CONSTANTS = ("NaN", "Infinity", "-Infinity")


@dataclass(slots=True)
class Places:
    """What a walk found: spans of the wanted paths, keys that stand twice (first, second), numbers that are not JSON."""

    spans: dict[Path, tuple[int, int]] = field(default_factory=dict)
    twice: list[tuple[tuple[int, int], tuple[int, int]]] = field(default_factory=list)
    constants: list[tuple[int, int]] = field(default_factory=list)


@dataclass(slots=True)
class _Level:
    """An open object or list: the path's last part, and the keys seen."""

    is_object: bool
    part: str | int = 0
    key_next: bool = True
    keys: dict[str, tuple[int, int]] = field(default_factory=dict)


def find_places(text: str, wanted: Collection[Path]) -> Places:
    """Walk ``text`` (valid JSON but for what is looked for) once."""
    places = Places()
    levels: list[_Level] = []
    for token in _TOKEN.finditer(text):
        word, span = token[0], token.span()
        level = levels[-1] if levels else None
        if word == ":":
            continue
        if word == ",":
            _next_entry(level)
        elif word in ("}", "]"):
            levels.pop() if levels else None
        elif level is not None and level.is_object and level.key_next:
            _key(level, word, span, places)
        else:
            _value(levels, word, span, wanted, places)
    return places


def _next_entry(level: _Level | None) -> None:
    if level is not None and level.is_object:
        level.key_next = True
    elif level is not None and isinstance(level.part, int):
        level.part += 1


def _key(level: _Level, word: str, span: tuple[int, int], places: Places) -> None:
    key = _unquoted(word)
    if key in level.keys:
        places.twice.append((level.keys[key], span))
    level.keys[key] = span
    level.part, level.key_next = key, False


def _value(levels: list[_Level], word: str, span: tuple[int, int], wanted: Collection[Path], places: Places) -> None:
    path = tuple(level.part for level in levels)
    if path in wanted:
        places.spans[path] = span
    if word in _CONSTANTS or (len(word.lstrip("-")) > _LONGEST_NUMBER and word[-1].isdigit()):
        places.constants.append(span)
    if word in ("{", "["):
        levels.append(_Level(is_object=word == "{"))


def _unquoted(word: str) -> str:
    try:
        return str(json.loads(word)) if "\\" in word else word[1:-1]
    except ValueError:
        return word
