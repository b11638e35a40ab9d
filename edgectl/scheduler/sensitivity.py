# SPDX-License-Identifier: Apache-2.0
"""Sensitivity of a choice to one number: eq. (5) with handoff avoidance, where every total is a line.

Along one change x >= 0 each term of each host is a straight line, and so is each total. The choice can only
change where two of these lines cross: there are few such points, and each is known in closed form.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations

from edgectl.dataclass import dataclass
from edgectl.scheduler.utility import EPSILON

# Just beyond a crossing, as a share of the unit: far above rounding, far below anything that is shown.
_BEYOND_CROSSING = 1e-7


@dataclass(frozen=True, slots=True)
class LinearFunction:
    """``at + slope * x``."""

    at: float
    slope: float = 0.0

    def __call__(self, x: float) -> float:
        """The value at ``x``."""
        return self.at + self.slope * x

    def solve_for(self, level: float) -> float | None:
        """The x at which the line reaches ``level``; None where it never does."""
        return (level - self.at) / self.slope + 0.0 if self.slope else None  # never -0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Contender:
    """One candidate: its total, and its terms of eqs. (1)-(3), none below 0 where it fits.

    ``needed``: the gain that a move to it takes. ``slacks``: by how much each term may fall below 0 there.
    """

    host: str
    total: LinearFunction
    terms: tuple[LinearFunction, ...]
    needed: float
    slacks: tuple[float, ...]

    def fits(self, x: float) -> bool:
        """True where the task fits there."""
        return all(term(x) >= -slack - EPSILON for term, slack in zip(self.terms, self.slacks, strict=True))


def find_winner(runners: Sequence[Contender], incumbent: str | None, x: float) -> str | None:
    """The choice at ``x``; ties by the order of ``runners``, which lists them best first.

    None: it fits nowhere and runs nowhere.
    """
    fitting = [runner for runner in runners if runner.fits(x)]
    best = max(fitting, key=lambda runner: runner.total(x), default=None)
    if best is None:
        return incumbent
    here = next((runner for runner in fitting if runner.host == incumbent), None)
    if here is None or best.total(x) - here.total(x) > best.needed + EPSILON:
        return best.host
    return here.host


def find_first_change(
    runners: Sequence[Contender], incumbent: str | None, end: float, unit: float
) -> tuple[float, str | None] | None:
    """The smallest x in [0, ``end``) beyond which the choice is another one, and that choice.

    None where it stays up to ``end``, or up to where nothing fits. ``unit``: how large an x is large (a
    capacity, or 1 for a weight).
    """
    now = find_winner(runners, incumbent, 0.0)
    runs_here = any(runner.host == incumbent for runner in runners)
    for x in sorted({point for point in _list_crossings(runners, incumbent) if 0.0 <= point < end}):
        beyond = x + _BEYOND_CROSSING * unit
        if runs_here and not any(runner.fits(beyond) for runner in runners):
            return None  # the lesser overload decides there, which is not linear
        then = find_winner(runners, incumbent, beyond)
        if then != now:
            return x, then
    return None


def _list_crossings(runners: Sequence[Contender], incumbent: str | None) -> Iterator[float]:
    for runner in runners:
        yield from _drop_missing_points(
            term.solve_for(-slack - EPSILON) for term, slack in zip(runner.terms, runner.slacks, strict=True)
        )
    for one, other in combinations(runners, 2):
        yield from _drop_missing_points([_subtract_totals(one, other).solve_for(0.0)])
    for here in (runner for runner in runners if runner.host == incumbent):
        yield from _drop_missing_points(
            _subtract_totals(other, here).solve_for(other.needed + EPSILON)
            for other in runners
            if other is not here
        )


def _subtract_totals(one: Contender, other: Contender) -> LinearFunction:
    return LinearFunction(one.total.at - other.total.at, one.total.slope - other.total.slope)


def _drop_missing_points(found: Iterable[float | None]) -> Iterator[float]:
    yield from (point for point in found if point is not None)
