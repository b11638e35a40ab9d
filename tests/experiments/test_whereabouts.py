# SPDX-License-Identifier: Apache-2.0
"""Where the detections of the patrol stand: by the areas of the run, and in the model as docs/evaluation.md has it."""

from dataclasses import replace

import pytest

from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.model.experiment import PlacementInterval
from tests.docs import evaluation
from tests.experiments.cycle_times import count_burst_readings
from tests.experiments.whereabouts import RUN, TASK, measure_whereabouts


def test_areas_and_beliefs_are_those_of_the_run() -> None:
    """One detection of robot2, which is near edge2, then edge3, then edge1: it stays on edge2."""
    run = load_run(RUN)
    trial = next(each for each in run.trials if each.scheme == "static")
    at = {each.event: each.at for each in trial.events}
    begin, end = at["robot2-joins"], trial.completed[f"{TASK}robot2"]
    span = PlacementInterval(task=f"{TASK}robot2", host="edge2", start=begin, end=end)
    found = measure_whereabouts(replace(run, trials=(replace(trial, spans=(span,)),)), "static")
    assert found.near == pytest.approx((at["robot2-area2"] - begin) / (end - begin))
    assert found.hosts == {"edge2": 1.0}
    assert 0.0 < found.mistaken < 1.0 - found.near
    blind = replace(trial, spans=(span,), links={})
    assert measure_whereabouts(replace(run, trials=(blind,)), "static").mistaken == 0.0


@pytest.mark.parametrize("scheme", ["static", "least-loaded", "utility all"])
def test_the_page_says_how_often_links_in_use_were_read(scheme: str) -> None:
    windows, read = count_burst_readings(load_run(RUN), scheme)
    assert f"{100 * read / windows:.0f} % (`{scheme}`)" in evaluation.PAGE.read_text()


@pytest.mark.slow
def test_the_model_stands_where_the_page_says() -> None:
    text = evaluation.PAGE.read_text()
    assert "<!-- from the model -->\n|" in text
    assert evaluation.write_model(text) == text, "make evaluation"
