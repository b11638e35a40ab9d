"""Reading one JSON document: types, ranges and presence, with every mistake noted and none raised until the end."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar

from edgectl.formats.document import FORMAT_VERSION, Fault, FieldPath, FormatErrors
from edgectl.units import parse_instant

Choice = TypeVar("Choice", bound=StrEnum)
Value = TypeVar("Value")


@dataclass(slots=True, kw_only=True)
class DocumentReader:
    """One JSON object being read. A wrong value is noted in ``faults`` and replaced by a harmless one, so that reading goes on."""

    value: Mapping[str, object]
    path: FieldPath = ()
    faults: list[Fault] = field(default_factory=list)

    def fault(self, key: str | int | None, message: str, hint: str = "") -> None:
        """Note a mistake at ``key`` of this object (or at the object itself)."""
        path = self.path if key is None else (*self.path, key)
        self.faults.append(Fault(path=path, message=message, hint=hint))

    def has(self, key: str) -> bool:
        """Whether ``key`` is there and not null."""
        return self.value.get(key) is not None

    def require(self, key: str) -> bool:
        """Whether ``key`` is there and not null; notes a mistake where it is not."""
        if key not in self.value:
            self.fault(None, f"{key} is missing", f"add {key}")
        elif self.value[key] is None:
            self.fault(key, "must not be null")
        return self.has(key)

    def _there(self, key: str, default: object) -> bool:
        return self.require(key) if default is None else self.has(key)

    def number(self, key: str, *, minimum: float | None = 0.0, positive: bool = False) -> float:
        """A finite number that must be there, at least ``minimum`` (None: any sign), or above 0."""
        return self._number(key, minimum, positive=positive) if self.require(key) else 0.0

    def maybe_number(self, key: str, *, minimum: float | None = 0.0) -> float | None:
        """A finite number, or None where it is absent or null."""
        return self._number(key, minimum, positive=False) if self.has(key) else None

    def _number(self, key: str, minimum: float | None, *, positive: bool) -> float:
        raw = self.value[key]
        if isinstance(raw, bool) or not isinstance(raw, int | float):
            self.fault(key, f"must be a number, not {describe_json_type(raw)}")
            return 0.0
        value = finite_or_none(raw)
        if value is None:
            self.fault(key, "must be a finite number")
        elif positive and value <= 0:
            self.fault(key, f"must be above 0, not {raw}")
        elif minimum is not None and value < minimum:
            self.fault(key, f"must be {minimum:g} or more, not {raw}")
        return value or 0.0

    def integer(self, key: str, default: int | None = None, *, minimum: int | None = 0) -> int:
        """A whole number; must be there unless a default is given."""
        if not self._there(key, default):
            return default or 0
        raw = self.value[key]
        if isinstance(raw, bool) or not isinstance(raw, int):
            self.fault(key, f"must be a whole number, not {describe_json_type(raw)}")
            return 0
        if minimum is not None and raw < minimum:
            self.fault(key, f"must be {minimum} or more, not {raw}")
        return raw

    def maybe_integer(self, key: str) -> int | None:
        """A whole number of any sign, or None."""
        return self.integer(key, minimum=None) if self.has(key) else None

    def text(self, key: str, default: str | None = None) -> str:
        """A string; must be there unless a default is given."""
        if not self._there(key, default):
            return default or ""
        return self._typed(key, self.value[key], str, "a string", "")

    def maybe_text(self, key: str) -> str | None:
        """A string, or None."""
        return self.text(key) if self.has(key) else None

    def flag(self, key: str, *, default: bool | None = None) -> bool:
        """True or false; must be there unless a default is given."""
        if not self._there(key, default):
            return bool(default)
        return self._typed(key, self.value[key], bool, "true or false", bool(default))

    def instant(self, key: str) -> float:
        """Seconds since 1970 from an RFC 3339 string that must be there."""
        if not self.require(key):
            return 0.0
        try:
            return parse_instant(self.value[key])
        except ValueError as error:
            self.fault(key, str(error))
            return 0.0

    def choice(self, key: str, choices: type[Choice], default: Choice | None = None) -> Choice:
        """One of the words of an enum; must be there unless a default is given."""
        fallback = default if default is not None else next(iter(choices))
        if not self._there(key, default):
            return fallback
        raw = self.value[key]
        if isinstance(raw, str) and raw in choices._value2member_map_:
            return choices(raw)
        self.fault(key, f"unknown {key}: {raw!r}" if isinstance(raw, str) else f"must be a word, not {describe_json_type(raw)}",
                   "write one of " + ", ".join(choices))  # fmt: skip
        return fallback

    def named(self, key: str, known: Mapping[str, Value]) -> Value:
        """One of the ``known`` values by its name; must be there."""
        raw = self.text(key)
        if self.has(key) and isinstance(self.value[key], str) and raw not in known:
            self.fault(key, f"unknown {key}: {raw!r}", "write one of " + ", ".join(known))
        return known.get(raw) or next(iter(known.values()))

    def child(self, key: str) -> "DocumentReader":
        """The object under ``key``, which must be there. Where it is not, that is the one mistake that is told."""
        raw = self.value.get(key)
        if self.require(key) and not isinstance(raw, dict):
            self.fault(key, f"must be an object, not {describe_json_type(raw)}")
        if isinstance(raw, dict):
            return DocumentReader(value=raw, path=(*self.path, key), faults=self.faults)
        return DocumentReader(value={}, path=(*self.path, key))

    def maybe_child(self, key: str) -> "DocumentReader | None":
        """The object under ``key``, or None."""
        return self.child(key) if self.has(key) else None

    def children(self, key: str) -> Iterator[tuple[str, "DocumentReader"]]:
        """The objects in the object under ``key`` by name; nothing where it is absent."""
        inner = self.child(key) if self.has(key) else self
        for name in inner.value if inner is not self else ():
            if inner.require(name):
                yield name, inner.child(name)

    def items(self, key: str) -> Iterator["DocumentReader"]:
        """The objects of the list under ``key``; nothing where it is absent."""
        for index, raw in enumerate(self._list(key)):
            if isinstance(raw, dict):
                yield DocumentReader(value=raw, path=(*self.path, key, index), faults=self.faults)
            else:
                self.faults.append(
                    Fault(
                        path=(*self.path, key, index),
                        message=f"must be an object, not {describe_json_type(raw)}",
                    )
                )

    def texts(self, key: str) -> tuple[str, ...]:
        """The strings of the list under ``key``; empty where it is absent."""
        return tuple(self._each(key, str, "a string", ""))

    def numbers(self, key: str, *, minimum: float | None = 0.0) -> tuple[float, ...]:
        """The finite numbers, at least ``minimum`` (None: of any sign), of the list under ``key``."""
        values = [
            finite_or_none(raw)
            for raw in self._list(key)
            if isinstance(raw, int | float) and not isinstance(raw, bool)
        ]
        least = -math.inf if minimum is None else minimum
        if len(values) != len(self._list(key)) or any(value is None or value < least for value in values):
            self.fault(
                key,
                "must be a list of finite numbers"
                + (f", {minimum:g} or more" if minimum is not None else ""),
            )
        return tuple(value or 0.0 for value in values)

    def mapping(self, key: str, read: Callable[["DocumentReader", str], Value]) -> dict[str, Value]:
        """The object under ``key`` with each value read by ``read(reader, name)``; empty where it is absent."""
        inner = self.maybe_child(key)
        return {name: read(inner, name) for name in inner.value} if inner is not None else {}

    def _list(self, key: str) -> list[object]:
        return self._typed(key, self.value[key], list, "a list", []) if self.has(key) else []

    def _each(self, key: str, wanted: type[Value], what: str, fallback: Value) -> Iterator[Value]:
        for index, raw in enumerate(self._list(key)):
            if type(raw) is not wanted:
                self.faults.append(
                    Fault(
                        path=(*self.path, key, index),
                        message=f"must be {what}, not {describe_json_type(raw)}",
                    )
                )
            yield raw if isinstance(raw, wanted) else fallback

    def _typed(self, key: str, raw: object, wanted: type[Value], what: str, fallback: Value) -> Value:
        if isinstance(raw, wanted):
            return raw
        self.fault(key, f"must be {what}, not {describe_json_type(raw)}")
        return fallback


def open_document(raw: object, what: str) -> DocumentReader:
    """A reader over a whole document.

    Raises:
        FormatErrors: not an object, or of a version that this edgectl does not know.
    """
    if not isinstance(raw, dict):
        raise FormatErrors(
            what, [Fault(path=(), message=f"must be an object, not {describe_json_type(raw)}")]
        )
    reader = DocumentReader(value=raw)
    version = reader.integer("format_version", minimum=1)
    if not reader.faults and version != FORMAT_VERSION:
        message = f"format_version {version} is not known to this edgectl (it reads {FORMAT_VERSION})"
        reader.fault("format_version", message, "update edgectl, or write the file again with this one")
    check_no_faults(reader, what)
    return reader


def check_no_faults(reader: DocumentReader, what: str) -> None:
    """End of reading.

    Raises:
        FormatErrors: anything was wrong.
    """
    if reader.faults:
        raise FormatErrors(what, reader.faults)


def finite_or_none(raw: float) -> float | None:
    """``raw`` as a float, or None where it has no finite one."""
    try:
        value = float(raw)
    except OverflowError:
        return None
    return value if math.isfinite(value) else None


def describe_json_type(raw: object) -> str:
    """What a JSON value is, in words."""
    names = {
        dict: "an object",
        list: "a list",
        str: "a string",
        bool: "true or false",
        int: "a number",
        float: "a number",
    }
    return names.get(type(raw), "null" if raw is None else type(raw).__name__)
