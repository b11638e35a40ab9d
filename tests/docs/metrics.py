# SPDX-License-Identifier: Apache-2.0
"""The list in docs/concepts/metrics.md, made from the code: ``python -m tests.docs.metrics`` writes it."""

import re
from pathlib import Path

from edgectl.export.metrics import METRICS

PAGE = Path(__file__).parents[2] / "docs" / "concepts" / "metrics.md"
_LIST = re.compile(
    r"(?<=<!-- made from the code: begin -->\n).*?(?=<!-- made from the code: end -->)", re.DOTALL
)


def page() -> str:
    """The page as it should stand."""
    rows = ["| metric | labels | kind | meaning |", "|---|---|---|---|"]
    rows += [
        f"| `{metric.name}` | {', '.join(f'`{label}`' for label in metric.labels)} | {metric.kind} | {metric.help} |"
        for metric in METRICS
    ]
    text, count = _LIST.subn("\n".join(rows) + "\n", PAGE.read_text())
    assert count == 1, "the list has its place once"
    return text


if __name__ == "__main__":
    PAGE.write_text(page())
