# SPDX-License-Identifier: Apache-2.0
"""Seeded mutations: changed, cut, duplicated and moved bytes, words that confuse parsers, and misplaced JSON
values.
"""

import copy
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
    1e12, 5e-324, 2**33, 2**53, "\ud800", "\x9b31m", "@team", "x | y", "::error::x", "${jndi:x}", ["x"] * 50, {"value": None},
]  # fmt: skip


def mutate_seed(chance: random.Random, seeds: list[bytes]) -> bytes:
    """Apply one to four mutations to one of the seeds."""
    data = chance.choice(seeds)
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 4))):
        data = chance.choice(CHANGES)(chance, data, seeds)
    return data


def damage_seed(chance: random.Random, seeds: list[bytes]) -> bytes:
    """Damage one of the seeds like a bad disk: flipped bits, a run of zeros, a missing end; all other bytes
    stay in place.
    """
    data = bytearray(chance.choice(seeds))
    for _ in range(chance.choice((0, 1, 1, 2, 8))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    if chance.random() < 0.3:
        start, end = _choose_span(chance, data)
        data[start:end] = bytes(end - start)
    return bytes(data[: chance.randint(0, len(data))] if chance.random() < 0.3 else data)


def _choose_span(chance: random.Random, data: bytes | bytearray) -> tuple[int, int]:
    start = chance.randint(0, len(data))
    return start, min(len(data), start + chance.choice((0, 1, 2, 4, 8, 16, 64, 256)))


def _flip_bit(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    if not data:
        return b"\xff"
    at = chance.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]


def _cut_span(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    start, end = _choose_span(chance, data)
    return data[:start] + data[end:]


def _truncate_end(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    return data[: chance.randint(0, len(data))]


def _insert_word(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    start, end = _choose_span(chance, data)
    return data[:start] + chance.choice(WORDS) + data[chance.choice((start, end)) :]


def _duplicate_span(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    start, end = _choose_span(chance, data)
    at = chance.randint(0, len(data))
    return data[:at] + data[start:end] * chance.choice((1, 1, 2, 50)) + data[at:]


def _swap_lines(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    lines = data.split(b"\n")
    one, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines if chance.random() < 0.7 else lines[:one] + lines[one + 1 :])


def _splice_seeds(chance: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    other = chance.choice(seeds)
    return data[: chance.randint(0, len(data))] + other[chance.randint(0, len(other)) :]


def _change_json_value(chance: random.Random, data: bytes, _seeds: list[bytes]) -> bytes:
    """In JSON, replace, remove or rename one value anywhere in the tree."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return _insert_word(chance, data, _seeds)
    tree = change_json_value(chance, tree)
    return json.dumps(tree, ensure_ascii=chance.random() < 0.5).encode("utf-8", "surrogatepass")


def change_json_value(chance: random.Random, tree: Any) -> Any:
    """Replace, remove or rename one value anywhere in a tree of JSON values, which is changed in place."""
    places = _list_json_places(tree)
    if not places:
        return copy.deepcopy(chance.choice(VALUES))
    inside, key = chance.choice(places)
    act = chance.random()
    if act < 0.7:
        inside[key] = copy.deepcopy(chance.choice(VALUES))
    elif act < 0.85:
        del inside[key]
    elif isinstance(inside, dict):
        inside[chance.choice(("", "x", "task", "\0", "a" * 300))] = inside.pop(key)
    return tree


def _list_json_places(tree: Any) -> list[tuple[Any, Any]]:
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


CHANGES = (
    _flip_bit,
    _cut_span,
    _truncate_end,
    _insert_word,
    _insert_word,
    _duplicate_span,
    _swap_lines,
    _splice_seeds,
    _change_json_value,
    _change_json_value,
    _change_json_value,
)
