# SPDX-License-Identifier: Apache-2.0
"""Basics of JSON documents: faults with their paths, the error that carries them, stable bytes."""

import json
from collections.abc import Mapping

from edgectl.dataclass import dataclass
from edgectl.errors import EdgectlError, ExitCode

FORMAT_VERSION = 1

Document = dict[str, object]
FieldPath = tuple[str | int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One mistake in a document, at ``path`` (keys and list positions from the root)."""

    path: FieldPath
    message: str
    hint: str = ""

    def __str__(self) -> str:
        where = ".".join(str(part) for part in self.path)
        return f"{where}: {self.message}" if where else self.message


Faults = list[Fault]


class FormatErrors(EdgectlError):  # noqa: N818 - it is many
    """Everything that is wrong with one document, at once."""

    exit_code = ExitCode.USAGE

    def __init__(self, kind: str, faults: Faults) -> None:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        super().__init__(f"not a valid {kind}: {faults[0]}{more}", hint=faults[0].hint)
        self.kind = kind
        self.faults = tuple(faults)


def dump_document(document: Mapping[str, object]) -> str:
    """The document's text: keys in the order given, two spaces of indentation, a newline at the end.

    The same bytes every time.

    Raises:
        ValueError: a number is not finite.
    """
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def dump_line(document: Mapping[str, object]) -> str:
    """The same on one line, for JSON Lines.

    Raises:
        ValueError: a number is not finite.
    """
    return json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"


def encode_number(value: float) -> int | float:
    """A number as JSON shows it: integral values are integers, and -0 is 0."""
    return int(value) if float(value).is_integer() else value


def encode_optional(value: float | None) -> int | float | None:
    """A number as JSON shows it, or null."""
    return None if value is None else encode_number(value)


def without_none(**entries: object) -> Document:
    """The entries that are not None."""
    return {key: value for key, value in entries.items() if value is not None}
