# SPDX-License-Identifier: Apache-2.0
"""Label selectors in kubectl's syntax."""

import pytest

from edgectl.cli.selector import matches_selector
from edgectl.errors import UsageError

LABELS = {"gpu": "maxwell", "lab/room": "b2", "bare": ""}


@pytest.mark.parametrize(
    ("selector", "held"),
    [
        ("gpu=maxwell", True),
        ("gpu==maxwell", True),
        ("gpu = pascal", False),
        ("gpu!=pascal", True),
        ("gpu!=maxwell", False),
        ("missing!=x", True),
        ("gpu in (maxwell,pascal)", True),
        ("gpu in (pascal, volta)", False),
        ("missing in (x)", False),
        ("gpu notin (pascal)", True),
        ("gpu notin (pascal, maxwell)", False),
        ("missing notin (x)", True),
        ("lab/room", True),
        ("!gpu", False),
        ("!missing", True),
        ("bare=", True),
        ("gpu in (pascal,maxwell), lab/room=b2,!missing", True),
        ("gpu in (pascal,maxwell),lab/room!=b2", False),
    ],
)
def test_what_holds(selector: str, held: bool) -> None:
    assert matches_selector(selector, LABELS) is held


@pytest.mark.parametrize(
    "selector",
    [
        "",
        "gpu=maxwell,",
        "gpu in",
        "gpu in maxwell",
        "gpu in (a",
        "!gpu=x",
        "a b",
        "=x",
        "gpu inside (x)",
        "a=b=c",
    ],
)
def test_what_is_none(selector: str) -> None:
    with pytest.raises(UsageError) as caught:
        matches_selector(selector, LABELS)
    assert "a in (b,c)" in caught.value.hint
