"""How to decide: the scheme, the weights and the handoff rules."""

from dataclasses import dataclass
from enum import StrEnum


class PolicyName(StrEnum):
    """The schemes of the paper's comparison, and the paper's rule to the letter."""

    UTILITY = "utility"
    PAPER = "paper"
    STATIC = "static"
    LOCAL = "local"


class SequenceRule(StrEnum):
    """Key by which eligible tasks are ordered."""

    CONNECTIVITY = "connectivity"
    SENSITIVITY = "sensitivity"


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """omega of eq. (4), each in 0..1, normalised to sum 1."""

    cpu: float = 0.25
    memory: float = 0.25
    network: float = 0.25
    task: float = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Policy:
    """Everything that steers a decision besides the fleet and the tasks.

    ``move_margin`` (utility, 0..): a challenger must beat the present host by more. ``min_dwell`` (s): stay at least that long.
    ``max_moves``: voluntary moves per unattended run, None = unlimited. ``attended``: a person looks at the plan, so
    ``max_moves`` does not act. ``best_effort``: place on the highest total even where it does not fit.
    ``full``: keep every host's ranking above 64 hosts. ``without``: hosts left out as candidates (what if).
    """

    name: PolicyName = PolicyName.UTILITY
    weights: Weights = Weights()
    sequence: SequenceRule = SequenceRule.CONNECTIVITY
    move_margin: float = 0.10
    min_dwell: float = 120.0
    max_moves: int | None = 1
    attended: bool = True
    best_effort: bool = False
    full: bool = False
    without: frozenset[str] = frozenset()
