"""Typed reading of an agent's document: every value is checked where it is taken out."""

import unicodedata
from collections.abc import Callable, Mapping
from typing import TypeVar

from edgectl.errors import ReplyError

ReplyDocument = Mapping[str, object]
Value = TypeVar("Value")
_MAX_NUMBER = 2.0**63
_TEXT_LIMIT = 4096
_LINE_LIMIT, _MAX_LINES = 500, 20


def escape_unprintable(text: str) -> str:
    """``text`` with every control and direction-changing character written as an escape, so that no host can drive a terminal."""
    return "".join(
        _escape_char(char) if unicodedata.category(char) in ("Cc", "Cf", "Cs", "Zl", "Zp") else char
        for char in text
    )


def _escape_char(char: str) -> str:
    return char.encode("unicode_escape", "surrogatepass").decode("ascii")


def get_object(document: ReplyDocument, key: str) -> ReplyDocument:
    """The object under ``key``; a missing one is empty."""
    value = document.get(key, {})
    if not isinstance(value, dict):
        raise ReplyError(f"{key} is not an object")
    return value


def get_objects(document: ReplyDocument, key: str) -> dict[str, ReplyDocument]:
    """The object of objects under ``key``, its names checked; a missing one is empty."""
    found: dict[str, ReplyDocument] = {}
    for name, value in get_object(document, key).items():
        if not isinstance(value, dict):
            raise ReplyError(f"{key}.{escape_unprintable(name)} is not an object")
        found[escape_unprintable(name)] = value
    return found


def get_number(document: ReplyDocument, key: str, *, low: float = 0.0) -> float:
    """The finite number under ``key``, at least ``low``."""
    value = document.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= _MAX_NUMBER:
        raise ReplyError(f"{key} is not a number of at least {low:g}: {escape_unprintable(repr(value))[:80]}")
    return float(value)


def get_positive(document: ReplyDocument, key: str) -> float:
    """The finite number above 0 under ``key``: a capacity."""
    value = get_number(document, key)
    if value <= 0.0:
        raise ReplyError(f"{key} must be above 0")
    return value


def get_int(document: ReplyDocument, key: str, *, low: int = 0) -> int:
    """The integer under ``key``, at least ``low``."""
    value = document.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= _MAX_NUMBER:
        raise ReplyError(f"{key} is not an integer of at least {low}: {escape_unprintable(repr(value))[:80]}")
    return value


def get_text(document: ReplyDocument, key: str) -> str:
    """The string under ``key`` made printable; missing or null is empty."""
    value = document.get(key)
    if value is None:
        return ""
    if not isinstance(value, str):
        raise ReplyError(f"{key} is not a string")
    return escape_unprintable(value[:_TEXT_LIMIT])


def get_lines(document: ReplyDocument, key: str) -> tuple[str, ...]:
    """The last few of the strings under ``key``, made printable; missing or null is none."""
    value = document.get(key) or []
    if not isinstance(value, list) or not all(isinstance(line, str) for line in value):
        raise ReplyError(f"{key} is not a list of strings")
    return tuple(escape_unprintable(line[:_LINE_LIMIT]) for line in value[-_MAX_LINES:])


def get_flag(document: ReplyDocument, key: str, *, default: bool) -> bool:
    """True or false under ``key``; missing or null is ``default``."""
    value = document.get(key)
    if value is None:
        return default
    if not isinstance(value, bool):
        raise ReplyError(f"{key} is not true or false")
    return value


def get_optional(
    document: ReplyDocument, key: str, read: Callable[[ReplyDocument, str], Value]
) -> Value | None:
    """``read`` of the value under ``key``; None where it is missing or null."""
    return None if document.get(key) is None else read(document, key)


def get_finite(document: ReplyDocument, key: str, *, most: float = _MAX_NUMBER) -> float:
    """Any finite number under ``key`` of at most this size, such as a temperature or a clock."""
    value = document.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
        raise ReplyError(f"{key} is not a finite number: {escape_unprintable(repr(value))[:80]}")
    return float(value)
