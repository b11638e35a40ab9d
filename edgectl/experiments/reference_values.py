"""What stands beside a model's columns: what was published of the real thing, or what an experiment on real hosts gave."""

from collections.abc import Iterator, Mapping, Sequence

from edgectl.experiments.model.comparison import Estimate, ReferenceValues, SchemeResult
from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.scheme_results import HOST_METRICS, summarize_trials

_MISSION_METRICS = ("latency", "handoffs")
# The application's metric that stands beside the model's rate, in frames/s.
RATE_METRICS = ("rate", "fps")


def reference_from_scenario(scenario: Scenario) -> ReferenceValues:
    """What the scenario's file quotes."""
    return ReferenceValues(label="published", means=scenario.published)


def reference_from_run(model: Sequence[SchemeResult], run: ExperimentRun) -> ReferenceValues:
    """What the trials of ``run`` gave, scheme by scheme and host by host as the model has them."""
    real = {value.scheme.name: value for value in summarize_trials(run) if value.runs}
    figures = {
        value.scheme.name: _collect_reference_means(value, real[value.scheme.name])
        for value in model
        if value.scheme.name in real
    }
    return ReferenceValues(label="measured", means=figures, notes=tuple(_describe_coverage(model, real, run)))


def _collect_reference_means(
    value: SchemeResult, real: SchemeResult
) -> Mapping[str, tuple[float | None, ...]]:
    found = {metric: _list_metric_means(real, metric) for metric in _MISSION_METRICS} | {
        metric: _align_means_to_hosts(value, real, metric) for metric in HOST_METRICS
    }
    rate = next((real.metrics[name] for name in RATE_METRICS if name in real.metrics), None)
    found |= {"rate": (_mean_or_none(rate),), "ssim": (_mean_or_none(_select_map_estimate(real)),)}
    return {metric: means for metric, means in found.items() if any(mean is not None for mean in means)}


def _list_metric_means(real: SchemeResult, metric: str) -> tuple[float | None, ...]:
    return tuple(_mean_or_none(figure) for figure in real.estimates[metric])


def _align_means_to_hosts(value: SchemeResult, real: SchemeResult, metric: str) -> tuple[float | None, ...]:
    """The real means in the order of the model's hosts; under local execution both have the mean over the robots."""
    if not value.hosts:
        return _list_metric_means(real, metric)
    known = dict(zip(real.hosts, _list_metric_means(real, metric), strict=True))
    return tuple(known.get(host) for host in value.hosts)


def _select_map_estimate(real: SchemeResult) -> Estimate | None:
    return (
        real.maps["ssim"]
        if "ssim" in real.maps
        else next(iter(real.maps.values()), None)
        if len(real.maps) == 1
        else None
    )


def _mean_or_none(figure: Estimate | None) -> float | None:
    return figure.mean if figure else None


def _describe_coverage(
    model: Sequence[SchemeResult], real: Mapping[str, SchemeResult], run: ExperimentRun
) -> Iterator[str]:
    """What was measured, and what has nothing to stand beside."""
    names = [value.scheme.name for value in model]
    trials = sum(value.runs for value in real.values())
    yield f"Measured: {trials} trial{'' if trials == 1 else 's'} of {run.experiment.name}."
    yield from _describe_names("Measured, but not in the model", [name for name in real if name not in names])
    yield from _describe_names("In the model, but not measured", [name for name in names if name not in real])
    hosts = dict.fromkeys(host for value in model for host in value.hosts)
    there = dict.fromkeys(host for value in real.values() for host in value.hosts)
    yield from _describe_names(
        "Edges of the model that were not measured",
        [host for host in hosts if host not in there] if there else [],
    )
    yield from _describe_names(
        "Measured edges that the model does not have",
        [host for host in there if host not in hosts] if hosts else [],
    )
    yield from _describe_names(
        "Not modelled", [name for name in run.experiment.metrics if name not in RATE_METRICS]
    )


def _describe_names(what: str, names: Sequence[str]) -> Iterator[str]:
    if names:
        yield f"{what}: {', '.join(names)}."
