"""Results of trials: numbers computed by hand, and properties of any run."""

import random
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.experiments.model.comparison import Estimate, SchemeResult
from edgectl.experiments.model.experiment import (
    Experiment,
    ExperimentRun,
    HandoffRecord,
    HostCapacity,
    LoadSample,
    MetricAggregation,
    MetricReading,
    Trial,
)
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.scheme_results import summarize_trials
from edgectl.model.inventory import Role
from edgectl.model.policy import Policy, PolicyName
from tests.experiments.sample_runs import a_run

STATIC, LOCAL = (
    Scheme(name=name.value, policy=Policy(name=name)) for name in (PolicyName.STATIC, PolicyName.LOCAL)
)
MACHINES = {
    "edge1": HostCapacity(role=Role.EDGE, cores=4.0, memory=1000.0),
    "edge2": HostCapacity(role=Role.EDGE, cores=2.0, memory=1000.0),
    "robot1": HostCapacity(role=Role.ROBOT, cores=1.0, memory=100.0),
    "robot2": HostCapacity(role=Role.ROBOT, cores=1.0, memory=100.0),
}


def close_to(value: float, abs: float | None = None) -> Any:  # noqa: A002 - as pytest.approx has it
    """``pytest.approx`` for a field of type float."""
    return pytest.approx(value, abs=abs)


def trial(scheme: str = "static", repetition: int = 1, **fields: Any) -> Trial:
    return replace(
        Trial(scheme=scheme, repetition=repetition, began_at=0.0, latency=60.0, finished=True), **fields
    )


def run(*trials: Trial, metrics: dict[str, MetricAggregation] | None = None) -> ExperimentRun:
    experiment = Experiment(name="test", schemes=(LOCAL, STATIC), until=("t",), metrics=metrics or {})
    return ExperimentRun(experiment=experiment, digest="d", machines=MACHINES, trials=trials)


def column(of: ExperimentRun, scheme: str = "static") -> SchemeResult:
    return next(each for each in summarize_trials(of) if each.scheme.name == scheme)


def load(at: float, cores: float, memory: float = 0.0, bytes_per_s: float = 0.0) -> LoadSample:
    return LoadSample(at=at, cores=cores, memory=memory, bytes_per_s=bytes_per_s)


def means(found: tuple[Estimate | None, ...]) -> list[float | None]:
    return [figure.mean if figure else None for figure in found]


def test_loads_are_weighted_by_time() -> None:
    """4 cores for 10 s, then a fall to 0 within 30 s: (4 * 10 + 2 * 30) / 40 = 2.5 of 4 cores. A mean of the samples were 2.67."""
    loads = {
        "edge1": (load(40.0, 0.0), load(0.0, 4.0, 500.0, 2e6), load(10.0, 4.0, 500.0, 4e6)),
        "edge2": (load(5.0, 1.0, 100.0, 1e6),),
    }
    figures = column(run(trial(loads=loads))).estimates
    assert means(figures["cpu"]) == [pytest.approx(62.5), pytest.approx(50.0)]
    assert means(figures["cpu peak"]) == [100.0, 50.0]
    assert means(figures["memory"]) == [pytest.approx(31.25), 10.0]
    assert means(figures["throughput"]) == [pytest.approx((3.0 * 10 + 2.0 * 30) / 40), 1.0]


def test_under_local_execution_the_robots_count_together() -> None:
    found = column(
        run(
            trial(
                "local",
                loads={"robot1": (load(0, 1.0),), "robot2": (load(0, 0.5),), "edge1": (load(0, 4.0),)},
            )
        ),
        "local",
    )
    assert means(found.estimates["cpu"]) == [75.0]
    assert found.hosts == ()
    assert column(run(trial())).hosts == ("edge1", "edge2")


def test_trials_are_summed_up() -> None:
    trials = [
        trial(
            repetition=1,
            latency=60.0,
            unplaced=3,
            handoffs=(HandoffRecord(task="t", source="a", target="b", at=1.0, downtime=2.0),),
        ),
        trial(
            repetition=2,
            latency=120.0,
            handoffs=(HandoffRecord(task="t", source="a", target="b", at=1.0),) * 2,
        ),
        trial(repetition=3, latency=180.0, finished=False),
    ]
    found = column(run(*trials))
    assert (found.runs, found.unfinished, found.unplaced) == (3, 1, 3)
    assert found.estimates["latency"] == (
        Estimate(mean=2.0, std=1.0, half_ci95=close_to(2.48414, abs=1e-5), count=3),
    )
    assert found.estimates["handoffs"][0] == Estimate(
        mean=1.0, std=1.0, half_ci95=close_to(2.48414, abs=1e-5), count=3
    )
    assert means(found.estimates["unplaced"]) == [1.0]
    assert found.estimates["downtime"] == (Estimate(mean=2.0),)


@pytest.mark.parametrize(("summary", "expected"), [("mean", 2.5), ("last", 2.0), ("min", 1.0), ("max", 4.0)])
def test_readings_are_one_number_per_task_and_then_their_mean(summary: str, expected: float) -> None:
    """Tasks of 1, 2, 3 and of 1, 5: the mean of the tasks' means is not that of all readings."""
    first = tuple(MetricReading(at=float(at), value=value) for at, value in ((3, 3.0), (1, 1.0), (2, 2.0)))
    second = (MetricReading(at=1.0, value=5.0), MetricReading(at=2.0, value=1.0))
    found = column(
        run(
            trial(readings={"fps": {"a": first, "b": second, "c": ()}}),
            metrics={"fps": MetricAggregation(summary)},
        )
    )
    assert found.metrics["fps"] == Estimate(mean=expected)


def test_what_was_not_measured_is_nothing_and_no_zero() -> None:
    found = column(
        run(
            trial(loads={"edge1": (load(0.0, 4.0),)}),
            trial(repetition=2),
            metrics={"fps": MetricAggregation.MEAN},
        )
    )
    assert found.estimates["cpu"] == (Estimate(mean=100.0), None)
    assert found.estimates["downtime"] == (None,)
    assert found.metrics == {"fps": None}
    nothing = column(run(trial()), "local")
    assert (nothing.runs, nothing.unfinished) == (0, 0)
    assert nothing.estimates.keys() == found.estimates.keys()
    assert set(nothing.estimates.values()) == {(None,)}


@pytest.mark.parametrize("wild", [1e308, -1e308, 1e100, float("inf"), float("nan")])
def test_what_cannot_be_reckoned_with_is_none(wild: float) -> None:
    readings = {
        "fps": {
            "a": (
                MetricReading(at=1.0, value=4.0),
                MetricReading(at=2.0, value=wild),
                MetricReading(at=3.0, value=wild),
            )
        }
    }
    loads = {
        "edge1": (load(0.0, wild, 100.0), load(1.0, wild, 100.0)),
        "edge2": (load(0.0, wild), load(0.0, 1.0)),
    }
    found = column(
        run(
            *(trial(repetition=number, readings=readings, loads=loads) for number in (1, 2)),
            metrics={"fps": MetricAggregation.MEAN},
        )
    )
    assert found.metrics["fps"] == Estimate(mean=4.0, count=2)
    assert means(found.estimates["cpu"]) == [None, 50.0]
    assert means(found.estimates["memory"])[0] == 10.0


def test_maps_are_those_that_the_experiment_names() -> None:
    found = summarize_trials(a_run(trials=4))
    assert found[0].maps.keys() == {"ssim"}
    assert found[0].maps["ssim"] is not None
    assert found[0].maps["ssim"].count == 3
    assert found[2].maps == {"ssim": None}


@given(st.integers(0, 10_000), st.integers(0, 21))
@settings(deadline=None, max_examples=25)
def test_neither_the_order_of_trials_nor_of_samples_makes_a_difference(seed: int, count: int) -> None:
    whole = a_run(trials=count, seed=seed % 3)
    dice = random.Random(seed)
    trials = [
        replace(each, loads={host: tuple(dice.sample(rows, len(rows))) for host, rows in each.loads.items()})
        for each in whole.trials
    ]
    dice.shuffle(trials)
    assert summarize_trials(replace(whole, trials=tuple(trials))) == summarize_trials(whole)


loads_of_a_host = st.lists(
    st.builds(load, st.floats(0, 1e4), st.floats(0, 64), st.floats(0, 1e12), st.floats(0, 1e10)),
    min_size=1,
    max_size=12,
)


@given(st.lists(loads_of_a_host, min_size=1, max_size=4))
@settings(deadline=None)
def test_means_lie_between_the_least_and_the_most(trials: list[list[LoadSample]]) -> None:
    found = column(
        run(
            *(
                trial(repetition=number, loads={"edge1": tuple(loads)})
                for number, loads in enumerate(trials, 1)
            )
        )
    )
    every = [each for loads in trials for each in loads]
    shares = {
        "cpu": [100 * each.cores / 4 for each in every],
        "memory": [100 * each.memory / 1000 for each in every],
        "throughput": [each.bytes_per_s / 1e6 for each in every],
    }
    for metric, values in shares.items():
        figure = found.estimates[metric][0]
        assert figure is not None
        slack = 1e-6 * max(values) + 1e-9
        assert min(values) - slack <= figure.mean <= max(values) + slack
        assert figure.count == len(trials)
    peak = found.estimates["cpu peak"][0]
    assert peak is not None
    assert peak.mean <= max(shares["cpu"]) + 1e-6
