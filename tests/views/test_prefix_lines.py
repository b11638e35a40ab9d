# SPDX-License-Identifier: Apache-2.0
"""Lines of a log with the name of their task, however the log is cut into parts."""

from random import Random

from edgectl.views.text import prefix_lines

TEXT = "one\n\nthree\u2028still three\nhalf"


def test_each_line_has_the_prefix_once_wherever_the_parts_are_cut() -> None:
    expected = "> one\n> \n> three\u2028still three\n> half\n"
    dice = Random(7)
    for _ in range(50):
        cuts = sorted(dice.sample(range(len(TEXT)), 4))
        parts = [TEXT[start:end] for start, end in zip([0, *cuts], [*cuts, len(TEXT)], strict=True)]
        assert "".join(prefix_lines(parts, "> ")) == expected


def test_nothing_is_added_to_nothing_or_to_an_ended_text() -> None:
    assert list(prefix_lines(["", ""], "> ")) == []
    assert "".join(prefix_lines(["a\n", ""], "> ")) == "> a\n"
