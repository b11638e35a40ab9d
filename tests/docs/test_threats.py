# SPDX-License-Identifier: Apache-2.0
"""The tests that the page of threats names as its proofs."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "concepts" / "threats.md"
HEAD = "| attack | result | test |\n|---|---|---|\n"


def test_each_attack_names_a_test() -> None:
    rows = [row for table in PAGE.read_text().split(HEAD)[1:] for row in table.split("\n\n")[0].splitlines()]
    assert len(rows) >= 25
    assert [row for row in rows if not re.search(r"`tests/[^`]+`|the same", row.split(" | ")[2])] == []


def test_each_test_that_is_named_is_there() -> None:
    """`FILE`, or `FILE::NAME` of a function in it."""
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", PAGE.read_text())
    assert [
        (path, name) for path, name in named if f"def {name or 'test_'}" not in (ROOT / path).read_text()
    ] == []
