# SPDX-License-Identifier: Apache-2.0
"""Help that fits a screen, one line per flag, and a current reference page."""

import re

import pytest

from edgectl.cli.app import COMMANDS, GROUP_HELP
from tests.docs.reference import PAGE, help_of, page


def read_help(command: str) -> str:
    return help_of(command.split())


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_each_command(command: str) -> None:
    lines = read_help(command).splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    options = lines[lines.index("Options:") + 1 :]
    options = options[: options.index("")]
    assert all(re.match(r"  -[-\w]", line) for line in options), "one line per flag"
    examples = lines[lines.index("  Examples:") + 1 :]
    assert 1 <= len(examples) <= 4
    assert all(line.startswith("    edgectl ") and f"edgectl {command}" in line for line in examples)


@pytest.mark.parametrize("group", GROUP_HELP)
def test_help_of_each_group_ends_with_examples(group: str) -> None:
    lines = read_help(group).splitlines()
    assert max(map(len, lines)) <= 80
    examples = lines[lines.index("  Examples:") + 1 :]
    assert 1 <= len(examples) <= 4
    assert all(line.startswith(f"    edgectl {group}") for line in examples)


def test_every_function_of_a_command_is_listed_once() -> None:
    assert list(COMMANDS) == list(dict.fromkeys(COMMANDS))
    assert all(entry.help.endswith(".") and len(entry.help) <= 70 for entry in COMMANDS.values())


def test_one_letter_has_one_meaning_in_all_commands() -> None:
    meanings: dict[str, set[str]] = {}
    for letter, name in re.findall(r"^  -(\w), --([\w-]+)", PAGE.read_text(), re.MULTILINE):
        meanings.setdefault(letter, set()).add(name)
    assert (meanings["w"], meanings["W"]) == ({"watch"}, {"weights"})
    del meanings["n"]  # how many: lines, runs, repetitions
    assert [names for names in meanings.values() if len(names) > 1] == []


def test_the_reference_page_is_current() -> None:
    assert PAGE.read_text() == page(), "run: python -m tests.docs.reference"
