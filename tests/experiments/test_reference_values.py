# SPDX-License-Identifier: Apache-2.0
"""Reference values of a simulation, matched by the names of schemes and hosts, never by order."""

from dataclasses import replace

import pytest

from edgectl.experiments.model.comparison import Estimate, SchemeResult
from edgectl.experiments.model.experiment import ExperimentRun, HostCapacity, MetricAggregation
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.reference_values import reference_from_run, reference_from_scenario
from edgectl.experiments.scheme_results import summarize_trials
from edgectl.model.inventory import Role
from edgectl.model.policy import Policy
from tests.experiments.sample_runs import a_run

HOSTED = ("cpu", "cpu peak", "memory", "throughput", "rate")


def model(name: str, *hosts: str) -> SchemeResult:
    figures: dict[str, tuple[Estimate, ...]] = {
        metric: (Estimate(mean=1.0),) * max(1, len(hosts)) for metric in HOSTED
    }
    whole: dict[str, tuple[Estimate, ...]] = {
        metric: (Estimate(mean=1.0),) for metric in ("latency", "handoffs")
    }
    return SchemeResult(
        scheme=Scheme(name=name, policy=Policy()),
        runs=5,
        unfinished=0,
        unplaced=0,
        estimates=figures | whole,
        hosts=hosts,
    )


def real(run: ExperimentRun, name: str) -> SchemeResult:
    return next(each for each in summarize_trials(run) if each.scheme.name == name)


def test_published_latencies_are_compared_by_welch() -> None:
    """Scenario 1 of the paper, by hand: (9.93 - 6.93) / sqrt((2.15^2 + 3.42^2) / 5) = 1.661 at 6.73: p = .14."""
    published = {
        "utility all": {"latency": (6.93,)},
        "static": {"latency": (9.93,)},
        "other": {"cpu": (1.0,)},
    }
    scenario = Scenario(
        name="paper", assumptions=(), hosts={}, jobs=(), published=published,
        published_std={"static": 2.15, "utility all": 3.42}, published_runs=5,
    )  # fmt: skip
    assert reference_from_scenario(scenario).notes == (
        "Published latencies against static (Welch's test, 5 trials each, not corrected for their number): utility all p = 0.14.",
    )
    assert reference_from_scenario(replace(scenario, published_runs=1)).notes == ()
    assert reference_from_scenario(replace(scenario, published_std={})).notes == ()


def test_hosts_are_matched_by_their_names() -> None:
    run = a_run()
    expected = dict(
        zip(
            ("edge1", "edge2", "edge3"),
            (figure.mean for figure in real(run, "static").estimates["cpu"] if figure),
            strict=True,
        )
    )
    beside = reference_from_run([model("static", "edge3", "edge1", "edge9")], run)
    assert beside.means["static"]["cpu"] == (expected["edge3"], expected["edge1"], None)
    assert "Edges simulated, but not measured: edge9." in beside.notes
    assert "Edges measured, but not simulated: edge2." in beside.notes


def test_one_host_is_no_other_host() -> None:
    beside = reference_from_run([model("static", "lab7")], a_run())
    assert "cpu" not in beside.means["static"]
    assert beside.means["static"]["latency"] != (None,)


def test_the_mission_the_robots_and_the_application_are_compared_as_wholes() -> None:
    run = a_run()
    beside = reference_from_run([model("local"), model("static", "edge1", "edge2", "edge3")], run)
    local = real(run, "local")
    for metric in ("latency", "cpu", "memory", "throughput", "handoffs"):
        figure = local.estimates[metric][0]
        assert figure is not None
        assert beside.means["local"][metric] == (figure.mean,)
    fps, ssim = local.metrics["fps"], local.maps["ssim"]
    assert fps is not None
    assert ssim is not None
    assert beside.means["local"]["rate"] == (fps.mean,)
    assert beside.means["local"]["ssim"] == (ssim.mean,)
    assert beside.label == "measured"
    assert beside.notes == (
        "Measured: 18 trials of mission.",
        "Measured, but not simulated: utility cpu, utility memory, utility network, utility all.",
        "Metrics not simulated: loss.",
    )


def test_what_was_not_measured_is_said() -> None:
    beside = reference_from_run(
        [model("local"), model("paper cpu", "edge1"), model("utility all", "edge1")], a_run(trials=3)
    )
    assert set(beside.means) == {"local"}
    assert "Simulated, but not measured: paper cpu, utility all." in beside.notes
    assert "Measured: 3 trials of mission." in beside.notes


def test_a_run_without_anything_leaves_nothing_to_compare() -> None:
    run = a_run(trials=0)
    assert reference_from_run([model("local")], run).means == {}
    bare = replace(
        run, machines={"edge1": HostCapacity(role=Role.EDGE, cores=1.0, memory=1.0)}, trials=a_run().trials
    )
    assert reference_from_run([model("local")], bare).means["local"].keys() >= {"latency", "handoffs"}


@pytest.mark.parametrize(
    ("metrics", "modelled"),
    [({"rate": MetricAggregation.MEAN}, True), ({"loss": MetricAggregation.LAST}, False)],
)
def test_only_frames_are_modelled(metrics: dict[str, MetricAggregation], modelled: bool) -> None:
    run = a_run()
    trials = tuple(
        replace(trial, readings=dict.fromkeys(metrics, trial.readings["fps"])) for trial in run.trials
    )
    run = replace(run, experiment=replace(run.experiment, metrics=metrics), trials=trials)
    beside = reference_from_run([model("static", "edge1")], run)
    assert ("rate" in beside.means["static"]) is modelled
    assert any(note.startswith("Metrics not simulated") for note in beside.notes) is not modelled
