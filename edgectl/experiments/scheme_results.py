# SPDX-License-Identifier: Apache-2.0
"""Results of schemes from their runs: means, standard deviations and confidence intervals."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from statistics import fmean, stdev

from edgectl.experiments.model.comparison import Estimate, SchemeResult
from edgectl.experiments.model.experiment import (
    Experiment,
    ExperimentRun,
    HostCapacity,
    LoadSample,
    MetricAggregation,
    MetricReading,
    Trial,
)
from edgectl.experiments.model.scenario import SimHostUsage, SimRun
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.paired_tests import estimate_mean_interval
from edgectl.model.inventory import Inventory, Role
from edgectl.model.policy import PolicyName

# Values of one run by metric: one for each host, or a single one; None: no value.
MetricValues = Mapping[str, tuple[float | None, ...]]
# Larger values count as none: applications may write anything, and their sums would overflow.
MAX_METRIC_VALUE = 1e100
_SIM_HOST_METRICS: dict[str, Callable[[SimHostUsage], float | None]] = {
    "cpu": lambda usage: 100 * usage.cpu,
    "cpu peak": lambda usage: 100 * usage.cpu_peak,
    "memory": lambda usage: 100 * usage.memory,
    "throughput": lambda usage: usage.network_bytes_per_s / 1e6,
    "rate": lambda usage: usage.rate,
}
_AGGREGATORS: Mapping[MetricAggregation, Callable[[Sequence[float]], float]] = {
    MetricAggregation.MEAN: fmean,
    MetricAggregation.LAST: lambda values: values[-1],
    MetricAggregation.MIN: min,
    MetricAggregation.MAX: max,
}
HOST_METRICS = ("cpu", "cpu peak", "memory", "throughput")
# A scheme without a trial has the metrics of this one, all without a value.
_EMPTY_TRIAL = Trial(scheme="", repetition=0, began_at=0.0, latency=0.0, finished=False)


def compute_estimate(values: Sequence[float]) -> Estimate:
    """Mean, sample standard deviation and 95 % confidence interval of independent values, at least one."""
    if len(values) == 1:
        return Estimate(mean=values[0])
    interval = estimate_mean_interval(values)
    half = 0.0 if interval.high is None else interval.high - interval.mean
    return Estimate(mean=interval.mean, std=stdev(values), half_ci95=half, count=len(values))


def select_usable_values(values: Iterable[float | None]) -> list[float]:
    """The values below `MAX_METRIC_VALUE` in magnitude."""
    return [value for value in values if value is not None and abs(value) < MAX_METRIC_VALUE]


def estimate_usable_values(values: Iterable[float | None]) -> Estimate | None:
    """The estimate over the runs that have a usable value; None if none has."""
    found = select_usable_values(values)
    return compute_estimate(found) if found else None


def compute_usable_mean(values: Iterable[float | None]) -> float | None:
    """The mean of the usable values; None if there are none."""
    found = select_usable_values(values)
    return fmean(found) if found else None


def summarize_sim_runs(inventory: Inventory, scheme: Scheme, runs: Sequence[SimRun]) -> SchemeResult:
    """The result of a simulated scheme: per edge, or under local execution the mean over the robots."""
    local = scheme.policy.name is PolicyName.LOCAL
    hosts = [host.name for host in (inventory.robots if local else inventory.edges)]
    values = [_collect_sim_run_values(run, hosts, together=local) for run in runs]
    return SchemeResult(
        scheme=scheme,
        runs=len(runs),
        unfinished=sum(not run.finished for run in runs),
        unplaced=sum(run.unplaced for run in runs),
        estimates=estimate_metrics(values),
        hosts=() if local else tuple(hosts),
        values=_list_values_by_run(dict(enumerate(values, 1))),
    )


def _list_values_by_run(runs: Mapping[int, MetricValues]) -> dict[str, dict[int, float]]:
    """By metric, the usable mean over the hosts of each run that has one."""
    metrics = dict.fromkeys(metric for values in runs.values() for metric in values)
    return {
        metric: {
            number: mean
            for number, values in runs.items()
            if (mean := compute_usable_mean(values.get(metric, ()))) is not None
        }
        for metric in metrics
    }


def _collect_sim_run_values(run: SimRun, hosts: Sequence[str], *, together: bool) -> MetricValues:
    per_host = {
        metric: tuple(read(run.usage[host]) for host in hosts) for metric, read in _SIM_HOST_METRICS.items()
    }
    return {
        "latency": (run.latency / 60,),
        **average_over_hosts(per_host, together=together),
        "handoffs": (float(run.handoffs),),
    }


def average_over_hosts(values: MetricValues, *, together: bool) -> MetricValues:
    """``values``, or with ``together`` their means over the hosts."""
    return {metric: (compute_usable_mean(row),) for metric, row in values.items()} if together else values


def estimate_metrics(runs: Sequence[MetricValues]) -> dict[str, tuple[Estimate | None, ...]]:
    """The estimate of each value over runs that have the same metrics and hosts."""
    metrics = runs[0] if runs else {}
    return {
        metric: tuple(estimate_usable_values(row) for row in zip(*(run[metric] for run in runs), strict=True))
        for metric in metrics
    }


def summarize_trials(run: ExperimentRun) -> list[SchemeResult]:
    """The result of each scheme of the experiment, with or without trials.

    The order of the trials does not matter.
    """
    return [_summarize_scheme(run, scheme) for scheme in run.experiment.schemes]


def _summarize_scheme(run: ExperimentRun, scheme: Scheme) -> SchemeResult:
    trials = sorted(
        (trial for trial in run.trials if trial.scheme == scheme.name), key=lambda trial: trial.repetition
    )
    local = scheme.policy.name is PolicyName.LOCAL
    hosts = {name: machine for name, machine in run.machines.items() if (machine.role is Role.ROBOT) is local}
    robots = [name for name, machine in run.machines.items() if machine.role is Role.ROBOT]
    values = [_collect_trial_values(trial, hosts, robots, together=local) for trial in trials]
    estimates = estimate_metrics(values)
    readings = [_collect_application_values(run.experiment, trial) for trial in trials]
    return SchemeResult(
        scheme=scheme,
        runs=len(trials),
        unfinished=sum(not trial.finished for trial in trials),
        unplaced=sum(trial.unplaced for trial in trials),
        estimates=estimates
        or {
            metric: (None,) * len(values)
            for metric, values in _collect_trial_values(_EMPTY_TRIAL, hosts, robots, together=local).items()
        },
        hosts=() if local else tuple(hosts),
        metrics={
            name: estimate_usable_values(each[name][0] for each in readings)
            for name in run.experiment.metrics
        },
        maps={
            name: estimate_usable_values(trial.ssim.get(name) for trial in trials)
            for name in run.experiment.maps
        },
        # A metric that edgectl measures itself precedes one of the application with the same name.
        values=_list_values_by_run(
            {
                trial.repetition: {**own, **each, **own}
                for trial, each, own in zip(trials, readings, values, strict=True)
            }
        ),
    )


def _collect_application_values(experiment: Experiment, trial: Trial) -> MetricValues:
    """The metrics of the application and the SSIM of its maps, one value each."""
    maps = {name: (trial.ssim.get(name),) for name in experiment.maps}
    return maps | {
        name: (_aggregate_readings(trial.readings.get(name, {}), aggregation),)
        for name, aggregation in experiment.metrics.items()
    }


def _collect_trial_values(
    trial: Trial, hosts: Mapping[str, HostCapacity], robots: Collection[str], *, together: bool
) -> MetricValues:
    used = [_summarize_host_usage(trial, name, machine) for name, machine in hosts.items()]
    return {
        "latency": (trial.latency / 60,),
        **average_over_hosts(
            {metric: tuple(each[metric] for each in used) for metric in HOST_METRICS}, together=together
        ),
        "handoffs": (float(len(trial.handoffs)),),
        "downtime": (compute_usable_mean(handoff.downtime for handoff in trial.handoffs),),
        "gap": (compute_usable_mean(handoff.gap for handoff in trial.handoffs),),
        "cpu_s": (sum(each.cpu_s for each in trial.usage.values()) if trial.usage else None,),
        "air": (compute_usable_mean(_list_air_megabytes(trial, robots)),),
        "energy": (_sum_energy(trial),),
        "unplaced": (float(trial.unplaced),),
    }


def _sum_energy(trial: Trial) -> float | None:
    """Kilojoules of all hosts together; None where one of them does not tell its own."""
    known = [usage.energy for usage in trial.usage.values() if usage.energy is not None]
    return sum(known) / 1000 if known and len(known) == len(trial.usage) else None


def _list_air_megabytes(trial: Trial, robots: Collection[str]) -> list[float]:
    """Megabytes over the interfaces of each robot."""
    counted = (trial.usage[name].network_bytes for name in robots if name in trial.usage)
    return [number / 1e6 for number in counted if number is not None]


def _summarize_host_usage(trial: Trial, host: str, machine: HostCapacity) -> dict[str, float | None]:
    """Mean and peak usage of one host: means by its counters where the trial has them (ADR 0132)."""
    found = _summarize_host_loads(sorted(trial.loads.get(host, ()), key=lambda load: load.at), machine)
    usage = trial.usage.get(host)
    if usage is None or trial.latency <= 0:
        return found
    counted = {
        "cpu": 100 * usage.cpu_s / trial.latency / machine.cores,
        "memory": 100 * usage.memory / machine.memory,
    }
    if usage.network_bytes is not None:
        counted["throughput"] = usage.network_bytes / trial.latency / 1e6
    return {**found, **counted}


def _summarize_host_loads(loads: Sequence[LoadSample], machine: HostCapacity) -> dict[str, float | None]:
    """Mean and peak usage of one host, in the units of the table."""
    at, cpu = [load.at for load in loads], [100 * load.cores / machine.cores for load in loads]
    return {
        "cpu": _compute_time_weighted_mean(at, cpu),
        "cpu peak": max(cpu, default=None),
        "memory": _compute_time_weighted_mean(at, [100 * load.memory / machine.memory for load in loads]),
        "throughput": _compute_time_weighted_mean(at, [load.bytes_per_s / 1e6 for load in loads]),
    }


def _compute_time_weighted_mean(at: Sequence[float], values: Sequence[float]) -> float | None:
    """The time-weighted mean with linear interpolation between samples; None without samples."""
    if not values:
        return None
    seconds = at[-1] - at[0]
    if seconds <= 0:
        return compute_usable_mean(values)
    return (
        sum(
            (end - start) * (one + other) / 2
            for (start, end), (one, other) in zip(pairwise(at), pairwise(values), strict=True)
        )
        / seconds
    )


def _aggregate_readings(
    readings: Mapping[str, Sequence[MetricReading]], aggregation: MetricAggregation
) -> float | None:
    """One number per trial: the aggregate of each task, averaged over the tasks that have readings."""
    aggregate = _AGGREGATORS[aggregation]
    ordered = (sorted(each, key=lambda reading: reading.at) for each in readings.values())
    values = (select_usable_values(reading.value for reading in each) for each in ordered)
    return compute_usable_mean(aggregate(each) for each in values if each)
