"""The paper's table of trials on real hosts: one column per scheme, over its trials."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from statistics import fmean

from edgectl.evidence.figures import Values, joined, known, mean, over, there
from edgectl.model.evidence import Column, Variant
from edgectl.model.experiment import Load, Machine, Reading, Run, Summary, Trial
from edgectl.model.inventory import Role
from edgectl.model.policy import PolicyName

_SUMMARIES: Mapping[Summary, Callable[[Sequence[float]], float]] = {
    Summary.MEAN: fmean,
    Summary.LAST: lambda values: values[-1],
    Summary.MIN: min,
    Summary.MAX: max,
}
PER_HOST = ("cpu", "cpu peak", "memory", "throughput")
# A scheme without a trial has the columns of one that says nothing.
_NOTHING = Trial(scheme="", repetition=0, began_at=0.0, latency=0.0, finished=False)


def columns(run: Run) -> list[Column]:
    """One column per scheme of the experiment, also where no trial has been done yet. The order of the trials is of no account."""
    return [_column(run, variant) for variant in run.experiment.variants]


def _column(run: Run, variant: Variant) -> Column:
    trials = sorted((trial for trial in run.trials if trial.scheme == variant.name), key=lambda trial: trial.repetition)
    local = variant.policy.name is PolicyName.LOCAL
    hosts = {name: machine for name, machine in run.machines.items() if (machine.role is Role.ROBOT) is local}
    figures = over([_values(trial, hosts, together=local) for trial in trials])
    return Column(
        variant=variant,
        runs=len(trials),
        unfinished=sum(not trial.finished for trial in trials),
        unplaced=sum(trial.unplaced for trial in trials),
        figures=figures or {metric: (None,) * len(values) for metric, values in _values(_NOTHING, hosts, together=local).items()},
        hosts=() if local else tuple(hosts),
        metrics={
            name: known(_metric(trial.readings.get(name, {}), summary) for trial in trials)
            for name, summary in run.experiment.metrics.items()
        },
        maps={name: known(trial.ssim.get(name) for trial in trials) for name in run.experiment.maps},
    )


def _values(trial: Trial, hosts: Mapping[str, Machine], *, together: bool) -> Values:
    used = [_used(sorted(trial.loads.get(name, ()), key=lambda load: load.at), machine) for name, machine in hosts.items()]
    return {
        "latency": (trial.latency / 60,),
        **joined({metric: tuple(each[metric] for each in used) for metric in PER_HOST}, together=together),
        "handoffs": (float(len(trial.handoffs)),),
        "downtime": (mean(handoff.downtime for handoff in trial.handoffs),),
        "unplaced": (float(trial.unplaced),),
    }


def _used(loads: Sequence[Load], machine: Machine) -> dict[str, float | None]:
    """What one host used, in the units of the table."""
    at, cpu = [load.at for load in loads], [100 * load.cores / machine.cores for load in loads]
    return {
        "cpu": _over_time(at, cpu),
        "cpu peak": max(cpu, default=None),
        "memory": _over_time(at, [100 * load.memory / machine.memory for load in loads]),
        "throughput": _over_time(at, [load.bytes_per_s / 1e6 for load in loads]),
    }


def _over_time(at: Sequence[float], values: Sequence[float]) -> float | None:
    """The mean over time, as if values changed evenly between two samples; None without samples."""
    if not values:
        return None
    seconds = at[-1] - at[0]
    if seconds <= 0:
        return mean(values)
    return (
        sum((end - start) * (one + other) / 2 for (start, end), (one, other) in zip(pairwise(at), pairwise(values), strict=True)) / seconds
    )


def _metric(readings: Mapping[str, Sequence[Reading]], summary: Summary) -> float | None:
    """One number of a trial: of each task, then the mean over the tasks that have any."""
    summarise = _SUMMARIES[summary]
    ordered = (sorted(each, key=lambda reading: reading.at) for each in readings.values())
    values = (there(reading.value for reading in each) for each in ordered)
    return mean(summarise(each) for each in values if each)
