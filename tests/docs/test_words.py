# SPDX-License-Identifier: Apache-2.0
"""Words that no page uses, each with the one that readers of kubectl, Terraform and ROS expect."""

import re
from pathlib import Path

import pytest

from tests.views.fixtures import ROOT

DOCS = ROOT / "docs"
# Records keep the words of their day; the pages of measurements are written with their figures.
LEFT_OUT = ("adr", "evaluation", "evaluation.md", "performance.md", "predicted-latency.md", "changelog.md")
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


def test_a_word_of_the_list_is_found_with_its_line() -> None:
    text = "A task\ngoes on, `goes on`.\n\n```text\nnobody\n```\n\n- Nobody [knows](to-be-had.md).\n"
    assert find_words(text) == ["2: goes on", "8: Nobody"]
