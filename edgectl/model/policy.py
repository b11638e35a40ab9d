# SPDX-License-Identifier: Apache-2.0
"""The policy of a decision: scheme, weights and handoff rules."""

import math
from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum
from types import MappingProxyType

from edgectl.dataclass import dataclass
from edgectl.model.encoding import in_document
from edgectl.model.resource import AFFINITY, RESOURCES, SPARE_TERMS, TERMS, ResourceMap


class PolicyName(StrEnum):
    """The schemes of the paper's comparison, the paper's rule to the letter, and rules of other schedulers.

    ``static`` places a task once, by utility; ``static-X`` places it once by X (ADR 130).
    """

    UTILITY = "utility"
    PAPER = "paper"
    STATIC = "static"
    STATIC_LEAST_LOADED = "static-least-loaded"
    STATIC_IN_TURN = "static-in-turn"
    STATIC_RANDOM = "static-random"
    STATIC_PACK = "static-pack"
    LOCAL = "local"
    LEAST_LOADED = "least-loaded"
    PACK = "pack"
    RANDOM = "random"


class Preference(StrEnum):
    """Which hosts are better: those with more free resources, or those that are fuller."""

    SPREAD = "spread"
    PACK = "pack"


class SequenceRule(StrEnum):
    """Key by which eligible tasks are ordered."""

    CONNECTIVITY = "connectivity"
    SENSITIVITY = "sensitivity"


_PRESET_RESOURCES = tuple(resource.name for resource in RESOURCES if resource.in_presets)


def _share_evenly(*terms: str) -> dict[str, float]:
    return {term: 1 / len(terms) if term in terms else 0.0 for term in TERMS}


class Weights(ResourceMap[float]):
    """omega of eq. (4) by term, each in 0..1, normalised to sum 1."""

    __slots__ = ()
    DEFAULTS = _share_evenly(*_PRESET_RESOURCES, AFFINITY)
    OMITTED = SPARE_TERMS

    def normalised(self) -> "Weights":
        """The same proportions with sum 1.

        Raises:
            ValueError: a weight is negative or not finite, or all are 0.
        """
        for name, weight in self.items():
            if not math.isfinite(weight) or weight < 0:
                raise ValueError(f"weight {name} must be a finite number, 0 or more, got {weight!r}")
        values = dict(self)
        largest = max(values.values())
        if largest == 0:
            raise ValueError("at least one weight must be more than 0")
        if not math.isfinite(sum(values.values())):
            values = {name: weight / largest for name, weight in values.items()}
        total = math.fsum(values.values())
        return Weights({name: weight / total for name, weight in values.items()})


WEIGHT_PRESETS: Mapping[str, Weights] = MappingProxyType(
    {term: Weights(_share_evenly(term)) for term in TERMS}
    | {"all": Weights(), "resources": Weights(_share_evenly(*_PRESET_RESOURCES))}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Policy:
    """Everything that steers a decision besides the fleet and the tasks.

    ``move_margin`` (utility, 0..): a challenger must beat the present host by more. ``min_dwell`` (s): stay
    at least that long. ``max_moves``: voluntary moves per unattended run, None = unlimited. ``attended``: a
    person looks at the plan, so ``max_moves`` does not act. ``best_effort``: place on the highest total even
    where it does not fit. ``full``: keep every host's ranking above 64 hosts. ``without``: hosts left out as
    candidates (what if). ``prune``: also stop the running tasks of files that were not given (ADR 0039).
    ``prefer``: pack makes the fuller host the better one (ADR 73).
    ``rebalance``: relocate and swap tasks for a greater sum of utilities (ADR 66).
    ``optimal``: find the best plan with a solver, and prove how good it is (ADR 71).
    ``seed``: of the draws of the policies that place at random (ADR 130).
    ``terms``: the plugins whose ratings make UT_rating (ADR 149).
    """

    name: PolicyName = field(default=PolicyName.UTILITY, metadata=in_document("policy", required=True))
    weights: Weights = field(default=Weights(), metadata=in_document(required=True))
    sequence: SequenceRule = field(
        default=SequenceRule.CONNECTIVITY, metadata=in_document("options.sequence", required=True)
    )
    move_margin: float = field(default=0.10, metadata=in_document("options.move_margin", required=True))
    min_dwell: float = field(default=120.0, metadata=in_document("options.min_dwell_s", required=True))
    max_moves: int | None = field(default=1, metadata=in_document("options.max_moves", always=True))
    attended: bool = field(default=True, metadata=in_document("options.attended", required=True))
    best_effort: bool = field(default=False, metadata=in_document("options.best_effort", required=True))
    full: bool = field(default=False, metadata=in_document("options.full", required=True))
    without: frozenset[str] = field(default=frozenset(), metadata=in_document("options.without", always=True))
    prune: bool = field(default=False, metadata=in_document("options.prune"))
    rebalance: bool = field(default=False, metadata=in_document("options.rebalance"))
    optimal: bool = field(default=False, metadata=in_document("options.optimal"))
    prefer: Preference = field(default=Preference.SPREAD, metadata=in_document("options.prefer"))
    seed: int = field(default=0, metadata=in_document("options.seed"))
    terms: tuple[str, ...] = field(default=(), metadata=in_document("options.terms"))
