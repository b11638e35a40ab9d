# SPDX-License-Identifier: Apache-2.0
"""Scenario of a simulation: hosts, jobs of the mission, timing; and the result of a run."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from edgectl.experiments.model.mission_event import EventRecord, MissionEvent


class Radio(StrEnum):
    """Whether each link has its rate to itself, or all links share the air time of one channel."""

    SEPARATE = "separate"
    SHARED = "shared"


@dataclass(frozen=True, slots=True, kw_only=True)
class SimHost:
    """Capacity of a host and its base load from other processes, in cores and bytes.

    ``period``: s in which a quota lets its tasks use ``cores`` times as many CPU seconds, in a burst; 0: no
    quota.
    """

    cores: float
    memory: float
    base_cores: float = 0.0
    base_memory: float = 0.0
    period: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SimCycle:
    """A task that works on one item after the other, at most ``rate`` a second.

    An item takes ``source_cpu`` (CPU s) of the task ``source`` that makes it, then ``transfer`` bytes over
    the link between the task and its robot, then ``cpu`` (CPU s) of the task itself.
    """

    rate: float
    cpu: float = 0.0
    transfer: float = 0.0
    source: str = ""
    source_cpu: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SimJob:
    """A part of the mission: ``work`` s (> 0) of ``task`` at full speed, after all jobs in ``after``.

    ``spread``: standard deviation of the logarithm of the work between runs. ``senses``: tasks with cycles,
    of which results older than ``fresh`` (s) slow the job: twice as old, half the speed.
    """

    name: str
    task: str
    work: float
    after: tuple[str, ...] = ()
    spread: float = 0.0
    senses: tuple[str, ...] = ()
    fresh: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class SimLink:
    """What a link carries (bytes/s) once all jobs in ``after`` are done; the last entry that holds counts."""

    edge: str
    robot: str
    throughput: float
    after: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SimTiming:
    """Durations in s.

    ``start``: of a task until ready. ``stop``: of a task until gone. ``every``: between two plans.
    ``probe``: of the reading before each plan. ``plan``: from there to the first step. ``prepare``: of a
    move, before its task stops. ``apply``: of a plan with steps, after the last one. ``paced``: ``every``
    counts from the start of a reading, as in a watch, and what is overrun is left out.
    ``by_reading``: conditions of events hold once a reading shows them, as in an experiment.

    ``noise``: standard deviation of a CPU reading, as a share of the capacity. ``bursts``: share of the
    readings in which the traffic of a task with cycles shows what its link carries. ``limit``: time limit of
    a run.
    """

    start: float = 5.0
    stop: float = 1.0
    every: float = 25.0
    noise: float = 0.0
    bursts: float = 1.0
    limit: float = 7200.0
    probe: float = 0.0
    plan: float = 0.0
    prepare: float = 0.0
    apply: float = 0.0
    paced: bool = False
    by_reading: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A mission on simulated hosts.

    ``hosts``: by name in the inventory. ``placed``: task -> host of tasks that edgectl does not manage.
    ``rate``: by task, frames/s at full speed. ``published``: by scheme and metric, values reported for the
    real experiment, one per edge or a single one. ``published_std``: by scheme, of its latency
    in min over ``published_runs`` trials. ``links``: changes of what links carry; the inventory has
    their nominal capacity. ``live_links``: the scheduler sees them, as by the probes of ``watch``.
    ``events``: what else changes during the mission. ``radio``: whether links share air time.
    ``cycles``: by task, of those whose speed follows from what an item takes, and not from a share of their
    demand.
    """

    name: str
    assumptions: tuple[str, ...]
    hosts: Mapping[str, SimHost]
    jobs: tuple[SimJob, ...]
    timing: SimTiming = SimTiming()
    placed: Mapping[str, str] = field(default_factory=dict)
    rate: Mapping[str, float] = field(default_factory=dict)
    published: Mapping[str, Mapping[str, tuple[float, ...]]] = field(default_factory=dict)
    published_std: Mapping[str, float] = field(default_factory=dict)
    published_runs: int = 1
    links: tuple[SimLink, ...] = ()
    live_links: bool = True
    events: tuple[MissionEvent, ...] = ()
    radio: Radio = Radio.SEPARATE
    cycles: Mapping[str, SimCycle] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimHostUsage:
    """Time-weighted means of a host over a run: shares of the capacity, bytes/s, frames/s.

    ``rate``: over the time in which a rated task ran there; None if none did.
    """

    cpu: float
    cpu_peak: float
    memory: float
    network_bytes_per_s: float
    rate: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SimRun:
    """One run of the mission.

    ``latency`` in s; not ``finished``: ended by the time limit. ``usage``: by host. ``events``: what
    happened, in the order of time. ``courses``: with events, by task with work, (s, speed) whenever its speed
    changed, None while it did not run; up to ``course_ends`` where its work was done.
    """

    latency: float
    finished: bool
    handoffs: int
    unplaced: int
    usage: Mapping[str, SimHostUsage]
    jobs: Mapping[str, float] = field(default_factory=dict)
    events: tuple[EventRecord, ...] = ()
    courses: Mapping[str, tuple[tuple[float, float | None], ...]] = field(default_factory=dict)
    course_ends: Mapping[str, float] = field(default_factory=dict)
