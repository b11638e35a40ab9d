# SPDX-License-Identifier: Apache-2.0
"""Reference values for a simulation: published ones, or those of an experiment on real hosts."""

from collections.abc import Iterator, Mapping, Sequence

from edgectl.experiments.model.comparison import Estimate, ReferenceValues, SchemeResult
from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.paired_tests import SampleSummary, compute_welch_p
from edgectl.experiments.scheme_results import HOST_METRICS, summarize_trials

_MISSION_METRICS = ("latency", "handoffs")
# Application metrics that correspond to the simulated rate, in frames/s.
RATE_METRICS = ("rate", "fps")


def reference_from_scenario(scenario: Scenario) -> ReferenceValues:
    """The published values in the scenario file, with Welch's test of their latencies."""
    return ReferenceValues(
        label="published", means=scenario.published, notes=tuple(_describe_published_tests(scenario))
    )


def _describe_published_tests(scenario: Scenario) -> Iterator[str]:
    """P of each dynamic scheme against static and against local; the published trials are not paired."""
    known = {
        name: SampleSummary(means["latency"][0], scenario.published_std[name], scenario.published_runs)
        for name, means in scenario.published.items()
        if means.get("latency") and name in scenario.published_std
    }
    for base in ("static", "local"):
        tests = {
            name: p
            for name, summary in known.items()
            if name not in ("static", "local")
            and base in known
            and (p := compute_welch_p(summary, known[base])) is not None
        }
        if tests:
            found = ", ".join(f"{name} p = {p:.2g}" for name, p in tests.items())
            yield (
                f"Published latencies against {base} (Welch's test, {scenario.published_runs} trials each, "
                f"not corrected for their number): {found}."
            )


def reference_from_run(simulated: Sequence[SchemeResult], run: ExperimentRun) -> ReferenceValues:
    """The means over the trials of ``run``, by the schemes and hosts of the ``simulated`` results."""
    measured_by_scheme = {result.scheme.name: result for result in summarize_trials(run) if result.runs}
    means = {
        result.scheme.name: _collect_reference_means(result, measured_by_scheme[result.scheme.name])
        for result in simulated
        if result.scheme.name in measured_by_scheme
    }
    return ReferenceValues(
        label="measured", means=means, notes=tuple(_describe_coverage(simulated, measured_by_scheme, run))
    )


def _collect_reference_means(
    result: SchemeResult, measured: SchemeResult
) -> Mapping[str, tuple[float | None, ...]]:
    means_by_metric = {metric: _list_metric_means(measured, metric) for metric in _MISSION_METRICS} | {
        metric: _align_means_to_hosts(result, measured, metric) for metric in HOST_METRICS
    }
    rate = next((measured.metrics[name] for name in RATE_METRICS if name in measured.metrics), None)
    means_by_metric |= {
        "rate": (_mean_or_none(rate),),
        "ssim": (_mean_or_none(_select_map_estimate(measured)),),
    }
    return {
        metric: means for metric, means in means_by_metric.items() if any(mean is not None for mean in means)
    }


def _list_metric_means(measured: SchemeResult, metric: str) -> tuple[float | None, ...]:
    return tuple(_mean_or_none(estimate) for estimate in measured.estimates[metric])


def _align_means_to_hosts(
    result: SchemeResult, measured: SchemeResult, metric: str
) -> tuple[float | None, ...]:
    """The measured means in the order of the simulated hosts; under local execution, their mean."""
    if not result.hosts:
        return _list_metric_means(measured, metric)
    known = dict(zip(measured.hosts, _list_metric_means(measured, metric), strict=True))
    return tuple(known.get(host) for host in result.hosts)


def _select_map_estimate(measured: SchemeResult) -> Estimate | None:
    """The map named ssim, or the only one."""
    if "ssim" in measured.maps:
        return measured.maps["ssim"]
    return next(iter(measured.maps.values())) if len(measured.maps) == 1 else None


def _mean_or_none(estimate: Estimate | None) -> float | None:
    return estimate.mean if estimate else None


def _describe_coverage(
    simulated: Sequence[SchemeResult], measured: Mapping[str, SchemeResult], run: ExperimentRun
) -> Iterator[str]:
    """The number of measured trials; and schemes, hosts and metrics that only one side has."""
    names = [result.scheme.name for result in simulated]
    trials = sum(result.runs for result in measured.values())
    yield f"Measured: {trials} trial{'' if trials == 1 else 's'} of {run.experiment.name}."
    yield from _describe_names(
        "Measured, but not simulated", [name for name in measured if name not in names]
    )
    yield from _describe_names(
        "Simulated, but not measured", [name for name in names if name not in measured]
    )
    hosts = dict.fromkeys(host for result in simulated for host in result.hosts)
    measured_hosts = dict.fromkeys(host for result in measured.values() for host in result.hosts)
    yield from _describe_names(
        "Edges simulated, but not measured",
        [host for host in hosts if host not in measured_hosts] if measured_hosts else [],
    )
    yield from _describe_names(
        "Edges measured, but not simulated",
        [host for host in measured_hosts if host not in hosts] if hosts else [],
    )
    yield from _describe_names(
        "Metrics not simulated", [name for name in run.experiment.metrics if name not in RATE_METRICS]
    )


def _describe_names(label: str, names: Sequence[str]) -> Iterator[str]:
    if names:
        yield f"{label}: {', '.join(names)}."
