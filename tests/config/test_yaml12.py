# SPDX-License-Identifier: Apache-2.0
"""YAML 1.2 core scalars, places, and expansion bombs that are rejected before anything is built."""

import os
import time
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory
from edgectl.config.node import value_from_node
from edgectl.config.problems import Problems, Source
from edgectl.config.yaml_parser import parse_yaml, resolve_scalar
from edgectl.errors import InputError


def parse_text(text: str) -> tuple[object, Problems]:
    problems = Problems()
    node = parse_yaml(Source(file="f.yaml", text=text, lines=tuple(text.split("\n"))), problems)
    return None if node is None else value_from_node(node), problems


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("no", "no"), ("on", "on"), ("y", "y"), ("Off", "Off"), ("22:22", "22:22"), ("017", "017"), ("0o17", 15), ("0x1F", 31),
        ("2024-01-01", "2024-01-01"), ("1.10", 1.1), ("1e3", 1000.0), (".5", 0.5), ("5.", 5.0), ("-3", -3), ("+3", 3), ("0", 0), ("-0", 0),
        ("1_000", "1_000"), ("true", True), ("True", True), ("tRue", "tRue"), ("null", None), ("~", None), ("", None), ("NULL", None),
        (".inf", float("inf")), ("-.INF", float("-inf")), ("1.2.3", "1.2.3"), ("-", "-"), (".", "."), ("+.", "+."), ("1e", "1e"),
        ("0b11", "0b11"), ("007.5", "007.5"), ("12:30:45", "12:30:45"), ("9" * 5000, float("inf")), ("1e999", float("inf")),
        ("nan", "nan"), ("infinity", "infinity"), ("=", "="), ("0x", "0x"), ("1,5", "1,5"), ("٣", "٣"),
    ],
)  # fmt: skip
def test_plain_scalars_are_yaml_1_2_core(text: str, value: object) -> None:
    got = resolve_scalar(text)
    assert got == value
    assert type(got) is type(value)


def test_not_a_number_is_a_float() -> None:
    got = resolve_scalar(".NaN")
    assert isinstance(got, float)
    assert got != got


def test_quoted_scalars_stay_text() -> None:
    assert parse_text("a: '1'\nb: \"true\"\nc: |\n  12\n")[0] == {"a": "1", "b": "true", "c": "12\n"}


def test_keys_are_text_whatever_they_look_like() -> None:
    assert parse_text("1: a\ntrue: b\nno: c\n~: d")[0] == {"1": "a", "true": "b", "no": "c", "~": "d"}


def test_anchors_are_read_and_stand_where_they_are_used() -> None:
    value, problems = parse_text("a: &x {b: 1}\nc: *x\n")
    assert value == {"a": {"b": 1}, "c": {"b": 1}}
    assert not problems.found


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_every_line_ending_counts(ending: str, tmp_path: Path) -> None:
    path = tmp_path / "i.yaml"
    path.write_bytes(ending.join(["version: 1", "edges:", "  edge1: {hots: a}", ""]).encode())
    with pytest.raises(InputError) as caught:
        load_inventory(path)
    unknown = next(p for p in caught.value.problems if p.code == "EC012")
    assert (unknown.line, unknown.column, unknown.length, unknown.source) == (3, 11, 4, "  edge1: {hots: a}")


def test_a_byte_order_mark_and_wide_characters_do_not_shift_columns() -> None:
    _, problems = parse_text("ü: {ö: 1, ö: 2}")
    assert [(p.line, p.column) for p in problems.found] == [(1, 11)]


ALIASES = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 30)
)
BOMBS = {
    "alias bomb": (ALIASES, "EC007"),
    "merge bomb": ("a: &a {x: 1}\n" + "".join(f"b{i}: &b{i} {{<<: [*a, *a]}}\n" for i in range(20)), "EC006"),
    "depth": ("[" * 60 + "]" * 60, "EC007"),
    "endless depth": ("[" * 500_000, "EC007"),
    "block depth": ("- " * 200_000 + "x", "EC007"),
    "key depth": ("? " * 200_000 + "x", "EC006"),
    "many values": ("[" + "1," * 400_000 + "]", "EC007"),
    "many mappings": ("[" + "{}," * 300_000 + "]", "EC007"),
    "self": ("a: &a [*a]", "EC006"),
    "self in a key": ("a: &a {b: *a}", "EC006"),
    "long line": ("a: " + "x" * 1_000_000 + ": y", "EC004"),
    "many anchors": ("".join(f"- &a{i} x\n" for i in range(80_000)) + "- *b", "EC006"),
    "open quotes": ('"' + "\n" * 1_000_000, "EC004"),
    "comments only": ("# x\n" * 250_000, "EC008"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_at_once(name: str) -> None:
    text, code = BOMBS[name]
    begin = time.process_time()
    _, problems = parse_text(text)
    assert time.process_time() - begin < 5.0
    assert [problem.code for problem in problems.found] == [code]


def get_file_problem(path: Path) -> tuple[str, str, str, int, int]:
    with pytest.raises(InputError) as caught:
        load_inventory(path)
    (problem,) = caught.value.problems
    return problem.code, problem.message, problem.hint, problem.line, problem.column


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text("")
    (tmp_path / "big.yaml").write_text("#" * (2**20 + 1))
    (tmp_path / "latin.yaml").write_bytes("version: 1\nedges: {é: 1}\n".encode("latin-1"))
    assert get_file_problem(tmp_path / "lab.yml") == (
        "EC001",
        "no such file",
        f"did you mean {tmp_path}/lab.yaml?",
        0,
        0,
    )
    assert get_file_problem(tmp_path / "other")[2] == "name an existing file, or create one: edgectl init DIR"
    assert get_file_problem(tmp_path)[:2] == ("EC001", "is a directory, not a file")
    assert get_file_problem(tmp_path / "lab.yaml")[:3] == (
        "EC008",
        "the file is empty",
        "begin with: version: 1",
    )
    assert get_file_problem(tmp_path / "big.yaml")[:2] == ("EC003", "the file is larger than 1 MiB")
    assert get_file_problem(tmp_path / "latin.yaml") == (
        "EC002",
        "byte 0xe9 is not UTF-8",
        "save the file as UTF-8",
        2,
        9,
    )
    assert get_file_problem(Path("a\0b"))[0] == "EC001"
    os.mkfifo(tmp_path / "pipe")
    assert get_file_problem(tmp_path / "pipe")[:2] == ("EC001", "is not a regular file"), (
        "nobody writes: to read it would wait for ever"
    )
    assert get_file_problem(tmp_path / "lab.yaml" / "x")[0] == "EC001"
