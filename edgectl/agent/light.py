"""JSON and sockets by the C halves of their modules alone.

``import json, signal, socket`` takes 14 ms of CPU for what they bring along (re, enum, collections, selectors): more than all
else an agent does in a probe. Where an interpreter lacks a C half, the whole module takes its place.
"""

try:
    from _json import encode_basestring_ascii, make_encoder, make_scanner
except ImportError:
    make_scanner = None
try:
    import _socket as socket
except ImportError:
    import socket  # noqa: F401 - imported from here


class _Plain:
    """What the scanner asks of a decoder."""

    strict = True
    object_hook = object_pairs_hook = None
    parse_float, parse_int, parse_constant = float, int, float
    memo = {}


def loads(text: str):
    """The JSON document in ``text``. Raises ValueError."""
    if make_scanner is None:
        import json

        return json.loads(text)
    text = text.strip(" \t\r\n")
    try:
        value, end = make_scanner(_Plain)(text, 0)
    except StopIteration:
        raise ValueError("no JSON document") from None
    if end != len(text):
        raise ValueError("more than one JSON document")
    return value


def dumps(value) -> str:
    """``value`` (None, booleans, finite numbers, strings, lists, tuples, dicts by string) as ASCII JSON. Raises ValueError."""
    if make_scanner is None:
        import json

        return json.dumps(value, allow_nan=False, default=_refused)
    # In the order of its parameters: no memory of what was seen, separators, no sorting, no keys skipped, no NaN.
    encode = make_encoder(None, _refused, encode_basestring_ascii, None, ": ", ", ", False, False, False)
    return "".join(encode(value, 0))


def _refused(value):
    raise ValueError("not a JSON value: %r" % (value,))
