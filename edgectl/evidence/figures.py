"""From runs to figures: means, deviations and confidence intervals."""

from collections.abc import Callable, Iterable, Sequence
from math import sqrt
from statistics import fmean, stdev

from edgectl.model.evidence import Figure, Simulated, Variant
from edgectl.model.inventory import Inventory
from edgectl.model.policy import PolicyName
from edgectl.model.scenario import SimRun, Usage

# Student's t for two-sided 95 % by degrees of freedom; beyond, the normal distribution is near enough.
_T = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093,
      2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042)  # fmt: skip
_NORMAL = 1.960
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
    return Figure(mean=fmean(values), std=spread, half=t * spread / sqrt(len(values)))


def summed_up(inventory: Inventory, variant: Variant, runs: Sequence[SimRun]) -> Simulated:
    """One scheme's column. Under local execution the robots count, in all others the edges, each for itself."""
    local = variant.policy.name is PolicyName.LOCAL
    hosts = [host.name for host in (inventory.robots if local else inventory.edges)]
    figures: dict[str, tuple[Figure, ...]] = {"latency": (figure([run.latency / 60 for run in runs]),)}
    for metric, read in _PER_HOST.items():
        rows = [[read(run.usage[host]) for run in runs] for host in hosts]
        figures[metric] = (_together(rows),) if local else tuple(_known(row) for row in rows)
    figures["handoffs"] = (figure([float(run.handoffs) for run in runs]),)
    return Simulated(
        variant=variant,
        runs=len(runs),
        unfinished=sum(not run.finished for run in runs),
        unplaced=sum(run.unplaced for run in runs),
        figures=figures,
    )


def _known(values: Iterable[float | None]) -> Figure:
    """The figure of the runs that have a value; 0 where none has."""
    found = [value for value in values if value is not None]
    return figure(found) if found else Figure(mean=0.0)


def _together(rows: Sequence[Sequence[float | None]]) -> Figure:
    """The mean over the hosts, run by run."""
    means = []
    for run in zip(*rows, strict=True):
        found = [value for value in run if value is not None]
        if found:
            means.append(fmean(found))
    return figure(means) if means else Figure(mean=0.0)
