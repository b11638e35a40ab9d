# SPDX-License-Identifier: Apache-2.0
"""Results of comparing schemes: replays, simulations and experiments."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from edgectl.experiments.model.schemes import Scheme

# Times of missions are in seconds where all means are below this, else in minutes.
SHORT_MISSION_S = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Utilisation:
    """Mean and peak over hosts (or links) and cycles, as a share of the capacity (> 1: overload)."""

    mean: float
    peak: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayResult:
    """Decisions of a scheme over the recorded cycles.

    ``handoffs``: moves of tasks between hosts. ``unplaced``: tasks without a host, summed over the cycles.
    ``unsettled``: cycles in which the assignment did not converge. ``assumed``: placed tasks that were never
    recorded as running; their usage is taken from their demand. ``utilisation``: by resource.
    """

    scheme: Scheme
    cycles: int
    handoffs: int
    unplaced: int
    unsettled: int
    assumed: tuple[str, ...] = ()
    utilisation: Mapping[str, Utilisation]


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Mean, standard deviation (n - 1) and half width of the 95 % confidence interval over ``count`` runs.

    Standard deviation and interval are 0 if ``count`` is 1.
    """

    mean: float
    std: float = 0.0
    half_ci95: float = 0.0
    count: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A mean and its 95 % confidence interval; without limits if the values have no spread."""

    mean: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemeComparison:
    """``scheme`` against ``base`` in one metric, by ``pairs`` of the same repetition or seed (ADR 131).

    ``missing``: repetitions with a value of one of both only. ``difference``: scheme - base, in the unit of
    the metric. ``ratio``: geometric mean of scheme / base; None where a value is 0 or less. ``p``: two-sided
    paired t test of the logarithms of the ratios, or of the differences where there is no ratio. ``effect``:
    Hedges' g of the same. ``equal_p``: of equivalence within ``bound`` (a share) by two one-sided tests. Both
    p also after Holm over the comparisons of the metric. None: nothing can be computed.
    """

    metric: str
    scheme: str
    base: str
    pairs: int
    missing: int
    difference: Interval | None = None
    ratio: Interval | None = None
    p: float | None = None
    p_holm: float | None = None
    effect: float | None = None
    bound: float | None = None
    equal_p: float | None = None
    equal_p_holm: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryResult:
    """Recovery after ``count`` events, of which ``not_recovered`` were not overcome (ADR 133).

    ``recovery``: s, over the runs; of one run the mean of its events that were overcome. None: none was.
    """

    count: int
    not_recovered: int
    recovery: Estimate | None


@dataclass(frozen=True, slots=True, kw_only=True)
class EventResult:
    """An event of the mission over all runs of a scheme.

    ``runs``: in which it happened. ``at``: s after the start of the mission, of its first occurrence in a
    run. ``failed``: how often it was not made, or not undone.
    """

    event: str
    kind: str
    subject: str
    runs: int
    failed: int
    at: Estimate | None
    recoveries: RecoveryResult


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemeResult:
    """A scheme over all its runs, simulated or real: a column of the paper's table. None: no run has a value.

    ``estimates``: by metric, one for each of ``hosts`` (the edges), or a single one: of the mission, or under
    local execution the mean over the robots (``hosts`` is empty). Metrics: latency (min); cpu, cpu peak and
    memory (percent); throughput (MB/s); handoffs (per run). Simulated runs add rate (frames/s); real ones add
    downtime and gap (s, means over handoffs), cpu_s (CPU seconds of all hosts), air (MB over the interfaces
    of a robot, mean over robots), energy (kJ of all hosts) and unplaced (tasks without a host, per run).
    ``metrics``: of the application. ``maps``: SSIM, -1..1. ``unfinished``: runs ended by the time limit.
    ``unplaced``: summed over all plans. ``events``: in the order in which they first happened;
    ``recoveries``: by kind of event. ``values``: by metric, the value of each run by its number (the
    repetition of a trial); the mean over the hosts where it has several.
    """

    scheme: Scheme
    runs: int
    unfinished: int
    unplaced: int
    estimates: Mapping[str, tuple[Estimate | None, ...]]
    hosts: tuple[str, ...] = ()
    metrics: Mapping[str, Estimate | None] = field(default_factory=dict)
    maps: Mapping[str, Estimate | None] = field(default_factory=dict)
    values: Mapping[str, Mapping[int, float]] = field(default_factory=dict)
    events: tuple[EventResult, ...] = ()
    recoveries: Mapping[str, RecoveryResult] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceValues:
    """Known values that simulated results are compared with. ``label``: "published" or "measured".

    ``means``: by scheme and metric, one for each host of the simulated result or a single one; None: unknown.
    ``notes``: the coverage of the comparison.
    """

    label: str
    means: Mapping[str, Mapping[str, tuple[float | None, ...]]]
    notes: tuple[str, ...] = ()
