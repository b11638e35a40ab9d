# SPDX-License-Identifier: Apache-2.0
"""Sketch of latencies: its error, its bounds, and that parts add up to the whole."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.agent.link import sketch

VALUES = st.lists(st.floats(0.11, 99_000.0), min_size=1, max_size=300)
SHARES = (0.0, 0.5, 0.95, 0.99, 1.0)


def count(values: list[float]) -> dict[int, int]:
    return sketch.merge_buckets({sketch.find_bucket(value): 1} for value in values)


def find_exact(values: list[float], share: float) -> float:
    return sorted(values)[max(1, math.ceil(share * len(values) - 1e-9)) - 1]


@given(VALUES)
def test_a_quantile_is_at_most_one_percent_off(values: list[float]) -> None:
    for share in SHARES:
        found = sketch.find_quantile(count(values), share)
        assert found == pytest.approx(find_exact(values, share), rel=sketch.ERROR * 1.0001)


@given(VALUES, VALUES)
def test_sketches_of_parts_merge_to_that_of_all(one: list[float], other: list[float]) -> None:
    assert sketch.merge_buckets([count(one), count(other)]) == count(one + other)


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e300, max_value=1e300))
def test_every_value_has_one_of_the_buckets(value: float) -> None:
    bucket = sketch.find_bucket(value)
    assert 0 <= bucket < sketch.BUCKETS
    if sketch.LEAST_MS < value < sketch.MOST_MS:
        assert sketch.get_bound_ms(bucket - 1) < value * (1 + 1e-8)
        assert value <= sketch.get_bound_ms(bucket) * (1 + 1e-8)


def test_without_values_there_is_no_quantile() -> None:
    assert sketch.find_quantile({}, 0.5) is None


def test_values_out_of_range_count_at_its_ends() -> None:
    assert [sketch.find_bucket(value) for value in (-5.0, 0.0, 0.1, 1e9)] == [0, 0, 0, sketch.BUCKETS - 1]
    assert sketch.find_quantile({0: 1}, 0.5) == 0.1
