"""Seeded damage: bytes that are changed, cut, doubled and moved, words that parsers trip over, and JSON values in wrong places."""

import json
import random
from typing import Any

WORDS = [
    b"{", b"}", b"[", b"]", b":", b": ", b",", b"- ", b"\n", b"\n  ", b"\t", b"\r\n", b"&a ", b"*a", b"<<: ", b"!!str ", b"|", b">", b"'", b'"',
    b"#", b"%", b"@", b"\\", b"\0", b"~", b"null", b"true", b"no", b"22:22", b".nan", b"NaN", b"-Infinity", b"1e999", b"-1", b"9" * 400, b"0x1F",
    b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\xc3", b"\\ud800", b"\\u0000", "\u2028".encode(), b"\x1b[31m", b"---\n", b"...", b"? ",
    b"x" * 70, b"[" * 2000, b"{\"a\":" * 2000, b"&a [*a,*a]", b"120%", b"{robot}", b"on", b"secret: true", b"format_version", b"0" * 64,
]  # fmt: skip
VALUES: list[Any] = [
    None, True, False, 0, -1, 1.5, -0.0, 1e308, 10**30, "", "x", "NaN", "\0", "\u202e", "\x1b]0;x\x07", "a" * 5000, [], {}, [[]], {"": {}}, [None],
    {"value": 1}, "2025-11-21T01:53:25Z", "9999-99-99T99:99:99Z", "../..", 2**63, -(2**63),
]  # fmt: skip


def damaged(chance: random.Random, seeds: list[bytes]) -> bytes:
    """One of the seeds with one to four changes."""
    data = chance.choice(seeds)
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 4))):
        data = chance.choice(CHANGES)(chance, data, seeds)
    return data


def worn(chance: random.Random, seeds: list[bytes]) -> bytes:
    """One of the seeds as a bad disk gives it: bits flipped, a stretch of zeros, the end missing; what is left stays where it was."""
    data = bytearray(chance.choice(seeds))
    for _ in range(chance.choice((0, 1, 1, 2, 8))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    if chance.random() < 0.3:
        start, end = _span(chance, data)
        data[start:end] = bytes(end - start)
    return bytes(data[: chance.randint(0, len(data))] if chance.random() < 0.3 else data)


def _span(chance: random.Random, data: bytes) -> tuple[int, int]:
    start = chance.randint(0, len(data))
    return start, min(len(data), start + chance.choice((0, 1, 2, 4, 8, 16, 64, 256)))


def _flip(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    if not data:
        return b"\xff"
    at = chance.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]


def _cut(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    start, end = _span(chance, data)
    return data[:start] + data[end:]


def _truncate(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    return data[: chance.randint(0, len(data))]


def _insert(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    start, end = _span(chance, data)
    return data[:start] + chance.choice(WORDS) + data[chance.choice((start, end)) :]


def _double(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    start, end = _span(chance, data)
    at = chance.randint(0, len(data))
    return data[:at] + data[start:end] * chance.choice((1, 1, 2, 50)) + data[at:]


def _lines(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    lines = data.split(b"\n")
    one, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines if chance.random() < 0.7 else lines[:one] + lines[one + 1 :])


def _splice(chance: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    other = chance.choice(seeds)
    return data[: chance.randint(0, len(data))] + other[chance.randint(0, len(other)) :]


def _value(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    """Where the data is JSON: one value replaced, taken away or put under another name, anywhere in the tree."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return _insert(chance, data, _seeds)
    places = list(_places(tree))
    if not places:
        return json.dumps(chance.choice(VALUES)).encode()
    inside, key = chance.choice(places)
    act = chance.random()
    if act < 0.7:
        inside[key] = chance.choice(VALUES)
    elif act < 0.85:
        del inside[key]
    elif isinstance(inside, dict):
        inside[chance.choice(("", "x", "task", "\0", "a" * 300))] = inside.pop(key)
    return json.dumps(tree, ensure_ascii=chance.random() < 0.5).encode("utf-8", "surrogatepass")


def _places(tree: Any) -> list[tuple[Any, Any]]:
    found, waiting = [], [tree]
    while waiting:
        inside = waiting.pop()
        keys = (
            list(inside)
            if isinstance(inside, dict)
            else range(len(inside))
            if isinstance(inside, list)
            else ()
        )
        found += [(inside, key) for key in keys]
        waiting += [inside[key] for key in keys]
    return found


CHANGES = (_flip, _cut, _truncate, _insert, _insert, _double, _lines, _splice, _value, _value, _value)
