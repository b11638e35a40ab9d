# SPDX-License-Identifier: Apache-2.0
"""Tables of pages in Markdown."""

from collections.abc import Iterable, Sequence


def render_table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """The first column names its row and stands left, the others are figures and stand right."""
    marks = ("---", *["---:"] * (len(heading) - 1))
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (heading, marks, *rows))
