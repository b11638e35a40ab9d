# SPDX-License-Identifier: Apache-2.0
"""docs/conventions.md: each row names tests that exist, and where another way is taken, the reason."""

import re

import pytest

from tests.views.fixtures import ROOT

ROWS = re.findall(
    r"^\| (.+?) \| (met|other way) \| (.*?) \| (.*?) ?\|$",
    (ROOT / "docs" / "conventions.md").read_text(),
    re.MULTILINE,
)


def test_there_is_a_row_for_each() -> None:
    """51 conventions, of which the one of the importers has five rows."""
    lines = [
        line for line in (ROOT / "docs" / "conventions.md").read_text().splitlines() if line.startswith("| ")
    ]
    assert len(ROWS) == len(lines) - 1 == 51 + 4
    assert len({row[0] for row in ROWS}) == len(ROWS)


@pytest.mark.parametrize(("name", "state", "held", "remark"), ROWS, ids=[row[0][:40] for row in ROWS])
def test_a_row_says_what_holds_it(name: str, state: str, held: str, remark: str) -> None:
    del name
    assert state == "met" or remark, "another way needs its reason"
    for each in held.split(", "):
        file, _, function = each.strip("`").partition("::")
        assert re.search(rf"^def {function}\(", (ROOT / file).read_text(), re.MULTILINE), each
