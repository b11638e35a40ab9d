# SPDX-License-Identifier: Apache-2.0
"""Loaders raise no error but InputError, whatever the files contain."""

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from edgectl.config.documents import load_plan, load_snapshot
from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import InputError, Problem
from tests.config.broken_files import INVENTORY, TASKS
from tests.config.test_bad_documents import TEXTS

PIECES = [
    "{", "}", "[", "]", ":", ": ", ",", "- ", "\n", "\n  ", "\t", "&a", "*a", "<<", "!!str ", "|", ">", "'", '"', "#", "%", "@", "\\", "\0", "~",
    "null", "true", "no", "22:22", ".nan", "1e999", "-1", "9" * 30, "robot", "all", "edge1", "robot1", "slam", "{robot}", "é", "\u2028", "\ud7ff",
    "---", "...", "? ", "x" * 70, "120%", "0", "for_each: robot", "needs: [slam]", "hosts: {pin: edge1}",
]  # fmt: skip
pieces = st.one_of(st.sampled_from(PIECES), st.text(max_size=5))


@st.composite
def draw_damaged(draw: st.DrawFn, text: str) -> str:
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.integers(0, 12)))
        text = text[:start] + draw(pieces) + text[end:]
    return text


def write_text(path: Path, text: str) -> Path:
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return path


def list_problems(action: Callable[[], Any]) -> tuple[Problem, ...]:
    try:
        action()
    except InputError as error:
        return error.problems
    return ()


def check_only_input_errors(action: Callable[[], Any]) -> None:
    for problem in list_problems(action):
        assert problem.message
        assert "\n" not in problem.message + problem.hint
        assert min(problem.line, problem.column) >= 0
        assert problem.length >= 1


@given(draw_damaged(INVENTORY), draw_damaged(TASKS))
def test_damaged_yaml(tmp_path: Path, inventory: str, tasks: str) -> None:
    paths = write_text(tmp_path / "i.yaml", inventory), write_text(tmp_path / "t.yaml", tasks)
    check_only_input_errors(lambda: load_inventory_and_tasks(*paths))


@given(st.lists(pieces, max_size=30).map("".join))
def test_any_text(tmp_path: Path, text: str) -> None:
    path = write_text(tmp_path / "f", text)
    for action in (
        lambda: load_inventory_and_tasks(path, path),
        lambda: load_snapshot(path),
        lambda: load_plan(path),
    ):
        check_only_input_errors(action)


@given(st.binary(max_size=60))
def test_any_bytes(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "f"
    path.write_bytes(data)
    for action in (lambda: load_inventory_and_tasks(path, path), lambda: load_snapshot(path)):
        check_only_input_errors(action)


scalars = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=6)
    | st.sampled_from(["all", "robot", "edge1", "50%", "x"])
)
words = st.sampled_from(
    ["version", "defaults", "edges", "robots", "links", "host", "limits", "cpu", "memory", "tasks", "command", "needs", "demand", "hosts", "pin",
     "only", "labels", "env", "handoff", "hold", "on", "detect", "managed", "for_each", "robot", "on_unreachable", "stop", "log", "files", "weights"]
)  # fmt: skip
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(words | st.text(max_size=4), inner, max_size=5)
    ),
    max_leaves=20,
)


@given(st.dictionaries(words, trees, max_size=5), st.dictionaries(words, trees, max_size=5), trees)
def test_any_tree_of_known_words(
    tmp_path: Path, inventory: dict[str, Any], tasks: dict[str, Any], task: Any
) -> None:
    """Trees are written as JSON, which is YAML."""
    tasks = {"version": 1, "tasks": {"slam": task, **tasks}}
    with suppress(UnicodeEncodeError):
        paths = [
            write_text(tmp_path / name, json.dumps(tree, ensure_ascii=False))
            for name, tree in (("i", {"version": 1, **inventory}), ("t", tasks))
        ]
        check_only_input_errors(lambda: load_inventory_and_tasks(*paths))


@given(draw_damaged(TEXTS["snapshot"]), draw_damaged(TEXTS["plan"]))
def test_damaged_documents(tmp_path: Path, snapshot: str, plan: str) -> None:
    check_only_input_errors(lambda: load_snapshot(write_text(tmp_path / "s", snapshot)))
    check_only_input_errors(lambda: load_plan(write_text(tmp_path / "p", plan)))
