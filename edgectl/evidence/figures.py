"""From runs to figures: means, deviations and confidence intervals."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import sqrt
from statistics import fmean, stdev

from edgectl.model.evidence import Column, Figure, Variant
from edgectl.model.inventory import Inventory
from edgectl.model.policy import PolicyName
from edgectl.model.scenario import SimRun, Usage

# What one run gave, by metric: one value for each host of the column, or one alone; None where there is none.
Values = Mapping[str, tuple[float | None, ...]]
# Student's t for two-sided 95 % by degrees of freedom; beyond, the normal distribution is near enough.
_T = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093,
      2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042)  # fmt: skip
_NORMAL = 1.960
# A value from here on is taken for none: applications may write anything, and sums of it overflow.
LARGEST = 1e100
_PER_HOST: dict[str, Callable[[Usage], float | None]] = {
    "cpu": lambda usage: 100 * usage.cpu,
    "cpu peak": lambda usage: 100 * usage.cpu_peak,
    "memory": lambda usage: 100 * usage.memory,
    "throughput": lambda usage: usage.network_bytes_per_s / 1e6,
    "rate": lambda usage: usage.rate,
}


def figure(values: Sequence[float]) -> Figure:
    """Mean, deviation and 95 % interval of independent values; at least one."""
    if len(values) == 1:
        return Figure(mean=values[0])
    spread = stdev(values)
    t = _T[len(values) - 2] if len(values) - 2 < len(_T) else _NORMAL
    return Figure(mean=fmean(values), std=spread, half=t * spread / sqrt(len(values)), count=len(values))


def there(values: Iterable[float | None]) -> list[float]:
    """The values that can be reckoned with."""
    return [value for value in values if value is not None and abs(value) < LARGEST]


def known(values: Iterable[float | None]) -> Figure | None:
    """The figure of the runs that have a value."""
    found = there(values)
    return figure(found) if found else None


def mean(values: Iterable[float | None]) -> float | None:
    """The mean of the values that are there."""
    found = there(values)
    return fmean(found) if found else None


def summed_up(inventory: Inventory, variant: Variant, runs: Sequence[SimRun]) -> Column:
    """One scheme's column of the model. Under local execution the robots count, in all others the edges, each for itself."""
    local = variant.policy.name is PolicyName.LOCAL
    hosts = [host.name for host in (inventory.robots if local else inventory.edges)]
    return Column(
        variant=variant,
        runs=len(runs),
        unfinished=sum(not run.finished for run in runs),
        unplaced=sum(run.unplaced for run in runs),
        figures=over([_values(run, hosts, together=local) for run in runs]),
        hosts=() if local else tuple(hosts),
    )


def _values(run: SimRun, hosts: Sequence[str], *, together: bool) -> Values:
    per_host = {metric: tuple(read(run.usage[host]) for host in hosts) for metric, read in _PER_HOST.items()}
    return {"latency": (run.latency / 60,), **joined(per_host, together=together), "handoffs": (float(run.handoffs),)}


def joined(values: Values, *, together: bool) -> Values:
    """The same, or with ``together`` the mean over the hosts."""
    return {metric: (mean(row),) for metric, row in values.items()} if together else values


def over(runs: Sequence[Values]) -> dict[str, tuple[Figure | None, ...]]:
    """The figure of each value over runs that all have the same metrics and hosts."""
    metrics = runs[0] if runs else {}
    return {metric: tuple(known(row) for row in zip(*(run[metric] for run in runs), strict=True)) for metric in metrics}
