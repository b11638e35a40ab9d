"""What stands beside a model's columns: what was published of the real thing, or what an experiment on real hosts gave."""

from collections.abc import Iterator, Mapping, Sequence

from edgectl.evidence.measured import PER_HOST, columns
from edgectl.model.evidence import Column, Figure, Reality
from edgectl.model.experiment import Run
from edgectl.model.scenario import Scenario

_WHOLE = ("latency", "handoffs")
# The application's metric that stands beside the model's rate, in frames/s.
RATES = ("rate", "fps")


def published(scenario: Scenario) -> Reality:
    """What the scenario's file quotes."""
    return Reality(word="published", figures=scenario.published)


def measured(model: Sequence[Column], run: Run) -> Reality:
    """What the trials of ``run`` gave, scheme by scheme and host by host as the model has them."""
    real = {value.variant.name: value for value in columns(run) if value.runs}
    figures = {value.variant.name: _figures(value, real[value.variant.name]) for value in model if value.variant.name in real}
    return Reality(word="measured", figures=figures, notes=tuple(_notes(model, real, run)))


def _figures(value: Column, real: Column) -> Mapping[str, tuple[float | None, ...]]:
    found = {metric: _means(real, metric) for metric in _WHOLE} | {metric: _by_host(value, real, metric) for metric in PER_HOST}
    rate = next((real.metrics[name] for name in RATES if name in real.metrics), None)
    found |= {"rate": (_mean(rate),), "ssim": (_mean(_map(real)),)}
    return {metric: means for metric, means in found.items() if any(mean is not None for mean in means)}


def _means(real: Column, metric: str) -> tuple[float | None, ...]:
    return tuple(_mean(figure) for figure in real.figures[metric])


def _by_host(value: Column, real: Column, metric: str) -> tuple[float | None, ...]:
    """The real means in the order of the model's hosts; under local execution both have the mean over the robots."""
    if not value.hosts:
        return _means(real, metric)
    known = dict(zip(real.hosts, _means(real, metric), strict=True))
    return tuple(known.get(host) for host in value.hosts)


def _map(real: Column) -> Figure | None:
    return real.maps["ssim"] if "ssim" in real.maps else next(iter(real.maps.values()), None) if len(real.maps) == 1 else None


def _mean(figure: Figure | None) -> float | None:
    return figure.mean if figure else None


def _notes(model: Sequence[Column], real: Mapping[str, Column], run: Run) -> Iterator[str]:
    """What was measured, and what has nothing to stand beside."""
    names = [value.variant.name for value in model]
    trials = sum(value.runs for value in real.values())
    yield f"Measured: {trials} trial{'' if trials == 1 else 's'} of {run.experiment.name}."
    yield from _listed("Measured, but not in the model", [name for name in real if name not in names])
    yield from _listed("In the model, but not measured", [name for name in names if name not in real])
    hosts = dict.fromkeys(host for value in model for host in value.hosts)
    there = dict.fromkeys(host for value in real.values() for host in value.hosts)
    yield from _listed("Edges of the model that were not measured", [host for host in hosts if host not in there] if there else [])
    yield from _listed("Measured edges that the model does not have", [host for host in there if host not in hosts] if hosts else [])
    yield from _listed("Not modelled", [name for name in run.experiment.metrics if name not in RATES])


def _listed(what: str, names: Sequence[str]) -> Iterator[str]:
    if names:
        yield f"{what}: {', '.join(names)}."
