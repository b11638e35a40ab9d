# SPDX-License-Identifier: Apache-2.0
"""Sketch of many values (ms) in a bounded number of logarithmic buckets; what both sides run (ADR 0117).

A bucket holds the values from one bound to the next, 2 % above it; a quantile is told by the middle of its
bucket, so it is at most 1 % off. Sketches of the same buckets merge by adding them up.
"""

import math

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Iterable, Mapping

# Relative error of a quantile of values from LEAST_MS to MOST_MS; others count in the first and last bucket.
ERROR = 0.01
LEAST_MS, MOST_MS = 0.1, 100000.0
_GROWTH = (1.0 + ERROR) / (1.0 - ERROR)
_LOG_GROWTH = math.log(_GROWTH)
BUCKETS = 1 + int(math.ceil(math.log(MOST_MS / LEAST_MS) / _LOG_GROWTH))


def find_bucket(value_ms: float) -> int:
    """Find the index of the bucket of a value: 0 up to `LEAST_MS`, the last one above `MOST_MS`."""
    if not value_ms > LEAST_MS:
        return 0
    return min(BUCKETS - 1, int(math.ceil(math.log(value_ms / LEAST_MS) / _LOG_GROWTH - 1e-9)))


def get_bound_ms(bucket: int) -> float:
    """The highest value (ms) of a bucket."""
    return LEAST_MS * _GROWTH**bucket


def get_middle_ms(bucket: int) -> float:
    """The value (ms) that is at most `ERROR` from every value of the bucket."""
    return LEAST_MS if bucket == 0 else 2.0 * get_bound_ms(bucket) / (1.0 + _GROWTH)


def find_quantile(buckets: "Mapping[int, int]", share: float) -> "float | None":
    """Find the value (ms) that ``share`` of all values do not exceed (nearest rank); None without values."""
    total = sum(buckets.values())
    if not total:
        return None
    rank, seen = max(1, int(math.ceil(share * total - 1e-9))), 0
    for bucket in sorted(buckets):
        seen += buckets[bucket]
        if seen >= rank:
            return get_middle_ms(bucket)
    return None


def merge_buckets(sketches: "Iterable[Mapping[int, int]]") -> "dict[int, int]":
    """Add up sketches."""
    total = {}  # type: dict[int, int]
    for sketch in sketches:
        for bucket, count in sketch.items():
            total[bucket] = total.get(bucket, 0) + count
    return total
