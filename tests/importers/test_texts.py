# SPDX-License-Identifier: Apache-2.0
"""Texts that are written reach their readers unchanged: YAML of task files, and words of a command line."""

import json
import os
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.config.node import value_from_node
from edgectl.config.problems import Problems, Source
from edgectl.config.yaml_parser import parse_yaml
from edgectl.importers.expression import ExpressionError, evaluate_expression
from edgectl.importers.ros_command import build_computed_step, join_words
from edgectl.importers.yaml_text import FileEntry, FileText, render_file

# What YAML allows in a file, and texts that look like something else.
TEXTS = st.text(st.characters(exclude_categories=("Cs", "Cn"), exclude_characters="\ufeff"), max_size=20) | st.sampled_from(
    ["yes", "No", "~", "null", "1", "0x1f", ".5", "1e3", "-", "a: b", "a #b", "a:", " a", "a ", "'", '"', "it's", "{robot}", "[1]", "*a", "&a", "!a", "%a",
     "@a", "`a`", "|", ">", "10.0.0.1", "30s", "a\nb", "\t", "\\", "a,b", "#", "<<", "", "''\"", "a''b"]
)  # fmt: skip
VALUES = st.recursive(
    TEXTS | st.booleans() | st.integers(-(2**40), 2**40),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=5,
)


@settings(max_examples=40, deadline=None)
@given(name=TEXTS, value=VALUES)
def test_a_file_reads_as_it_was_meant(name: str, value: object) -> None:
    entry = FileEntry(name=name, values={"command": value}, comments=("a\nb: \x00",))
    text = render_file(FileText(comments=(), keys={"version": 1}, sections={"tasks": [entry]}))
    problems = Problems()
    node = parse_yaml(Source(file="x", text=text, lines=tuple(text.split("\n"))), problems)
    assert node is not None, (text, problems.errors)
    assert value_from_node(node) == {"version": 1, "tasks": {name: {"command": value}}}, text


def test_words_reach_the_program_through_the_shell(tmp_path: Path) -> None:
    for name in ("rospack", "ros2"):
        (tmp_path / name).write_text('#!/bin/sh\neval "last=\\${$#}"\necho "/opt/ros/share/$last"\n')
        (tmp_path / name).chmod(0o755)
    words = ["a b", "$HOME", "`id`", "it's", '"', "\\", "*", "~", "", "#x", "a=b;c", "x\ny", "{a,b}", "!!",
             "\ue000share:maps\ue001/a $b`c`\"\\.yaml", "x:=\ue000prefix:maps\ue001"]  # fmt: skip
    for version in (1, 2):
        done = subprocess.run(
            ["bash", "-c", f"printf '%s\\0' {join_words(words, version)}"],
            env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
            capture_output=True,
            text=True,
            check=True,
        )
        expected = [*words[:-2], '/opt/ros/share/maps/a $b`c`"\\.yaml', "x:=/opt/ros/share/maps"]
        assert done.stdout.split("\0")[:-1] == expected


def test_the_output_of_a_command_becomes_a_parameter(tmp_path: Path) -> None:
    """``rosparam load -`` reads YAML: a file of a robot with colons and quotes in it must stay one text."""
    (tmp_path / "rosparam").write_text('#!/bin/sh\necho "$*"; cat\n')
    (tmp_path / "rosparam").chmod(0o755)
    text = "<robot name='a: b # c'>\n  \"x\" $HOME \\n\n</robot>"
    (tmp_path / "a b.xacro").write_text(text + "\n")
    env = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        step = build_computed_step("/lab/robot_description", words)
        return subprocess.run(["bash", "-c", step], env=env, capture_output=True, text=True, check=False)

    done = run("cat", str(tmp_path / "a b.xacro"))
    first, _, rest = done.stdout.partition("\n")
    assert (first, json.loads(rest)) == ("load - /lab", {"robot_description": text})
    assert run("cat", str(tmp_path / "missing")).returncode != 0


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3 - -4 % 3", 1 + 2 * 3 - -4 % 3),
        ("'a' + 'b' if 1 < 2 <= 2 else 0", "ab"),
        ("not x or y and 'z'", "z"),
        ("max(1, 2)[0] if False else [1, 2][-1]", 2),
        ("round(sin(pi / 2), 2)", 1.0),
        ("'a,b'.split(',')[1].upper()", "B"),
        ("true and not false", True),
    ],
)  # fmt: skip
def test_the_value_of_an_expression(text: str, value: object) -> None:
    assert evaluate_expression(text, {"x": 1, "y": 2}, {}) == value


@pytest.mark.parametrize(
    "text",
    ["open('/etc/passwd')", "().__class__", "[x for x in 'a']", "lambda: 1", "(1).real", "'%s' % 1", "f'{1}'", "x := 1", "~1", "1 << 99999",
     "'a'.format(1)", "'a'.join(['b'])", "10 ** 1000", "2 ** 999 ** 2", "[0] * 10 ** 9", "-" * 900 + "1", "(" * 900, "len()", "'a' < 1", "max(1, key=2)",
     "{}.a", "*[1]", "a", "'\\ud800' + 1", "1 if"],
)  # fmt: skip
def test_everything_else_is_refused(text: str) -> None:
    with pytest.raises(ExpressionError):
        evaluate_expression(text, {}, {})
