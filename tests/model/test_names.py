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


@pytest.mark.parametrize(
    ("names", "among", "message", "hint"),
    [
        (["slma", "edge1", "nvg", "slma"], ["slam", "nav", "edge1"], "unknown tasks 'slma', 'nvg'",
         "did you mean slam for slma, nav for nvg?"),
        (["slma", "zz"], ["slam", "nav"], "unknown tasks 'slma', 'zz'", "did you mean slam for slma? known: slam, nav"),
        (["yy", "zz"], ["slam"], "unknown tasks 'yy', 'zz'", "known: slam"),
        (["yy", "zz"], [], "unknown tasks 'yy', 'zz'", "there is no task"),
    ],
)  # fmt: skip
def test_unknown_names_are_named_all_at_once(
    names: list[str], among: list[str], message: str, hint: str
) -> None:
    with pytest.raises(UsageError) as caught:
        check_known_names(names, among, "task")
    assert (caught.value.message, caught.value.hint) == (message, hint)
    with pytest.raises(UsageError, match="unknown ends of a link 'yy', 'zz'"):
        check_known_names(["yy", "zz"], among, "end of a link")


def test_names_that_exist_pass() -> None:
    check_known_names(["b", "a"], ["a", "b"], "host")
