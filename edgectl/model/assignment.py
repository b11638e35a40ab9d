# SPDX-License-Identifier: Apache-2.0
"""Decisions of the scheduler: a host, numbers and a reason for each task.

Nothing is recomputed for display.
"""

from collections.abc import Mapping, Sequence
from dataclasses import field
from enum import StrEnum
from typing import Annotated

from edgectl.dataclass import dataclass
from edgectl.model.encoding import Bounds, Instant, Positive, Signed, SignedInt, in_document
from edgectl.model.policy import Policy
from edgectl.model.predicted_latency import PredictedLatency
from edgectl.model.resource import RATING, SPARE_TERMS, TERMS, Resource, ResourceMap, Usage
from edgectl.model.standby_plan import StandbyStep


class RejectionRule(StrEnum):
    """Rule that excludes a host as a candidate, or as feasible."""

    UNREACHABLE = "unreachable"
    CORDONED = "cordoned"
    WITHOUT = "without"
    STALE = "stale"
    NOT_ONLY = "not-in-only"
    NEVER = "never"
    LABELS = "labels"
    PIN = "pinned-elsewhere"
    ONBOARD = "onboard"
    NO_ENGINE = "no-container-engine"
    NO_LINK = "no-link"
    NO_CAPACITY = "no-capacity"
    INSUFFICIENT = "insufficient"
    APART = "apart"
    TOGETHER = "together"
    SPREAD = "spread"
    DEADLINE_MISSED = "deadline-missed"
    NOT_LISTED = "not-in-inventory"


class DemandSource(StrEnum):
    """Source of a demand.

    ``MEASURED_ELSEWHERE``: on another class of hosts, because nothing is known of this one.
    """

    DECLARED = "declared"
    MEASURED = "measured"
    MEASURED_ELSEWHERE = "measured-elsewhere"
    NONE = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class ResourceDemand:
    """One demand of a task on one host, (network: on its largest link), as it was charged.

    ``samples``: how many there are of the task on that class of hosts; None where the demand does not follow
    history. ``demanded``: the demand, where the task was charged with its greater measured usage.
    """

    resource: Resource
    value: float
    source: DemandSource
    samples: int | None = None
    demanded: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DemandSpread:
    """A percent demand (``share``) of a task that means ``least`` on one candidate and ``most`` on another.

    ``task`` is its name in the file. ``hosts``: the host of the least and of the most.
    """

    task: str
    resource: Resource
    share: float
    least: float
    most: float
    hosts: tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Overuse:
    """What ``task`` uses of ``resource`` on ``host``, and what its file declares, in its unit.

    ``entry``: its name in the file. Of the network, on the link where it is most above.
    """

    task: str
    entry: str
    host: str
    resource: Resource
    used: float
    declared: float

    def describe(self) -> str:
        """Both figures, and the remedy."""
        unit = self.resource.unit
        used, declared = unit.format_in_text(self.used), unit.format_in_text(self.declared)
        return f"uses {used} of {self.resource}, declares {declared}; edgectl profile {self.entry} --write"

    def describe_run(self) -> str:
        """The same of the task on its host."""
        return f"{self.task} on {self.host} {self.describe()}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Shortage:
    """What all edges together lack of ``resource``, in its unit (> 0): the least that would help."""

    resource: Resource
    amount: Positive

    def describe(self) -> str:
        """``short of 1.3 cores of cpu; the least that would help``."""
        amount = self.resource.unit.format_in_text(self.amount)
        return f"the edges are short of {amount} of {self.resource}: the least that would help"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejection:
    """One reason against one host.

    ``task``: the other task that the rule is about. The last three fields are rho, gamma and Delta in the
    resource's own unit; of a deadline that is missed, ``demand`` is the predicted p95 and ``capacity`` the
    deadline, both in ms.
    """

    rule: RejectionRule
    resource: Resource | None = None
    robot: str | None = None
    task: str | None = None
    demand: Signed | None = None
    used: Signed | None = None
    capacity: Signed | None = None


# UT_rating of a host that no plugin rates: neither good nor bad.
NO_RATING = 0.5


class UtilityTerms(ResourceMap[Signed | None]):
    """UT_k of every resource (eqs. 1-3), UT_task, UT_latency and UT_rating.

    At most 1, negative where overcommitted, None without capacity. UT_latency: 1 where nothing is predicted;
    of an optional resource: 1 where the host is not limited by it. UT_rating: 0.5 where no plugin rates the
    host.
    """

    __slots__ = ()
    DEFAULTS = dict.fromkeys(TERMS, None) | dict.fromkeys(SPARE_TERMS, 1.0) | {RATING: NO_RATING}
    OMITTED = SPARE_TERMS


@dataclass(frozen=True, slots=True, kw_only=True)
class RankedHost:
    """One candidate of one task. ``rank`` counts from 1 over feasible hosts by total, 0 where not feasible.

    ``affinity`` is a(h): predecessors here minus predecessors elsewhere. ``demand`` is stated where history
    decides it: there it may differ from host to host.
    """

    host: str
    rank: int
    total: Signed | None
    terms: UtilityTerms
    feasible: bool
    affinity: SignedInt = field(default=0, metadata=in_document(always=True))
    rejections: tuple[Rejection, ...] = field(default=(), metadata=in_document(always=True))
    demand: tuple[ResourceDemand, ...] = field(default=(), metadata=in_document(keyed_by="resource"))
    predicted_latency: PredictedLatency | None = None


class Verdict(StrEnum):
    """Verdict of the scheduler on one task."""

    PLACED = "placed"
    KEPT = "kept"
    UNPLACED = "unplaced"
    HELD = "held"
    COMPLETED = "completed"


class Reason(StrEnum):
    """Reason of a verdict; ``views`` holds the text of each."""

    BEST = "best-utility"
    WITH_PREDECESSOR = "with-predecessor"
    ONLY_FEASIBLE = "only-feasible"
    BEST_EFFORT = "best-effort"
    PINNED = "pinned"
    LEAST_LOADED = "least-loaded"
    FULLEST = "fullest"
    IN_TURN = "in-turn"
    DRAWN = "drawn"
    PINNED_BY_OPERATOR = "pinned-by-operator"
    FIRST_PLACEMENT = "first-placement"
    ONBOARD_LOCAL = "local-execution"
    GAIN = "gain-above-margin"
    GAIN_OVER_COST = "gain-above-cost"
    MADE_ROOM = "made-room-for"
    ROOM_MADE = "room-made"
    PREEMPTED = "preempted"
    TOGETHER = "together-with"
    GROUP = "group-incomplete"
    REBALANCED = "rebalanced"
    OPTIMAL = "optimal"
    STANDBY_ACTIVATED = "standby-activated"
    REPLACED = "replaced"
    FORCED_INFEASIBLE = "present-host-infeasible"
    RELIEF = "relieves-overload"
    FORCED_DRAIN = "present-host-drained"
    FORCED_RULE = "present-host-excluded"
    STILL_BEST = "still-best"
    BELOW_MARGIN = "below-move-margin"
    COST_ABOVE_GAIN = "cost-above-gain"
    DWELL = "dwell"
    MAX_MOVES = "max-moves"
    MOVES_FROZEN = "moves-frozen"
    UNSETTLED = "unsettled"
    NOTHING_FITS = "nothing-fits-stays"
    NEVER_MOVED = "never-moved"
    STILL_FITS = "still-fits"
    UNMANAGED = "unmanaged"
    NO_CANDIDATE = "no-candidate"
    NO_FEASIBLE_HOST = "no-feasible-host"
    PREDECESSOR_MISSING = "predecessor-missing"
    PREDECESSOR_INCOMPLETE = "predecessor-incomplete"
    HOST_SILENT = "host-silent"
    HOST_LEFT = "host-left"
    HOST_READDRESSED = "host-readdressed"
    HOST_UNSURE = "host-unsure"
    HOST_UNLISTED = "host-unlisted"
    ROBOT_SILENT = "robot-silent"
    DONE = "done"
    GIVEN_UP = "given-up"
    LEFT_FILE = "left-the-file"
    PRUNED = "pruned"
    DUPLICATE = "duplicate"
    SPEC_CHANGED = "spec-changed"
    ORPHANED = "orphaned"
    NEED_RESTARTED = "need-restarted"
    OPERATOR = "operator"
    ROLLBACK = "rollback"


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveCost:
    """Expected cost of a move (ADR 0018): it pays if gain x ``stay_s`` > ``downtime_s`` x ``per_s``.

    ``stay_s``: expected seconds on the new host (> 0). ``downtime_s``: median of the measured downtimes.
    ``per_s``: utility lost per second of downtime.
    """

    stay_s: Positive
    downtime_s: float
    per_s: float

    @property
    def needed(self) -> float:
        """The gain in utility that the move must exceed."""
        return self.downtime_s * self.per_s / self.stay_s


_WRITTEN = in_document(always=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatorPin:
    """The pin of ``edgectl move`` in one decision: to ``host``, ``until`` s since 1970 (None: no end).

    ``set_aside``: why it does not count now, and the task is placed as if it had none.
    """

    host: str
    until: Instant | None = field(default=None, metadata=in_document("pinned_until"))
    set_aside: RejectionRule | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """The verdict on one task.

    ``total`` and ``lead`` are of ``host`` (lead: minus the best other feasible host's total; None where there
    is no other). ``challenger`` is the best other host; ``subject`` names what the reason is about
    (predecessor, robot, silent host); ``amount`` its number (gain of a move, margin, remaining dwell in s,
    seconds until a held task may be replaced, exit code of a task that was given up). ``cost`` is what a move
    was weighed against, where downtimes are measured. ``nearest`` is the nearest miss of an unplaced task.
    ``rejection_counts`` counts the hosts that a shortened ranking left out, by rule. ``demand`` is rho on
    ``host`` (unplaced: on the nearest miss), empty where nothing was weighed. ``pin``: of an operator.
    """

    task: str
    verdict: Verdict
    reason: Reason
    host: str | None = field(default=None, metadata=_WRITTEN)
    previous_host: str | None = field(default=None, metadata=_WRITTEN)
    total: Signed | None = field(default=None, metadata=_WRITTEN)
    lead: Signed | None = field(default=None, metadata=_WRITTEN)
    challenger: str | None = None
    subject: str | None = None
    amount: Signed | None = None
    cost: MoveCost | None = None
    nearest: str | None = None
    overcommitted: bool = False
    ranking: Sequence[RankedHost] = field(default=(), metadata=in_document(required=True))
    rejection_counts: Mapping[str, int] = field(default_factory=dict)
    demand: Sequence[ResourceDemand] = field(default=(), metadata=in_document(keyed_by="resource"))
    pin: OperatorPin | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedLoad:
    """gamma of one host after the whole plan, and of its links in bytes/s by robot."""

    used: Annotated[Usage, Bounds(minimum=None)] = field(
        metadata=in_document(by_resource=("used",), host_only=True)
    )
    links: Mapping[str, Signed] = field(
        default_factory=dict, metadata=in_document(always=True, value_key="used_bytes_per_s")
    )


# Relative gap of a sum of utilities below which it counts as the highest.
NEGLIGIBLE_GAP = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """How far a plan may be from the best one: each figure with a bound that no plan exceeds.

    ``wanted``: tasks that some host may take. ``placed``: those with a place; ``placed_bound``: at most so
    many can have one, the higher priority first. ``moves``: running tasks that make room;
    ``moves_bound``: so many must. ``utility_sum``: sum of all totals at the loads after the plan;
    ``utility_sum_bound``: its maximum with so many tasks placed and moves, None where it is not known.
    ``withheld``: tasks of incomplete groups that no room would help, which all figures leave out.
    ``timed_out``: the time was up before all was proven, so another run may find another plan.
    """

    wanted: int
    placed: int
    placed_bound: int
    moves: int
    moves_bound: int
    utility_sum: Signed
    utility_sum_bound: Signed | None = field(default=None, metadata=_WRITTEN)
    withheld: int = 0
    timed_out: bool = False

    def describe(self) -> str:
        """What was reached, and what is proven, in one line."""
        parts = [self._describe_placed(), self._describe_moves(), self._describe_sum()]
        if self.withheld:
            tasks = (
                "1 task of an incomplete group"
                if self.withheld == 1
                else f"{self.withheld} tasks of incomplete groups"
            )
            parts.append(f"without {tasks}")
        if self.timed_out:
            parts.append("the time was up: another run may find another plan")
        return "; ".join(part for part in parts if part)

    def _describe_placed(self) -> str:
        if self.placed == self.wanted:
            return f"all {self.wanted} tasks are placed"
        if self.placed_bound == self.wanted:
            return f"{self.placed} of {self.wanted} tasks are placed; whether all fit was not found in time"
        none = f"no placement of all {self.wanted} tasks exists (proven)"
        if self.placed == self.placed_bound:
            are = "is" if self.placed == 1 else "are"
            return f"{none}: {self.placed} {are} placed, by priority as many as can be"
        return f"{none}: {self.placed} are placed, at most {self.placed_bound} can be"

    def _describe_moves(self) -> str:
        if not self.moves:
            return ""
        tasks = "1 running task makes room" if self.moves == 1 else f"{self.moves} running tasks make room"
        if self.moves == self.moves_bound:
            return f"{tasks}, the fewest that can (proven)"
        return f"{tasks}, at least {self.moves_bound} must"

    def _describe_sum(self) -> str:
        text = f"sum of utilities {self.utility_sum:.3f}"
        if self.utility_sum_bound is None:
            return text
        gap = self.utility_sum_bound - self.utility_sum
        if gap <= NEGLIGIBLE_GAP * abs(self.utility_sum_bound):
            return f"{text}, the highest (proven)"
        return f"{text}, at most {gap:.3f} below the highest"


@dataclass(frozen=True, slots=True, kw_only=True)
class Assignment:
    """All decisions, in sequence order, the policy as used (weights normalised) and the expected load per
    host.

    ``unseen`` are hosts that did not answer while nothing is remembered of them (a manager new to the fleet).
    ``demand_spreads`` are percent demands that mean different amounts on the hosts that may run the task.
    ``shortages``: what the fleet lacks, whatever the placement. ``certificate``: of a plan that was made
    as good as possible (ADR 71). ``standbys``: what becomes of the inactive copies, by task.
    """

    policy: Policy
    decisions: tuple[Decision, ...]
    expected: Mapping[str, ExpectedLoad]
    settled: bool = True
    frozen: bool = False
    unseen: tuple[str, ...] = ()
    demand_spreads: tuple[DemandSpread, ...] = ()
    shortages: tuple[Shortage, ...] = ()
    certificate: Certificate | None = None
    standbys: Mapping[str, tuple[StandbyStep, ...]] = field(default_factory=dict)
