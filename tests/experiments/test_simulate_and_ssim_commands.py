# SPDX-License-Identifier: Apache-2.0
"""The commands simulate and ssim."""

import json
from pathlib import Path

import pytest

from edgectl.experiments.files.run_directory import save_run, save_trial
from edgectl.experiments.scheme_results import summarize_trials
from edgectl.experiments.views.scheme_table import get_mean_latency_min
from tests.cli.conftest import Run
from tests.experiments.sample_runs import a_run
from tests.views.fixtures import ROOT

SCENARIO = str(ROOT / "docs" / "scenarios" / "paper-2.yaml")


@pytest.fixture
def measured(tmp_path: Path) -> Path:
    """The directory of a run of which the last scheme is missing."""
    found = a_run(trials=15)
    save_run(tmp_path / "run", found)
    for trial in found.trials:
        save_trial(tmp_path / "run", trial)
    return tmp_path / "run"


def test_the_model_stands_beside_what_was_measured(run: Run, measured: Path) -> None:
    said = run(
        "simulate",
        SCENARIO,
        "-n",
        "2",
        "--policy",
        "local,static,paper",
        "--weights",
        "cpu",
        "--against",
        str(measured),
        "-o",
        "json",
    )
    assert (said.code, said.err) == (0, "")
    document = json.loads(said.out)["item"]
    schemes = {scheme["scheme"]: scheme for scheme in document["schemes"]}
    assert list(schemes) == ["local", "static", "paper cpu"]
    static = schemes["static"]
    assert "published" not in static
    model, real, off = (static[key] for key in ("figures", "reference_figures", "off_by"))
    for metric in ("latency", "cpu", "memory", "throughput"):
        for figure, known, share in zip(model[metric], real[metric], off[metric], strict=True):
            assert share == pytest.approx((figure["mean"] - known) / known, rel=1e-5)
    assert len(off["cpu"]) == 3
    assert schemes["paper cpu"]["reference_figures"] == {}
    assert document["notes"] == [
        "Measured: 15 trials of mission.",
        "Measured, but not simulated: utility cpu, utility memory, utility network.",
        "Simulated, but not measured: paper cpu.",
        "Metrics not simulated: loss.",
    ]


def test_the_text_says_measured_and_not_published(run: Run, measured: Path) -> None:
    said = run("simulate", SCENARIO, "-n", "1", "--policy", "local,static", "--against", str(measured))
    assert said.code == 0
    lines = [line.split()[0:2] for line in said.out.splitlines()[:7]]
    assert [words[0] for words in lines] == [
        "SCHEME",
        "local",
        "measured",
        "off",
        "static",
        "measured",
        "off",
    ]
    assert "published" not in said.out
    local, static = (get_mean_latency_min(column) for column in summarize_trials(a_run())[:2])
    assert local
    assert static
    assert f"(measured {static / local:.2f})." in said.out


def test_what_was_published_of_maps_stands_in_wide(run: Run) -> None:
    said = run("simulate", SCENARIO, "-n", "1", "--policy", "static", "-o", "wide")
    head, *rows = (line.split() for line in said.out.splitlines()[:4])
    place = head.index("SSIM") - len(head)
    assert [row[place] for row in rows] == ["-", "0.74", "-"]
    assert "SSIM" not in run("simulate", SCENARIO, "-n", "1", "--policy", "static").out


def test_a_directory_that_is_no_run_is_told_before_anything_is_computed(run: Run, tmp_path: Path) -> None:
    said = run("simulate", SCENARIO, "--against", str(tmp_path), "-n", "1000")
    assert said.code == 64
    assert said.out == ""
    assert "no run in" in said.err


def test_maps_are_compared_and_what_is_none_is_told(run: Run) -> None:
    examples = ROOT / "docs" / "examples"
    made, truth = str(examples / "map.yaml"), str(examples / "world.yaml")
    assert run("ssim", truth, truth).out == "1.0000\n"
    said = run("ssim", made, truth, "-o", "json")
    assert 0.5 < json.loads(said.out)["item"]["ssim"] < 0.99
    refused = run("ssim", str(examples / "map.pgm"), truth)
    assert (refused.code, refused.out) == (64, "")
    assert "36x22 pixels" in refused.err
    assert run("ssim", str(examples / "none.yaml"), truth).code == 1
