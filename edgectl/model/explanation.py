# SPDX-License-Identifier: Apache-2.0
"""Explanation of one decision: the terms behind it and the smallest changes that would reverse it."""

from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Decision
from edgectl.model.policy import PolicyName, Weights


class ChangeKind(StrEnum):
    """The quantity that a flip changes, all else being equal."""

    LOAD_RISES = "load-rises"
    LOAD_FALLS = "load-falls"
    WEIGHT_RISES = "weight-rises"
    WEIGHT_FALLS = "weight-falls"


@dataclass(frozen=True, slots=True, kw_only=True)
class Contribution:
    """One term of eq. (4) at the chosen host and at the runner-up.

    ``lead``: weight x (here - there); the four sum up to the lead.
    """

    term: str
    weight: float
    here: float
    there: float

    @property
    def lead(self) -> float:
        """Contribution of the term to the lead over the runner-up."""
        return self.weight * (self.here - self.there)


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstMove:
    """Another task that a change moves first: to ``host`` (None: nowhere), beyond ``amount``."""

    task: str
    host: str | None
    amount: float


class TieRule(StrEnum):
    """What decides between hosts of equal utility."""

    RUNS_THERE = "runs-there"
    FREE_SHARE = "free-share"
    FEWEST_TASKS = "fewest-tasks"
    NAMES = "order-of-names"


@dataclass(frozen=True, slots=True, kw_only=True)
class Tie:
    """Other hosts with the same utility as the chosen one, and what decided."""

    hosts: tuple[str, ...]
    rule: TieRule


@dataclass(frozen=True, slots=True, kw_only=True)
class Flip:
    """One change after which the task would go to ``winner`` (None: nowhere; its own host: it stays, because
    ``first`` makes way).

    Of a load: ``host``, and ``amount`` of its resource to be exceeded. Of a weight: ``amount`` is the weight
    to be crossed, the others sharing the rest as they share it now. ``size`` compares changes: share of the
    capacity, or of the whole weight (0..). ``unit``: the capacity, 1 for a weight. ``first``: the move of
    another task that comes before, in the whole plan.
    """

    change: ChangeKind
    term: str
    amount: float
    size: float
    winner: str | None
    host: str | None = None
    robot: str | None = None
    unit: float = 1.0
    first: FirstMove | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Explanation:
    """A decision taken apart.

    ``runner_up``: the best other feasible host. ``slack``: by how much the chosen host's total may fall
    before the choice changes, None where no fall changes it. ``noise``: standard deviation of the difference
    of the two totals over the last samples, None where too few are known. ``flips``: smallest first, at most
    one per change, term and host; ``weighed``: whether they were looked for, because the totals decided.
    ``linear``: whether eq. (4) is linear in the load of each link, which it is
    not for a task of several robots. ``tie``: hosts that are equal. ``pin``: the host that the task file
    pins it to. ``deadline_ms`` of the task, where it states one. ``bends``: its predicted latency counts,
    which is not linear in any load. ``rule``: the policy, where it has a rule of its own instead of utilities
    that are weighed against each other.
    """

    decision: Decision
    weights: Weights
    runner_up: str | None = None
    contributions: tuple[Contribution, ...] = ()
    slack: float | None = None
    noise: float | None = None
    flips: tuple[Flip, ...] = ()
    weighed: bool = False
    linear: bool = True
    tie: Tie | None = None
    pin: str | None = None
    deadline_ms: float | None = None
    bends: bool = False
    rule: PolicyName | None = None

    @property
    def fragile(self) -> bool:
        """True where the noise of the measurements alone could change the choice."""
        return self.slack is not None and self.noise is not None and self.slack < self.noise
