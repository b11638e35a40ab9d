"""Equations (1)-(4) of the paper, each once, with nothing else in it."""

from edgectl.model.assignment import Terms
from edgectl.model.policy import Weights

# Two utilities closer than this are equal; a term this little below 0 still fits (DESIGN 5, 5.5).
EPSILON = 1e-9


def resource_utility(capacity: float, expected: float, demand: float) -> float:
    """Share of ``capacity`` left after placing ``demand``; eqs. (1)-(3), ADR 0002 and 0004.

    UT = (Delta - gamma - rho) / Delta, all in one unit (cores, bytes or bytes/s), capacity > 0.
    At most 1, falling as load or demand rises, negative where overcommitted.
    """
    return (capacity - expected - demand) / capacity


def total_utility(weights: Weights, terms: Terms) -> float | None:
    """Weighted sum of the four terms, eq. (4); None where a term is missing. Between the least and the greatest term."""
    if terms.cpu is None or terms.memory is None or terms.network is None or terms.task is None:
        return None
    return weights.cpu * terms.cpu + weights.memory * terms.memory + weights.network * terms.network + weights.task * terms.task
