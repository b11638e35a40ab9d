"""What a simulation is about: computers, a mission and how long things take, with every assumption by its name."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True, kw_only=True)
class SimHost:
    """A computer: its capacity, and the load that no task of ours makes (cores, bytes)."""

    cores: float
    memory: float
    base_cores: float = 0.0
    base_memory: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SimJob:
    """A part of the mission: ``work`` seconds of ``task`` at full speed (> 0), begun when all jobs in ``after`` are done.

    ``spread``: standard deviation of the logarithm of the work from run to run.
    """

    name: str
    task: str
    work: float
    after: tuple[str, ...] = ()
    spread: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SimTiming:
    """How long things take, in s. ``start``: command to ready; ``stop``: signal to gone; ``every``: between two plans.

    ``noise``: standard deviation of a CPU reading, as a share of the capacity. ``limit``: a run is given up after so long.
    """

    start: float = 5.0
    stop: float = 1.0
    every: float = 25.0
    noise: float = 0.0
    limit: float = 7200.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """``hosts``: by name of the inventory. ``placed``: where tasks that edgectl does not manage run. ``rate``: frames that a second
    of full speed yields. ``published``: by scheme and metric what was reported of the real experiment, per edge, or one for the whole.
    """

    name: str
    assumptions: tuple[str, ...]
    hosts: Mapping[str, SimHost]
    jobs: tuple[SimJob, ...]
    timing: SimTiming = SimTiming()
    placed: Mapping[str, str] = field(default_factory=dict)
    rate: Mapping[str, float] = field(default_factory=dict)
    published: Mapping[str, Mapping[str, tuple[float, ...]]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimHostUsage:
    """One host over one run, weighted by time: shares of the capacity, bytes/s, and frames/s of a task while it ran there (or None)."""

    cpu: float
    cpu_peak: float
    memory: float
    network_bytes_per_s: float
    rate: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SimRun:
    """One run of the mission. ``latency`` in s; ``finished`` is false where the limit ended it. ``usage`` by host."""

    latency: float
    finished: bool
    handoffs: int
    unplaced: int
    usage: Mapping[str, SimHostUsage]
    jobs: Mapping[str, float] = field(default_factory=dict)
