# SPDX-License-Identifier: Apache-2.0
"""Words that no page, help or message uses, each with the one that readers of kubectl, Terraform and ROS expect."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.views.fixtures import ROOT

DOCS = ROOT / "docs"
# Records keep the words of their day; pages of measurements and of the model are written with their results.
LEFT_OUT = (
    "adr",
    "model",
    "evaluation",
    "evaluation.md",
    "performance.md",
    "predicted-latency.md",
    "changelog.md",
)
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(
        page for page in DOCS.rglob("*.md") if not set(page.relative_to(DOCS).parts).intersection(LEFT_OUT)
    ),
]
# Programs, hosts and tasks do not speak, hear, want or know; a page states, shows, reports, continues, fixes.
WORDS = {
    r"(goes|going|went|go) on": "continue",
    r"(mend|mends|mended|mending)": "fix",
    r"(says|tells|told)": "reports, shows, states; receives",
    r"(hears|wants|learns)": "receives; needs; gets",
    r"(nobody|somebody)": "no one, someone; or name who",
    r"shall": "should, or the present tense",
    r"anew": "again",
    r"to and fro": "back and forth",
    r"to be had": "available",
    r"all the same": "still",
    r"(take|takes|taken) along": "transfer",
    r"so (much|many|often)": "this much, or the number",
    r"(is|are) to be": "must be, or the imperative",
    r"at the begin": "at the start",
    r"strangers?": "another program, host or user",
    r"is no (certified )?safety function": "is not a safety function",
}
PATTERN = re.compile(rf"(?<![\w-])(?:{'|'.join(WORDS)})(?![\w-])", re.IGNORECASE)


def list_messages(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """The texts of a module that are no docstrings, by line: messages, hints, headings, help of options."""
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.lineno, node.value


def find_words(text: str) -> list[str]:
    """The words of the list in the prose of a page, each with its line; code and links are no prose."""
    text = re.sub(r"^( *)```.*?^ *```$", blank_lines, text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"`[^`]*`|\]\([^)]*\)", blank_lines, text)
    return [
        f"{text.count(chr(10), 0, found.start()) + 1}: {' '.join(found[0].split())}"
        for found in PATTERN.finditer(text)
    ]


def blank_lines(code: re.Match[str]) -> str:
    return "\n" * code[0].count("\n")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_page_uses_a_word_of_the_list(page: Path) -> None:
    found = find_words(page.read_text())
    assert found == [], [f"better: {better}" for better in WORDS.values()]


def test_no_help_of_a_command_uses_a_word_of_the_list() -> None:
    assert [found[0] for found in PATTERN.finditer((DOCS / "cli.md").read_text())] == []


def test_no_message_uses_a_word_of_the_list() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in sorted((ROOT / "edgectl").rglob("*.py"))
        for line, text in list_messages(ast.parse(path.read_text()))
        if " " in text and PATTERN.search(text)
    ]
    assert found == []


def test_texts_are_messages_and_docstrings_are_not() -> None:
    code = 'def f():\n    """It says."""\n    raise E(f"{x} goes on", hint="nobody knows")\n'
    found = [text for _, text in list_messages(ast.parse(code)) if PATTERN.search(text)]
    assert found == [" goes on", "nobody knows"]


def test_a_word_of_the_list_is_found_with_its_line() -> None:
    text = "A task\ngoes on, `goes on`.\n\n```text\nnobody\n```\n\n- Nobody [knows](to-be-had.md).\n"
    assert find_words(text) == ["2: goes on", "8: Nobody"]
