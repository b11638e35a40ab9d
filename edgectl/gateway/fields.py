"""Typed reading of an agent's document: every value is checked where it is taken out."""

import unicodedata
from collections.abc import Callable, Mapping
from typing import TypeVar

from edgectl.errors import ReplyError

Document = Mapping[str, object]
Value = TypeVar("Value")
_MOST = 2.0**63
_TEXT_LIMIT = 4096
_LINE_LIMIT, _MOST_LINES = 500, 20


def printable(text: str) -> str:
    """``text`` with every control and direction-changing character written as an escape, so that no host can drive a terminal."""
    return "".join(_escaped(char) if unicodedata.category(char) in ("Cc", "Cf", "Cs", "Zl", "Zp") else char for char in text)


def _escaped(char: str) -> str:
    return char.encode("unicode_escape", "surrogatepass").decode("ascii")


def table(document: Document, key: str) -> Document:
    """The object under ``key``; a missing one is empty."""
    value = document.get(key, {})
    if not isinstance(value, dict):
        raise ReplyError(f"{key} is not an object")
    return value


def entries(document: Document, key: str) -> dict[str, Document]:
    """The object of objects under ``key``, its names checked; a missing one is empty."""
    found: dict[str, Document] = {}
    for name, value in table(document, key).items():
        if not isinstance(value, dict):
            raise ReplyError(f"{key}.{printable(name)} is not an object")
        found[printable(name)] = value
    return found


def number(document: Document, key: str, *, low: float = 0.0) -> float:
    """The finite number under ``key``, at least ``low``."""
    value = document.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= _MOST:
        raise ReplyError(f"{key} is not a number of at least {low:g}: {printable(repr(value))[:80]}")
    return float(value)


def positive(document: Document, key: str) -> float:
    """The finite number above 0 under ``key``: a capacity."""
    value = number(document, key)
    if value <= 0.0:
        raise ReplyError(f"{key} must be above 0")
    return value


def whole(document: Document, key: str, *, low: int = 0) -> int:
    """The integer under ``key``, at least ``low``."""
    value = document.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= _MOST:
        raise ReplyError(f"{key} is not an integer of at least {low}: {printable(repr(value))[:80]}")
    return value


def text(document: Document, key: str) -> str:
    """The string under ``key`` made printable; missing or null is empty."""
    value = document.get(key)
    if value is None:
        return ""
    if not isinstance(value, str):
        raise ReplyError(f"{key} is not a string")
    return printable(value[:_TEXT_LIMIT])


def lines(document: Document, key: str) -> tuple[str, ...]:
    """The last few of the strings under ``key``, made printable; missing or null is none."""
    value = document.get(key) or []
    if not isinstance(value, list) or not all(isinstance(line, str) for line in value):
        raise ReplyError(f"{key} is not a list of strings")
    return tuple(printable(line[:_LINE_LIMIT]) for line in value[-_MOST_LINES:])


def flag(document: Document, key: str, *, default: bool) -> bool:
    """True or false under ``key``; missing or null is ``default``."""
    value = document.get(key)
    if value is None:
        return default
    if not isinstance(value, bool):
        raise ReplyError(f"{key} is not true or false")
    return value


def optional(document: Document, key: str, read: Callable[[Document, str], Value]) -> Value | None:
    """``read`` of the value under ``key``; None where it is missing or null."""
    return None if document.get(key) is None else read(document, key)


def finite(document: Document, key: str, *, most: float = _MOST) -> float:
    """Any finite number under ``key`` of at most this size, such as a temperature or a clock."""
    value = document.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
        raise ReplyError(f"{key} is not a finite number: {printable(repr(value))[:80]}")
    return float(value)
