# SPDX-License-Identifier: Apache-2.0
"""Slack (ADR 61, ADR 83): by how much the load of a host may exceed its capacity before a task must leave.

All figures are shares of the capacity.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import sqrt

from edgectl.model.resource import Resource
from edgectl.rules.median import compute_median

# Too little CPU or network makes a task slower; too little memory ends it.
COMPRESSIBLE_SLACK, MEMORY_SLACK = 0.05, 0.02
# So many times its own noise a host may exceed its capacity, and so many times the slack of a quiet host.
NOISE_FACTOR, MOST_FACTOR = 2.0, 3.0
# The newest readings by which noise is measured, and the least number that counts.
MAX_READINGS, MIN_READINGS = 60, 10
# Of the difference of two readings with a standard deviation of 1: the median of its amount. The second
# factor is the third quartile, statistics.NormalDist().inv_cdf(0.75).
_MEDIAN_DIFFERENCE = sqrt(2.0) * 0.6744897501960817


def estimate_noise(readings: Sequence[float]) -> float:
    """The standard deviation of ``readings`` (in their order) around their course; 0 where they are too few.

    By the median difference of two in a row: a task that starts or ends changes one of them.
    """
    if len(readings) < MIN_READINGS:
        return 0.0
    differences = [abs(after - before) for before, after in pairwise(readings)]
    return compute_median(differences) / _MEDIAN_DIFFERENCE


def compute_slack(resource: Resource, noise: float = 0.0) -> float:
    """The share of its capacity by which ``resource`` may be exceeded on a host with this ``noise``."""
    least = COMPRESSIBLE_SLACK if resource.compressible else MEMORY_SLACK
    return min(max(least, NOISE_FACTOR * noise), MOST_FACTOR * least)
