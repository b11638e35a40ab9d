# SPDX-License-Identifier: Apache-2.0
"""Unknown names are rejected by every command in the same way."""

import pytest

from edgectl.errors import UsageError
from edgectl.names import check_known_names, suggest_name


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("edgy1", "edge1"),
        ("EDGE2", "Edge2"),
        ("slam-robt1", "slam-robot1"),
        ("nosuch", ""),
        ("", ""),
        ("edge1" * 1000, ""),
    ],
)
def test_the_nearest_name_is_the_one_that_was_meant(word: str, meant: str) -> None:
    assert suggest_name(word, ["edge1", "Edge2", "slam-robot1"]) == meant


@pytest.mark.parametrize(
    ("among", "hint"),
    [
        (["edge1", "edge2"], "did you mean edge1?"),
        (["edgy1-of-the-roof"], "did you mean edgy1-of-the-roof?"),
        (["jetson"], "known: jetson"),
        (
            [f"host{number}" for number in range(20)],
            "known: " + ", ".join(f"host{number}" for number in range(12)) + ", ..",
        ),
        ([], "there is no host"),
    ],
)
def test_an_unknown_name_is_refused_with_what_mends_it(among: list[str], hint: str) -> None:
    with pytest.raises(UsageError) as caught:
        check_known_names(["edgy1"], among, "host")
    assert (caught.value.message, caught.value.hint) == ("unknown host 'edgy1'", hint)


def test_names_that_exist_pass() -> None:
    check_known_names(["b", "a"], ["a", "b"], "host")
