# SPDX-License-Identifier: Apache-2.0
"""Ways to fill one place with tasks of few kinds, in NumPy (ADR 78)."""

from collections.abc import Sequence

import numpy as np

from edgectl.dataclass import dataclass
from edgectl.scheduler.array_types import Array
from edgectl.scheduler.utility import EPSILON

# A place that can be filled in more ways is not listed: enumerating would take longer than it saves.
MAX_PATTERNS = 40_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacePatterns:
    """``counts``: tasks by kind, one row for each way to fill the place. ``gains``: of those that stay."""

    counts: Array
    gains: Array

    def find_best(self, prices: Sequence[float]) -> tuple[float, list[int], float]:
        """The way that is worth most where each task costs the price of its kind: that worth, the tasks by
        kind, and their gain.
        """
        worth = self.gains - self.counts @ np.array(prices)
        best = int(np.argmax(worth))
        return float(worth[best]), [int(each) for each in self.counts[best]], float(self.gains[best])


def list_patterns(
    shares: Sequence[Sequence[float]],
    most: Sequence[int],
    limits: Sequence[float],
    homes: Sequence[int],
    gains: Sequence[float],
) -> PlacePatterns | None:
    """All ways to fill a place to which no task of the smallest kind can be added; None: too many.

    By kind: ``shares`` of each column, ``most`` tasks, of which ``homes`` are at home there and gain
    ``gains`` each if they stay. A way with fewer tasks is worth no more.
    """
    order = sorted(range(len(most)), key=lambda kind: -max(shares[kind], default=0.0))
    left = np.array([[max(0.0, limit) for limit in limits]])
    chosen = np.zeros((1, len(most)))
    for position, kind in enumerate(order):
        row = np.array(shares[kind])
        fitting = _count_fitting(left, row, most[kind])
        if position == len(order) - 1:
            chosen[:, kind] = fitting
            break
        if fitting.sum() + len(fitting) > MAX_PATTERNS:
            return None
        repeats = fitting.astype(np.intp) + 1
        source = np.repeat(np.arange(len(left)), repeats)
        number = np.arange(len(source)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        left = left[source] - number[:, None] * row
        chosen = chosen[source]
        chosen[:, kind] = number
    return PlacePatterns(counts=chosen, gains=np.minimum(chosen, np.array(homes)) @ np.array(gains))


def _count_fitting(left: Array, row: Array, most: int) -> Array:
    """How many tasks with the shares ``row`` fit into each row of what is left."""
    needed = row > 0.0
    if not needed.any():
        return np.full(len(left), float(most))
    fitting = np.floor(((left[:, needed] + EPSILON) / row[needed]).min(axis=1))
    found: Array = np.clip(fitting, 0.0, float(most))
    return found
