# SPDX-License-Identifier: Apache-2.0
"""JSON with the C half of module json alone.

``import json`` takes 10 ms of CPU for what it brings along (re, enum, collections): more than the rest of a
status request. Where an interpreter lacks the C half, the whole module takes its place.
"""

import os

try:
    from _json import encode_basestring_ascii, make_encoder, make_scanner
except ImportError:
    make_scanner = None  # type: ignore[assignment, misc]

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, Dict

    # A JSON object.
    Document = Dict[str, Any]
else:
    # The alias without module typing, whose import would double the CPU of a status request.
    Document = dict


class _ScannerOptions:
    """Attributes that the scanner reads from its decoder."""

    strict = True
    object_hook = None
    object_pairs_hook = None
    parse_float, parse_int, parse_constant = float, int, float
    memo: "Dict[str, Any]" = {}


def loads(text: str) -> "Any":
    """Decode the one JSON value in ``text``. Raises ValueError."""
    if make_scanner is None:
        import json

        return json.loads(text)
    text = text.strip(" \t\r\n")
    try:
        value, end = make_scanner(_ScannerOptions)(text, 0)  # type: ignore[arg-type] # typeshed asks for a decoder
    except StopIteration:
        raise ValueError("no JSON document") from None
    if end != len(text):
        raise ValueError("more than one JSON document")
    return value


def dumps(value: object) -> str:
    """Encode None, booleans, finite numbers, strings, lists, tuples and dicts with string keys as ASCII JSON.
    Raises ValueError.
    """
    if make_scanner is None:
        import json

        return json.dumps(value, allow_nan=False, default=_reject_value)
    # In the order of its parameters: no check for cycles, separators, no sorting, no keys skipped, no NaN.
    encode = make_encoder(None, _reject_value, encode_basestring_ascii, None, ": ", ", ", False, False, False)
    return "".join(encode(value, 0))


def _reject_value(value: object) -> "Any":
    raise ValueError("not a JSON value: %r" % (value,))


def send_document(fd: int, document: Document) -> None:
    """Write ``document`` to a pipe and close it; a reader that is gone is ignored."""
    try:
        os.write(fd, dumps(document).encode("ascii"))
        os.close(fd)
    except OSError:
        pass
