"""JSON and sockets by the C halves of their modules alone.

``import json, signal, socket`` takes 14 ms of CPU for what they bring along (re, enum, collections, selectors): more than all
else an agent does in a probe. Where an interpreter lacks a C half, the whole module takes its place.
"""

try:
    from _json import encode_basestring_ascii as _quoted
    from _json import make_scanner
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

        return json.dumps(value, allow_nan=False)
    return "".join(_parts(value))


def _parts(value):
    if isinstance(value, str):
        yield _quoted(value)
    elif isinstance(value, dict):
        yield from _joined("{", ((_quoted(name), ": ", *_parts(inner)) for name, inner in value.items()), "}")
    elif isinstance(value, (list, tuple)):
        yield from _joined("[", map(_parts, value), "]")
    else:
        yield _scalar(value)


def _joined(start: str, groups, end: str):
    yield start
    for number, group in enumerate(groups):
        if number:
            yield ", "
        yield from group
    yield end


def _scalar(value) -> str:
    for known, text in ((None, "null"), (True, "true"), (False, "false")):
        if value is known:
            return text
    if isinstance(value, int):
        return int.__repr__(value)
    if isinstance(value, float) and value - value == 0.0:
        return float.__repr__(value)
    raise ValueError("not a JSON value: %r" % (value,))
