# SPDX-License-Identifier: Apache-2.0
"""The median is that of the standard library."""

from statistics import median

from hypothesis import given
from hypothesis import strategies as st

from edgectl.rules.median import compute_median


@given(st.lists(st.floats(allow_nan=False, min_value=-1e9, max_value=1e9), min_size=1))
def test_the_median_is_the_same_number(values: list[float]) -> None:
    assert compute_median(values) == median(values)
