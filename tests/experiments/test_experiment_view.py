# SPDX-License-Identifier: Apache-2.0
"""The table of an experiment on real hosts."""

import json
from typing import Any

import pytest
import yaml

from edgectl.experiments.model.comparison import Estimate, SchemeResult
from edgectl.experiments.model.experiment import Experiment, ExperimentRun, MapPair, MetricAggregation
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.scheme_results import summarize_trials
from edgectl.experiments.views.experiment import ExperimentView
from edgectl.model.policy import Policy
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.text import PLAIN, RenderOptions
from tests.experiments.sample_runs import a_run

POLICY = Policy()
EXPERIMENT = Experiment(
    name="mission", schemes=(), until=("merge",), repetitions=3, metrics={"fps": MetricAggregation.MEAN, "loss": MetricAggregation.LAST},
    maps={"ssim": MapPair(task="merge", file="map.yaml", truth="world.yaml")},
)  # fmt: skip
RUN = ExperimentRun(experiment=EXPERIMENT, digest="0123", machines={})
WHOLE = ("latency", "handoffs", "downtime", "unplaced")


def column(
    name: str, latency_min: float, *cpu: float | None, runs: int = 3, fps: float | None = 9.5
) -> SchemeResult:
    def figure(mean: float | None, std: float = 0.0) -> Estimate | None:
        return None if mean is None else Estimate(mean=mean, std=std, half_ci95=2.5 * std, count=runs)

    figures = {
        metric: tuple(figure(each) for each in cpu) for metric in ("cpu", "cpu peak", "memory", "throughput")
    }
    figures |= {
        "latency": (figure(latency_min, 0.05),),
        "handoffs": (figure(1.5, 0.5),),
        "downtime": (None,),
        "unplaced": (figure(0.0),),
    }
    return SchemeResult(
        scheme=Scheme(name=name, policy=POLICY), runs=runs, unfinished=int(name == "local"), unplaced=2 if name == "static" else 0,
        estimates=figures, hosts=("edge1", "edge2", "edge3") if len(cpu) == 3 else (),
        metrics={"fps": figure(fps, 0.25), "loss": figure(0.0123, 0.001)}, maps={"ssim": figure(0.8125, 0.03)},
    )  # fmt: skip


DONE = [
    column("local", 0.75, 98.7),
    column("static", 0.5, 80.2, None, 61.0),
    column("utility network", 0.4, 55.0, 52.0, 49.9),
]
TEXT = """\
SCHEME           LATENCY s     CPU %  MEMORY %  HANDOFFS   FPS    LOSS   SSIM
local             45.0±3.0        99        99       1.5  9.50  0.0123  0.812
static            30.0±3.0   80/-/61   80/-/61       1.5  9.50  0.0123  0.812
utility network   24.0±3.0  55/52/50  55/52/50       1.5  9.50  0.0123  0.812

9 of 9 trials of mission; mean±deviation of the latency, means of the rest, by
  edge (edge1/edge2/edge3; local: mean of the robots).
local: trials ended by the time limit: 1
static: unplaced tasks, summed over all plans: 2
Latency as a share of local execution: static 0.67, utility network 0.53.
Latency as a share of static execution: utility network 0.80.
"""


def test_the_table_fits_80_columns() -> None:
    assert ExperimentView(run=RUN, results=DONE).table(RenderOptions(width=80)) == TEXT


def test_trials_are_counted_where_some_are_missing() -> None:
    text = ExperimentView(
        run=RUN, results=[*DONE[:2], column("utility all", 0.4, 55.0, 52.0, 50.0, runs=1)]
    ).table(PLAIN)
    lines = text.splitlines()
    assert lines[0].split()[:3] == ["SCHEME", "TRIALS", "LATENCY"]
    assert lines[3].split()[:4] == ["utility", "all", "1/3", "24.0"], "one trial has no deviation"
    assert "7 of 9 trials of mission" in text


def test_a_scheme_without_a_trial_has_no_figures() -> None:
    run = a_run(trials=3)
    lines = ExperimentView(run=run, results=summarize_trials(run)).table(PLAIN).splitlines()
    assert lines[2].split() == ["static", "0/3", *["-"] * 7]
    assert not [line for line in lines if line.startswith("Latency as a share")]


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("output", [OutputFormat.TABLE, OutputFormat.WIDE])
def test_what_does_not_fit_stands_below(output: OutputFormat, width: int) -> None:
    run = a_run()
    whole, fitted = (
        render_view(ExperimentView(run=run, results=summarize_trials(run)), output, look)
        for look in (PLAIN, RenderOptions(width=width))
    )
    head, rows = whole.splitlines()[0], whole.split("\n\n")[0]
    assert all(len(line) <= width for line in fitted.splitlines()), fitted
    parts = fitted.split("\n\n")[:-1]
    assert all(
        part.startswith("SCHEME") and len(part.splitlines()) == len(rows.splitlines()) for part in parts
    )
    assert [word for part in parts for word in part.splitlines()[0].split()[1:]] == head.split()[1:]
    assert [word for part in parts for word in part.splitlines()[2].split()[1:]] == rows.splitlines()[
        2
    ].split()[1:]


def test_wide_has_every_metric_with_its_deviation() -> None:
    text = ExperimentView(run=RUN, results=DONE).wide(PLAIN)
    head = "SCHEME TRIALS LATENCY s CPU % PEAK % MEMORY % MB/s HANDOFFS DOWNTIME s UNPLACED FPS LOSS SSIM"
    lines = text.splitlines()
    assert lines[0].split() == head.split()
    assert lines[3].split()[-6:] == ["1.5±0.5", "-", "0.0±0.0", "9.50±0.25", "0.0123±0.0010", "0.812±0.030"]
    assert "; mean±deviation, by edge" in text


def test_latencies_of_minutes_are_minutes_as_in_the_paper() -> None:
    text = ExperimentView(
        run=RUN, results=[column("local", 14.4, 99.0), column("static", 0.5, 1.0, 1.0, 1.0)]
    ).table(PLAIN)
    assert "LATENCY min" in text.splitlines()[0]
    assert text.splitlines()[1].split()[1] == "14.40±0.05"


def test_markdown_is_one_table_and_a_list() -> None:
    lines = ExperimentView(run=RUN, results=DONE).markdown().splitlines()
    table = [line for line in lines if line.startswith("|")]
    assert len(table) == 2 + len(DONE)
    assert {line.count("|") for line in table} == {14}
    assert table[1].startswith("| --- | ---: |")
    assert table[4].startswith("| utility network | 3/3 | 24.0±3.0 |")
    assert "- Latency as a share of static execution: utility network 0.80." in lines


def test_the_documents_hold_every_figure_and_null_where_there_is_none() -> None:
    view = ExperimentView(run=RUN, results=DONE)
    document: Any = view.document()["item"]
    for output, parse in ((OutputFormat.JSON, json.loads), (OutputFormat.YAML, yaml.safe_load)):
        assert parse(render_view(view, output, PLAIN))["item"] == document
    assert (document["experiment"], document["digest"], document["planned"], document["trials"]) == (
        "mission",
        "0123",
        3,
        9,
    )
    static = document["schemes"][1]
    assert static["host_names"] == ["edge1", "edge2", "edge3"]
    assert static["figures"]["latency"] == [{"mean": 0.5, "std": 0.05, "half_ci95": 0.125, "run_count": 3}]
    assert [each and each["mean"] for each in static["figures"]["cpu"]] == [80.2, None, 61]
    assert static["figures"]["downtime"] == [None]
    assert static["metrics"]["fps"]["mean"] == 9.5
    assert static["maps"]["ssim"]["mean"] == 0.8125
    single: Any = ExperimentView(run=RUN, results=[column("static", 0.5, 1.0, 1.0, 1.0, runs=1)]).document()[
        "item"
    ]
    assert single["schemes"][0]["figures"]["latency"] == [
        {"mean": 0.5, "std": None, "half_ci95": None, "run_count": 1}
    ]


def test_names_steer_no_terminal() -> None:
    run = a_run(name="mis\x1b[31msion")
    view = ExperimentView(run=run, results=summarize_trials(run))
    for output in (
        OutputFormat.TABLE,
        OutputFormat.WIDE,
        OutputFormat.JSON,
        OutputFormat.YAML,
        OutputFormat.MARKDOWN,
    ):
        assert "\x1b" not in render_view(view, output, PLAIN)
