# SPDX-License-Identifier: Apache-2.0
"""Logs without what drives a terminal, wherever their parts are cut."""

import pytest

from edgectl.views.text import clean_log_text, decode_log

CASES = {
    "\x1b[1;31mred\x1b[0m\n": "red\n",
    "\x1b[38:2::1:2:3mx\x1b[?25l\x1b[2 q": "x",
    "\x9b31mred\x9bK": "red",
    "\x1b]0;title\x07a\x1b]8;;http://x\x1b\\link\x1b]8;;\x1b\\": "alink",
    "\x9d2;t\x9cb\x1bPq#0;2\x1b\\c": "bc",
    "\x1b]0;no end\nthe next line\n": "0;no end\nthe next line\n",
    "\x1b(Ba\x1b7\x1b=b\x1bc": "ab",
    "10 %\r20 %\x08\x00\x07\x7f\tend\n": "10 %20 %\tend\n",
    "café\u202egnp\u2028": "café\\u202egnp\\u2028",
    "\x1b[31": "31",
    "\x1b": "",
}


@pytest.mark.parametrize("text", CASES)
def test_nothing_is_left_that_drives_a_terminal_however_it_is_cut(text: str) -> None:
    assert clean_log_text(text) == CASES[text]
    data = text.encode()
    for cut in range(len(data) + 1):
        assert "".join(decode_log([data[:cut], data[cut:]])) == CASES[text]
    single = [data[at : at + 1] for at in range(len(data))]
    assert "".join(decode_log(single)) == CASES[text]
    assert "".join(decode_log(single, raw=True)) == text


def test_a_task_that_begins_a_sequence_and_never_ends_it_withholds_little() -> None:
    said = "".join(decode_log([b"\x1b]" + b"x" * 5000, b"y" * 10]))
    assert said.endswith("y" * 10)
    assert len("".join(decode_log([b"\x1b]"] + [b"x" * 100] * 1000))) >= 100_000


def test_what_is_whole_is_not_held_back() -> None:
    parts = decode_log(iter([b"one\n", b"\x1b[32mtwo\x1b[0m"]))
    assert [next(parts), next(parts)] == ["one\n", "two"]
