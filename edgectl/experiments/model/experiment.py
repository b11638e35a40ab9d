# SPDX-License-Identifier: Apache-2.0
"""Experiments on real hosts: specification, trials and progress."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from edgectl.experiments.model.mission_event import EventRecord, MissionEvent
from edgectl.experiments.model.schemes import Scheme
from edgectl.model.cycle import Cycle
from edgectl.model.encoding import Bounds, Columns, FromOne, Instant, Positive, Rounded, in_document
from edgectl.model.inventory import Role
from edgectl.model.snapshot import CapacitySource

# Precision in the files of a run: of times, cores and similarities in decimals, of what applications report
# in digits.
Seconds = Annotated[float, Rounded(decimals=3)]
Cores = Annotated[float, Rounded(decimals=4)]
Whole = Annotated[float, Rounded(decimals=0)]
Similarity = Annotated[float, Bounds(minimum=None), Rounded(decimals=6)]
Reading = Annotated[float, Bounds(minimum=None), Rounded(digits=6)]
_WRITTEN = in_document(always=True)


class MetricAggregation(StrEnum):
    """Reduces the readings of a metric to one number per task; a trial has the mean over its tasks."""

    MEAN = "mean"
    LAST = "last"
    MIN = "min"
    MAX = "max"


class BetterValue(StrEnum):
    """Which values of a metric are better."""

    HIGHER = "higher"
    LOWER = "lower"


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPair:
    """A map and its ground truth.

    ``file``: written by ``task`` on its host; absolute, or relative to its working directory. ``truth``: on
    the manager.
    """

    task: str
    file: str
    truth: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryMetric:
    """The metric that tells how well a task does, for recovery after events (ADR 133).

    ``within``: how much worse than before still counts as good, as a share. ``window``: s of the means.
    """

    metric: str = ""
    higher: bool = field(default=True, metadata=in_document("higher_is_better", always=True))
    within: float = field(default=0.1, metadata=_WRITTEN)
    window: Positive = field(default=10.0, metadata=in_document("window_s", always=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """The specification: ``repetitions`` trials of each scheme.

    A trial ends when all tasks in ``until`` have completed, or after ``limit`` s. ``every``: period of
    sampling and planning in s. ``idle``: highest CPU utilisation of a host before a trial, 0..1. ``metrics``:
    of the application, in the order of the table. ``maps``: by column of the table, maps scored by SSIM.
    ``events``: what changes during a trial. ``recovery``: None: a task does well where it runs.
    ``equivalence``: schemes whose missions differ by less than this share count as equal.
    """

    name: str
    schemes: tuple[Scheme, ...]
    until: tuple[str, ...]
    repetitions: FromOne = field(default=3, metadata=in_document(required=True))
    every: Positive = field(default=5.0, metadata=in_document("every_s", required=True))
    limit: Positive = field(default=600.0, metadata=in_document("limit_s", required=True))
    idle: float = field(default=0.25, metadata=in_document(required=True))
    metrics: Mapping[str, MetricAggregation] = field(default_factory=dict, metadata=_WRITTEN)
    maps: Mapping[str, MapPair] = field(default_factory=dict, metadata=_WRITTEN)
    equivalence: Positive | None = None
    events: tuple[MissionEvent, ...] = field(default=(), metadata=in_document(keyed_by="name"))
    recovery: RecoveryMetric | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HostCapacity:
    """Role and capacity of a host, in cores and bytes."""

    role: Role
    cores: Positive
    memory: Positive = field(metadata=in_document("memory_bytes"))


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadSample:
    """Usage of a host ``at`` s after the start of the trial: cores, bytes, bytes/s on its links to robots."""

    at: Seconds = field(metadata=in_document("at_s"))
    cores: Cores
    memory: Whole = field(metadata=in_document("bytes"))
    bytes_per_s: Whole


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkCapacity:
    """What a plan took a link to carry from ``at`` s after the start of the trial on, in bytes/s."""

    at: Seconds = field(metadata=in_document("at_s"))
    bytes_per_s: Whole
    source: CapacitySource


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionUsage:
    """What a host used from the start of a trial to the end of its mission, by counters (ADR 0132).

    ``cpu_s``: CPU seconds; of a host with a declared capacity those of its tasks. ``network_bytes``: in and
    out over its interfaces; None for a host with a declared capacity. ``memory``: mean in bytes. ``energy``:
    joules by the draw that its sensors tell; None where a snapshot has none.
    """

    cpu_s: Annotated[float, Rounded(decimals=3)]
    memory: Whole = field(metadata=in_document("memory_bytes"))
    network_bytes: Whole | None = None
    energy: Annotated[float, Rounded(decimals=1)] | None = field(
        default=None, metadata=in_document("energy_j")
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementInterval:
    """``task`` ran on ``host`` from ``start`` to ``end``, in s after the start of the trial."""

    task: str
    host: str
    start: Seconds = field(metadata=in_document("start_s"))
    end: Seconds = field(metadata=in_document("end_s"))


@dataclass(frozen=True, slots=True, kw_only=True)
class HandoffRecord:
    """A move of ``task``, finished ``at`` s after the start of the trial.

    ``downtime``: from stop to ready, in s; ``gap``: silence of the task at its robot, in s, by the rule
    ``heard`` of the task. None if not measured.
    """

    task: str
    source: str
    target: str
    at: Seconds = field(metadata=in_document("at_s"))
    downtime: Seconds | None = field(default=None, metadata=in_document("downtime_s", always=True))
    gap: Seconds | None = field(default=None, metadata=in_document("gap_s"))


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricReading:
    """Value of an application's metric ``at`` s after the start of the trial."""

    at: Seconds = field(metadata=in_document("at_s"))
    value: Reading


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One mission under one scheme.

    ``latency``: s from the first plan to the completion of the last task in ``until``; the time limit if not
    ``finished``. ``completed``: by task, s after the start of the trial. ``unplaced``: tasks without a host,
    summed over all plans. ``loads``: by host. ``links``: by edge, then robot, whenever it changed.
    ``readings``: by metric, then task. ``ssim``: by column, -1..1.
    ``usage``: by host, over the mission; empty in trials of earlier releases.
    ``events``: what happened, in the order of time.
    """

    scheme: str
    repetition: FromOne
    began_at: Instant
    latency: Seconds = field(metadata=in_document("latency_s"))
    finished: bool
    unplaced: int = field(default=0, metadata=in_document(required=True))
    completed: Mapping[str, Seconds] = field(
        default_factory=dict, metadata=in_document("completed_s", always=True)
    )
    spans: tuple[PlacementInterval, ...] = field(default=(), metadata=_WRITTEN)
    handoffs: tuple[HandoffRecord, ...] = field(default=(), metadata=_WRITTEN)
    loads: Mapping[str, Columns[LoadSample]] = field(default_factory=dict, metadata=_WRITTEN)
    readings: Mapping[str, Mapping[str, Columns[MetricReading]]] = field(
        default_factory=dict, metadata=_WRITTEN
    )
    ssim: Mapping[str, Similarity] = field(default_factory=dict, metadata=_WRITTEN)
    links: Mapping[str, Mapping[str, Columns[LinkCapacity]]] = field(default_factory=dict)
    usage: Mapping[str, MissionUsage] = field(default_factory=dict)
    events: tuple[EventRecord, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentRun:
    """The trials so far, ordered by scheme, then repetition.

    ``digest`` identifies fleet, tasks and mission.
    """

    experiment: Experiment
    digest: str
    machines: Mapping[str, HostCapacity]
    trials: tuple[Trial, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialProgress:
    """Progress of trial ``number`` of ``total``: ``elapsed`` s, and the ``completed`` tasks of ``until``.

    ``left``: estimated s until the end of the experiment, None if unknown. ``cycle``: the last one, None at
    the start of the trial. ``trial``: the result, at its end.
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


def ignore_trial_progress(_progress: TrialProgress) -> None:
    """A listener that does nothing."""
