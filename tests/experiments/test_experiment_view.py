# SPDX-License-Identifier: Apache-2.0
"""The table of an experiment on real hosts."""

import json
from dataclasses import replace
from typing import Any

import pytest
import yaml

from edgectl.experiments.model.comparison import (
    Estimate,
    EventResult,
    Interval,
    RecoveryResult,
    SchemeComparison,
    SchemeResult,
)
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
EVENT = EventResult(
    event="far",
    kind="link",
    subject="edge1",
    runs=3,
    failed=1,
    at=Estimate(mean=30.0),
    recoveries=RecoveryResult(
        count=4, not_recovered=1, recovery=Estimate(mean=12.34, std=1.0, half_ci95=2.0, count=3)
    ),
)
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
COMPARED = [
    SchemeComparison(
        metric="latency", scheme="utility network", base="static", pairs=3, missing=1, difference=Interval(mean=-0.1, low=-0.2, high=-0.0001),
        ratio=Interval(mean=0.8, low=0.7, high=0.9), p=0.01, p_holm=0.02, effect=-1.24, bound=0.05, equal_p=0.8, equal_p_holm=1.0,
    ),
    SchemeComparison(
        metric="fps", scheme="utility network", base="static", pairs=3, missing=0, difference=Interval(mean=1.0), bound=0.05,
    ),
]  # fmt: skip
TEXT = """\
SCHEME           LATENCY s     CPU %  MEMORY %  HANDOFFS   FPS    LOSS   SSIM
local             45.0±7.5        99        99       1.5  9.50  0.0123  0.812
static            30.0±7.5   80/-/61   80/-/61       1.5  9.50  0.0123  0.812
utility network   24.0±7.5  55/52/50  55/52/50       1.5  9.50  0.0123  0.812

9 of 9 trials of mission; mean±half of the 95 % interval of the latency, means
  of the rest, by edge (edge1/edge2/edge3; local: mean of the robots).
local: trials ended by the time limit: 1
static: unplaced tasks, summed over all plans: 2
Latency as a share of local execution: static 0.67, utility network 0.53.
Latency as a share of static execution: utility network 0.80.
"""


def test_the_table_fits_80_columns() -> None:
    assert ExperimentView(run=RUN, results=DONE).table(RenderOptions(width=80)) == TEXT


def test_the_comparison_stands_below_the_table_and_the_answer_first_of_the_notes() -> None:
    view = ExperimentView(run=RUN, results=DONE, comparisons=COMPARED)
    parts = view.table(RenderOptions(width=80)).split("\n\n")
    assert parts[1:3] == [
        (
            "SCHEME           AGAINST       DIFFERENCE s              RATIO     P  EFFECT\n"
            "utility network   static  -6.0 [-12.0, 0.0]  0.80 [0.70, 0.90]  0.02    -1.2"
        ),
        "SCHEME           EQUAL P\nutility network     1.00",
    ]
    assert parts[3].startswith(
        "utility network finished the mission 20 % sooner than static (95 % interval 10\n"
        "  to 30 %, n = 3 pairs, p = 0.02 after Holm). Left out: 1 repetition with a\n"
    )
    assert "EQUAL P: two one-sided tests that the ratio is within 5 %, after Holm.\n" in parts[3]
    compared = [line.split() for line in view.wide(PLAIN).splitlines() if "FPS" in line.split()[3:4]]
    assert compared == [["utility", "network", "static", "FPS", "1.00", "-", "-", "-", "-"]]


def test_trials_are_counted_where_some_are_missing() -> None:
    text = ExperimentView(
        run=RUN, results=[*DONE[:2], column("utility all", 0.4, 55.0, 52.0, 50.0, runs=1)]
    ).table(PLAIN)
    lines = text.splitlines()
    assert lines[0].split()[:3] == ["SCHEME", "TRIALS", "LATENCY"]
    assert lines[3].split()[:4] == ["utility", "all", "1/3", "24.0"], "one trial has no interval"
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


def test_wide_has_every_metric_with_its_interval() -> None:
    text = ExperimentView(run=RUN, results=DONE).wide(PLAIN)
    head = "SCHEME TRIALS LATENCY s CPU % PEAK % MEMORY % MB/s HANDOFFS DOWNTIME s UNPLACED FPS LOSS SSIM"
    lines = text.splitlines()
    assert lines[0].split() == head.split()
    assert lines[3].split()[-6:] == ["1.5±1.2", "-", "0.0", "9.50±0.62", "0.0123±0.0025", "0.812±0.075"]
    assert "; mean±half of the 95 % interval, by edge" in text


def test_latencies_of_minutes_are_minutes_as_in_the_paper() -> None:
    text = ExperimentView(
        run=RUN, results=[column("local", 14.4, 99.0), column("static", 0.5, 1.0, 1.0, 1.0)]
    ).table(PLAIN)
    assert "LATENCY min" in text.splitlines()[0]
    assert text.splitlines()[1].split()[1] == "14.40±0.12"


def test_markdown_is_one_table_and_a_list() -> None:
    lines = ExperimentView(run=RUN, results=DONE).markdown().splitlines()
    table = [line for line in lines if line.startswith("|")]
    assert len(table) == 2 + len(DONE)
    assert {line.count("|") for line in table} == {14}
    assert table[1].startswith("| --- | ---: |")
    assert table[4].startswith("| utility network | 3/3 | 24.0±7.5 |")
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


def test_recovery_has_a_table_of_its_own() -> None:
    never = RecoveryResult(count=2, not_recovered=2, recovery=None)
    once = RecoveryResult(count=1, not_recovered=0, recovery=Estimate(mean=3.0))
    results = [
        replace(DONE[0], events=(EVENT,), recoveries={"link": EVENT.recoveries, "load": once}),
        replace(DONE[1], recoveries={"link": never}),
        DONE[2],
    ]
    view = ExperimentView(run=RUN, results=results)
    lines = view.table(RenderOptions(width=80)).splitlines()
    table = lines[lines.index("") + 1 : lines.index("") + 5]
    assert [line.rstrip() for line in table] == [
        "RECOVERY s                        LINK  LOAD",
        "local            12.3±2.0 (1 of 4 not)   3.0",
        "static                   not recovered     -",
        "utility network                      -     -",
    ]
    assert "local: event far failed 1 of 4 times" in lines
    assert (
        "| RECOVERY s | LINK | LOAD |\n| --- | ---: | ---: |\n| local | 12.3±2.0 (1 of 4 not) | 3.0 |"
        in view.markdown()
    )
    item: Any = view.item()
    assert item["schemes"][0]["mission_events"] == [
        {
            "event_name": "far",
            "kind": "link",
            "subject": "edge1",
            "run_count": 3,
            "begin_s": 30.0,
            "failures": 1,
            "occurrences": 4,
            "not_recovered": 1,
            "recovery_s": 12.34,
            "recovery_half_ci95_s": 2.0,
        }
    ]
    assert item["schemes"][0]["recoveries"]["load"]["recovery_half_ci95_s"] is None
    assert item["schemes"][1]["recoveries"] == {
        "link": {"occurrences": 2, "not_recovered": 2, "recovery_s": None, "recovery_half_ci95_s": None}
    }
    assert (item["schemes"][2]["mission_events"], item["schemes"][2]["recoveries"]) == ([], {})
