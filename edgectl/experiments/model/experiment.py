"""Experiments on real hosts: what is to be run, and what came of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from edgectl.experiments.model.comparison import Scheme
from edgectl.model.cycle import Cycle
from edgectl.model.inventory import Role


class MetricAggregation(StrEnum):
    """How the readings of a metric become one number per trial; readings of several tasks are first made one each, then averaged."""

    MEAN = "mean"
    LAST = "last"
    MIN = "min"
    MAX = "max"


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPair:
    """A map that ``task`` leaves in ``file`` on its host (absolute, or from its working directory), and the ``truth`` on the manager."""

    task: str
    file: str
    truth: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """Every variant, ``repetitions`` times each. A trial ends when all tasks in ``until`` have completed, or after ``limit`` s.

    ``every``: s from one sample and plan to the next. ``idle``: share of a host's CPU that may be in use before a trial, 0..1.
    ``metrics``: the application's metrics that the table shows. ``maps``: by column, maps that are compared by SSIM.
    """

    name: str
    schemes: tuple[Scheme, ...]
    until: tuple[str, ...]
    repetitions: int = 3
    every: float = 5.0
    limit: float = 600.0
    idle: float = 0.25
    metrics: Mapping[str, MetricAggregation] = field(default_factory=dict)
    maps: Mapping[str, MapPair] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class HostCapacity:
    """A host of the fleet: its capacity in cores and bytes."""

    role: Role
    cores: float
    memory: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadSample:
    """What a host used ``at`` s after the trial began: cores, bytes, and bytes/s on its links to robots."""

    at: float
    cores: float
    memory: float
    bytes_per_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementInterval:
    """``task`` was on ``host`` from ``start`` to ``end`` (s after the trial began)."""

    task: str
    host: str
    start: float
    end: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HandoffRecord:
    """``task`` went from ``source`` to ``target``, done ``at`` s after the trial began; ``downtime`` in s where it was measured."""

    task: str
    source: str
    target: str
    at: float
    downtime: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricReading:
    """An application's metric: its ``value`` as it stood ``at`` s after the trial began."""

    at: float
    value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One mission under one scheme. ``latency``: s from the first plan to the completion of the last task in ``until``, or the limit.

    ``completed``: by task, s after the trial began. ``unplaced``: tasks without a host, summed over all plans. ``loads`` by host;
    ``readings`` by metric, then task; ``ssim`` by column, -1..1.
    """

    scheme: str
    repetition: int
    began_at: float
    latency: float
    finished: bool
    unplaced: int = 0
    completed: Mapping[str, float] = field(default_factory=dict)
    spans: tuple[PlacementInterval, ...] = ()
    handoffs: tuple[HandoffRecord, ...] = ()
    loads: Mapping[str, tuple[LoadSample, ...]] = field(default_factory=dict)
    readings: Mapping[str, Mapping[str, tuple[MetricReading, ...]]] = field(default_factory=dict)
    ssim: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentRun:
    """All trials of an experiment so far, in the order of schemes, then repetitions. ``digest`` tells the files that were run."""

    experiment: Experiment
    digest: str
    machines: Mapping[str, HostCapacity]
    trials: tuple[Trial, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialProgress:
    """Trial ``number`` of ``total`` is under way: ``elapsed`` s so far, ``completed`` of the tasks in ``until``.

    ``left``: s until all is done, None where nothing can be said yet. ``cycle``: what was just seen and done, None when the trial begins.
    ``trial``: what came of it, when it ends.
    """

    scheme: str
    repetition: int
    number: int
    total: int
    until: tuple[str, ...]
    elapsed: float = 0.0
    completed: tuple[str, ...] = ()
    left: float | None = None
    cycle: Cycle | None = None
    trial: Trial | None = None


TrialListener = Callable[[TrialProgress], None]


def ignore_trial_progress(_course: TrialProgress) -> None:
    """Show nothing."""
