# SPDX-License-Identifier: Apache-2.0
"""JSON, JSON Lines, YAML and CSV of a document. Pure: JSON types in, text out."""

import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence

from edgectl.model.text import escape_unprintable

_SIGNIFICANT_DIGITS = 6
# Control characters beyond ASCII, those that change the direction of text or end a line, and half surrogates.
# Compiled when a document is written: tables need none.
_UNPRINTABLE = "[\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]"


def round_numbers(value: object) -> object:
    """``value`` with every float rounded to 6 significant digits; integral numbers as integers, -0 as 0."""
    if isinstance(value, float):
        rounded = float(f"{value:.{_SIGNIFICANT_DIGITS}g}") if not value.is_integer() else value
        return int(rounded) if rounded.is_integer() else rounded
    if isinstance(value, Mapping):
        return {str(key): round_numbers(each) for key, each in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [round_numbers(each) for each in value]
    return value


def encode_json(document: Mapping[str, object] | Sequence[Mapping[str, object]]) -> str:
    """The document, keys in the order given, with two spaces of indentation.

    Raises:
        ValueError: a number is not finite.
    """
    return escape_json_controls(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)) + "\n"


def encode_json_lines(rows: Iterable[Mapping[str, object]]) -> str:
    """One object per line.

    Raises:
        ValueError: a number is not finite.
    """
    return "".join(
        escape_json_controls(json.dumps(row, ensure_ascii=False, allow_nan=False, separators=(",", ":")))
        + "\n"
        for row in rows
    )


def escape_json_controls(text: str) -> str:
    """JSON whose strings hold control and direction-changing characters as escapes: the same document,
    harmless on a terminal.
    """
    return re.sub(_UNPRINTABLE, lambda found: f"\\u{ord(found[0]):04x}", text)


def encode_yaml(document: Mapping[str, object]) -> str:
    """The document in YAML."""
    import yaml

    # Through JSON, so that both say the same and no type of Python's own gets through.
    plain = json.loads(json.dumps(document, allow_nan=False))
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    printable = not re.search(_UNPRINTABLE, json.dumps(plain, ensure_ascii=False))
    return str(yaml.dump(plain, Dumper=dumper, sort_keys=False, allow_unicode=printable, width=4096))


def encode_csv(rows: Sequence[Mapping[str, object]]) -> str:
    """A line of keys, then one per row. A key within an object is joined to it by ``_``; a list is JSON."""
    import csv

    flat = [flatten_row(row) for row in rows]
    keys = list(dict.fromkeys(key for row in flat for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, keys, restval="", lineterminator="\n")
    if keys:
        writer.writeheader()
    writer.writerows(flat)
    return text.getvalue()


def flatten_row(row: Mapping[str, object], prefix: str = "") -> dict[str, str]:
    """The values of a row as text, each under its whole key."""
    flat: dict[str, str] = {}
    for key, value in row.items():
        if isinstance(value, Mapping) and value:
            flat |= flatten_row(value, f"{prefix}{key}_")
        else:
            flat[prefix + key] = _format_csv_value(value)
    return flat


def _format_csv_value(value: object) -> str:
    if value is None or value == {} or value == []:
        return ""
    if isinstance(value, str):
        return escape_unprintable(value)
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
