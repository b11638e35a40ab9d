"""Student's t distribution: tail and quantile, for any positive number of degrees of freedom (pure)."""

from functools import lru_cache
from math import exp, inf, isinf, lgamma, log, log1p

_PRECISION, _LEAST = 1e-15, 1e-300
_MAX_TERMS, _MAX_HALVINGS = 500, 200


def compute_t_tail(t: float, freedom: float) -> float:
    """P(T > t), by the regularized incomplete beta function (DLMF 8.17): relative error below 1e-8.

    Raises:
        ValueError: ``freedom`` is not above 0.
    """
    if not freedom > 0:
        raise ValueError(f"degrees of freedom must be above 0, got {freedom!r}")
    if t < 0:
        return 1.0 - compute_t_tail(-t, freedom)
    if isinf(t):
        return 0.0
    return 0.5 * _compute_incomplete_beta(freedom / (freedom + t * t), freedom / 2, 0.5)


@lru_cache(maxsize=1024)
def compute_t_quantile(probability: float, freedom: float) -> float:
    """The t with P(T <= t) = ``probability``, which lies between 0 and 1: within 1e-12 of it.

    Raises:
        ValueError: ``probability`` is not between 0 and 1, or ``freedom`` is not above 0.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"a probability must be between 0 and 1, got {probability!r}")
    if probability < 0.5:
        return -compute_t_quantile(1.0 - probability, freedom)
    tail, low, high = 1.0 - probability, 0.0, 1.0
    while compute_t_tail(high, freedom) > tail:
        low, high = high, 2.0 * high
        if isinf(high):
            return inf
    for _ in range(_MAX_HALVINGS):
        middle = (low + high) / 2
        if high - low <= 1e-13 * high:
            break
        low, high = (middle, high) if compute_t_tail(middle, freedom) > tail else (low, middle)
    return (low + high) / 2


def _compute_incomplete_beta(x: float, a: float, b: float) -> float:
    """I_x(a, b) in 0..1; by symmetry where its continued fraction converges slowly."""
    if x <= 0.0 or x >= 1.0:
        return min(1.0, max(0.0, x))
    front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log(x) + b * log1p(-x))
    if x < (a + 1) / (a + b + 2):
        return front * _compute_beta_fraction(x, a, b) / a
    return 1.0 - front * _compute_beta_fraction(1.0 - x, b, a) / b


def _compute_beta_fraction(x: float, a: float, b: float) -> float:
    """The continued fraction of DLMF 8.17.22, by the method of Lentz as Thompson and Barnett changed it."""
    c, d = 1.0, 1.0 / _keep_from_zero(1.0 - (a + b) * x / (a + 1))
    found = d
    for term in range(1, _MAX_TERMS):
        twice = a + 2 * term
        for numerator in (
            term * (b - term) * x / ((twice - 1) * twice),
            -(a + term) * (a + b + term) * x / (twice * (twice + 1)),
        ):
            d = 1.0 / _keep_from_zero(1.0 + numerator * d)
            c = _keep_from_zero(1.0 + numerator / c)
            found *= c * d
        if abs(c * d - 1.0) < _PRECISION:
            break
    return found


def _keep_from_zero(value: float) -> float:
    return value if abs(value) > _LEAST else _LEAST
