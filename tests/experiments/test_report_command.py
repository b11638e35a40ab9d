# SPDX-License-Identifier: Apache-2.0
"""The command report: the files written, and the message without a finished trial."""

from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.experiments.files.run_directory import save_run, save_trial
from edgectl.experiments.model.experiment import ExperimentRun as Measured
from tests.cli.conftest import Run
from tests.experiments.sample_runs import SCHEMES, a_run


def kept(directory: Path, run: Measured) -> Path:
    save_run(directory, run)
    for trial in run.trials:
        save_trial(directory, trial)
    return directory


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_newest_run_is_reported_beside_its_files(run: Run) -> None:
    directory = kept(Path("runs/mission"), without_series(a_run(SCHEMES[:1], 1)))
    said = run("report")
    assert (said.code, said.out, said.err) == (0, "runs/mission/report.html\n", "")
    text = (directory / "report.html").read_text()
    assert text.startswith("<!DOCTYPE html>")
    assert "LATENCY" in text
    assert run("report", "runs/mission").code == 0
    assert (directory / "report.html").read_text() == text


def test_the_answer_and_its_bound_open_the_page(run: Run) -> None:
    kept(Path("runs/mission"), without_series(a_run(SCHEMES[1:3], 3)))
    assert run("report").code == 0
    assert (
        '<p class="answer">utility cpu finished the mission' in Path("runs/mission/report.html").read_text()
    )
    assert run("report", "--equivalence", "90%").code == 0
    text = Path("runs/mission/report.html").read_text()
    assert "within 90 %" in text
    assert "EQUAL P" in text
    said = run("report", "--equivalence", "0%")
    assert (said.code, "--equivalence: must be above 0%" in said.err) == (64, True)


def test_figures_are_files_of_their_own(run: Run) -> None:
    directory = kept(Path("elsewhere"), without_series(a_run(SCHEMES[2:3], 1)))
    said = run("report", "elsewhere", "--out", "page.html", "--figures", "paper/figures")
    assert said.code == 0
    written = [Path(line) for line in said.out.splitlines()]
    assert written[0] == Path("page.html")
    assert not (directory / "report.html").exists()
    assert sorted(path.name for path in Path("paper/figures").iterdir()) == sorted(
        path.name for path in written[1:]
    )
    assert {path.stem for path in written[1:]} == {"latency", "tasks", "gantt", "handoffs"}
    assert {path.suffix for path in written[1:]} == {".svg", ".pdf"}
    assert all(path.stat().st_size > 1000 for path in written)


def test_nothing_to_report_is_said_with_what_to_do(run: Run) -> None:
    said = run("report")
    assert said.code == 64
    assert "no run in runs/" in said.err
    assert "edgectl experiment run SPEC" in said.err
    nowhere = run("report", "nowhere")
    assert nowhere.code == 64
    assert "no run in nowhere" in nowhere.err
    kept(Path("runs/new"), replace(a_run(SCHEMES[:1], 1), trials=()))
    said = run("report")
    assert said.code == 64
    assert "runs/new has no finished trial yet" in said.err
    assert not Path("runs/new/report.html").exists()


def test_a_place_that_cannot_be_written_is_named(run: Run) -> None:
    kept(Path("runs/mission"), nothing_but_latencies())
    Path("file").write_text("")
    said = run("report", "--out", "file/page.html")
    assert said.code == 1
    assert "cannot write file/page.html" in said.err
    said = run("report", "--figures", "file")
    assert said.code == 1
    assert "cannot create file" in said.err


def without_series(run: Measured) -> Measured:
    """Four figures instead of nine: each takes a second as a PDF."""
    return replace(run, trials=tuple(replace(trial, loads={}, readings={}) for trial in run.trials))


def nothing_but_latencies() -> Measured:
    run = a_run(SCHEMES[:1], 1)
    return replace(run, trials=(replace(run.trials[0], loads={}, readings={}, spans=(), completed={}),))
