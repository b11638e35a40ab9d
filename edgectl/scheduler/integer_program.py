# SPDX-License-Identifier: Apache-2.0
"""Mixed integer linear programs, and what a solver says of one. Pure: no solver is imported here."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from math import inf
from typing import NamedTuple

from edgectl.dataclass import dataclass


class Row(NamedTuple):
    """``lower`` <= sum of coefficient x variable <= ``upper``."""

    lower: float
    upper: float
    variables: Sequence[int]
    coefficients: Sequence[float]


@dataclass(slots=True, kw_only=True)
class IntegerProgram:
    """Maximise the sum of gain x variable under rows; each variable is in 0..its upper bound.

    A variable that is not whole may have any value. ``start``: values by variable of a known solution.
    """

    gains: list[float] = field(default_factory=list)
    uppers: list[float] = field(default_factory=list)
    whole: list[bool] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    start: dict[int, float] = field(default_factory=dict)

    def add_variable(self, gain: float = 0.0, upper: float = 1.0, *, whole: bool = True) -> int:
        """Add a variable; returns its number."""
        self.gains.append(gain)
        self.uppers.append(upper)
        self.whole.append(whole)
        return len(self.gains) - 1

    def add_row(self, terms: Mapping[int, float], *, lower: float = -inf, upper: float = inf) -> None:
        """Add a row; ``terms``: coefficients by variable."""
        self.rows.append(Row(lower, upper, tuple(terms), tuple(terms.values())))


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """What a solver found before its deadline.

    ``values``: of all variables, None without a solution. ``bound``: no solution has a greater objective
    (-inf: there is no solution, inf: nothing is known). ``timed_out``: it might have found more with more
    time, so another run may. ``duals``: the price of each row, of programs without whole variables.
    """

    values: Sequence[float] | None
    bound: float
    timed_out: bool = False
    duals: Sequence[float] | None = None


# Solves a program within a share (0..1) of the time that it has left.
Solver = Callable[[IntegerProgram, float], Solution]
