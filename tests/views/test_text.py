# SPDX-License-Identifier: Apache-2.0
"""Columns that fit the terminal, and what a stream can show."""

import io

import pytest

from edgectl.views.text import (
    Cell,
    RenderOptions,
    Row,
    compute_remaining_width,
    detect_render_options,
    is_within_width,
    measure_column_widths,
    render_columns,
    wrap_text,
)

ROWS: list[Row] = [
    ("NAME", "STATE", "N", "REASON"),
    (
        Cell("slam-robot1", "name"),
        "failed (5 restarts, last exit 1)",
        "7",
        "it was asked to stop and did not",
    ),
]


def widest(text: str) -> int:
    return max(map(len, text.splitlines()))


def test_nothing_is_wrapped_where_there_is_no_terminal() -> None:
    assert render_columns(ROWS, right={2}).splitlines() == [
        "NAME         STATE                             N  REASON",
        "slam-robot1  failed (5 restarts, last exit 1)  7  it was asked to stop and did not",
    ]


def test_the_last_column_wraps_first() -> None:
    assert render_columns(ROWS, RenderOptions(width=78), right={2}, wrap={1}).splitlines() == [
        "NAME         STATE                             N  REASON",
        "slam-robot1  failed (5 restarts, last exit 1)  7  it was asked to stop and did",
        "                                                  not",
    ]


def test_other_columns_wrap_where_that_is_not_enough() -> None:
    assert render_columns(ROWS, RenderOptions(width=61), right={2}, wrap={1}).splitlines() == [
        "NAME         STATE                N  REASON",
        "slam-robot1  failed (5 restarts,  7  it was asked to stop and",
        "             last exit 1)            did not",
    ]


def test_what_has_no_room_stands_below() -> None:
    assert render_columns(ROWS, RenderOptions(width=52), right={2}).splitlines() == [
        "NAME         STATE                             N",
        "    REASON",
        "slam-robot1  failed (5 restarts, last exit 1)  7",
        "    it was asked to stop and did not",
    ]


@pytest.mark.parametrize("width", range(34, 90))
def test_a_table_with_columns_to_wrap_never_passes_the_edge(width: int) -> None:
    text = render_columns(ROWS, RenderOptions(width=width), right={2}, wrap={0, 1})
    assert widest(text) <= width
    assert sorted("".join(text.split())) == sorted("".join(render_columns(ROWS).split())), "nothing is lost"


def test_lists_break_after_commas_and_names_stay_whole() -> None:
    rows = [("NAME", "NEEDS", "UP"), ("navigation-robot1", "slam-robot1,slam-robot2", "3s")]
    assert render_columns(rows, RenderOptions(width=35), wrap={0, 1}).splitlines() == [
        "NAME               NEEDS         UP",
        "navigation-robot1  slam-robot1,  3s",
        "                   slam-robot2",
    ]


def test_headings_of_several_words_wrap_before_anything_else() -> None:
    rows: list[Row] = [
        (Cell("TASK", "head"), Cell("CPU DEMAND", "head"), Cell("READY", "head")),
        ("slam", "2.00", "yes"),
    ]
    assert render_columns(rows, RenderOptions(width=19), right={1}).splitlines() == [
        "TASK     CPU  READY",
        "      DEMAND",
        "slam    2.00  yes",
    ]


def test_names_stay_whole_in_a_table_that_is_too_wide_all_the_same() -> None:
    rows = [("NAME", "A NUMBER", "UP"), ("navigation-robot1", "0123456789", "3s")]
    assert render_columns(rows, RenderOptions(width=15), wrap={0}) == render_columns(rows)


def test_columns_keep_the_widths_they_had() -> None:
    assert render_columns([("a", "b")], least=[4, 0, 0]) == "a     b\n"


def test_room_beside() -> None:
    assert compute_remaining_width([("abc", "de")], RenderOptions(width=20)) == 20 - 5 - 2 - 2
    assert compute_remaining_width([("abc", "de")], RenderOptions(width=4)) == 0
    assert compute_remaining_width([("abc", "de")], RenderOptions()) == 0
    assert is_within_width([("abc", "de")], RenderOptions(width=7))
    assert not is_within_width([("abc", "de")], RenderOptions(width=6))


def test_a_line_flows() -> None:
    assert wrap_text("one two three", RenderOptions(width=8)) == "one two\n  three\n"
    assert wrap_text("one two three", RenderOptions()) == "one two three\n"


class Stream(io.StringIO):
    """A terminal of some encoding."""

    def __init__(self, encoding: str) -> None:
        super().__init__()
        self._encoding = encoding

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._encoding

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("encoding", "variables", "unicode", "colour"),
    [
        ("utf-8", {}, True, True),
        ("UTF-8", {"NO_COLOR": "1", "FORCE_COLOR": "1"}, True, False),
        ("iso8859-1", {}, False, True),
        ("utf-8", {"NO_UNICODE": "1"}, False, True),
        ("utf-8", {"LC_ALL": "C"}, False, True),
        ("utf-8", {"TERM": "dumb"}, False, False),
    ],
)
def test_what_a_terminal_can_show(
    encoding: str, variables: dict[str, str], unicode: bool, colour: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR", "NO_UNICODE", "LC_ALL", "TERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    look = detect_render_options(Stream(encoding))
    assert (look.unicode, look.colour) == (unicode, colour)
    assert look.width is not None


def test_a_pipe_is_plain() -> None:
    assert detect_render_options(io.StringIO()) == RenderOptions()


def test_a_spare_column_without_values_is_left_out() -> None:
    rows: list[Row] = [
        (Cell("HOST", "head"), Cell("POWER", "spare"), Cell("TASKS", "head"), Cell("REASON", "head")),
        ("edge1", "-", "3", "x"),
        ("edge2",),
    ]
    assert render_columns(rows, right={2}) == "HOST   TASKS  REASON\nedge1      3  x\nedge2\n"
    assert measure_column_widths(rows) == [5, 5, 6]
    rows[1] = ("edge1", "12.0W", "3", "x")
    assert "POWER" in render_columns(rows, right={2})
