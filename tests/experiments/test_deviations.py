# SPDX-License-Identifier: Apache-2.0
"""Deviations of the model of the patrol from its run, taken apart as docs/evaluation.md has it."""

import re
from dataclasses import replace
from statistics import fmean

import pytest

from edgectl.experiments.files.run_directory import load_run
from tests.docs import evaluation
from tests.experiments.deviations import (
    find_link_recovery,
    hold_readings,
    measure_course,
    measure_idle_cores,
    measure_picture_s,
    measure_recoveries,
    measure_starts,
)
from tests.experiments.edge_pictures import measure_edges, read_counter
from tests.experiments.whereabouts import RUN


def test_a_value_holds_from_one_reading_to_the_next() -> None:
    """It is 2 from second 1 on, falls to 1 at 3, stands still from 6 to 7 and then is 4: readings at 2, 5 and 9."""
    course = ((1.0, 2.0), (3.0, 1.0), (6.0, None), (7.0, 4.0))
    read = hold_readings(course, [0.5, 2.0, 5.0, 6.5, 9.0])
    assert read[:3] == ((1.0, 1.0), (2.0, 2.0), (3.0, 2.0))
    assert dict(read) | {6.5: None} == {
        1.0: 1.0, 2.0: 2.0, 3.0: 2.0, 5.0: 1.0, 6.0: None, 6.5: None, 7.0: 1.0, 9.0: 4.0,
    }  # fmt: skip


def test_changes_at_the_begin_count_only_where_they_are_asked_for() -> None:
    found = measure_recoveries(load_run(RUN), "utility all")
    every, later = (find_link_recovery(found, first=first) for first in (True, False))
    assert (every.count, later.count) == (70, 60)
    assert every.not_recovered == later.not_recovered
    assert every.recovery is not None
    assert later.recovery is not None
    assert every.recovery.mean < later.recovery.mean


def test_a_picture_is_what_robots_use_more_of() -> None:
    """With 1 ms more for each picture of the trials of local, a picture takes 1 ms more."""
    run = load_run(RUN)
    trials = []
    for trial in run.trials:
        counts = trial.readings["latency/values"] if trial.scheme == "local" else {}
        more = {task.removeprefix("detection-"): each[-1].value / 1000 for task, each in counts.items()}
        usage = {
            host: replace(used, cpu_s=used.cpu_s + more.get(host, 0.0)) for host, used in trial.usage.items()
        }
        trials.append(replace(trial, usage=usage))
    other = replace(run, trials=tuple(trials))
    assert measure_idle_cores(other) == measure_idle_cores(run)
    assert measure_picture_s(other) - measure_picture_s(run) == pytest.approx(0.001, rel=0.05)


def test_a_counter_rises_between_its_readings() -> None:
    points = [(1.0, 0.0), (3.0, 4.0), (3.0, 6.0), (5.0, 7.0)]
    assert [read_counter(points, at) for at in (1.0, 2.0, 4.0, 9.0)] == [0.0, 2.0, 6.5, 7.0]


def test_each_picture_of_the_run_is_of_one_edge() -> None:
    run = load_run(RUN)
    measured = [measure_edges(run, "utility all"), measure_edges(run, "static")]
    counted = [3 * fmean(measure_course(run, scheme).made) for scheme in ("utility all", "static")]
    assert [sum(each.made for each in found.values()) for found in measured] == pytest.approx(
        counted, rel=0.04
    )


def test_local_is_as_the_page_says() -> None:
    text = evaluation.PAGE.read_text()
    assert "<!-- from the model: local -->\n|" in text
    assert evaluation.write_model_parts(text, "local") == text, "make evaluation"


def read_rows(part: str) -> dict[str, list[float]]:
    """The numbers of each row of a table of the page."""
    table = evaluation.PAGE.read_text().partition(f"<!-- from the model: {part} -->")[2].partition("<!--")[0]
    rows = ([each.strip() for each in line.strip("|").split("|")] for line in table.splitlines())
    found = {
        name: [float(number[0]) for cell in cells if (number := re.match(r"[0-9.]+", cell))]
        for name, *cells in rows
    }
    return {name: numbers for name, numbers in found.items() if numbers}


def test_sentences_have_the_figures_of_the_tables() -> None:
    text = re.sub(r"[*`]|\]\([^)]*\)", "", evaluation.PAGE.read_text())
    plain = " ".join(text.replace("[", "").split())
    found = read_rows("recoveries")
    model, measured = found["in the model, without these"], found["measured, without changes at the begin"]
    assert f"Without them {model[0]} and {model[1]} s, measured {measured[0]} and {measured[1]}" in plain
    assert f"What is left, {measured[1] - model[1]:.1f} s of utility all" in plain
    off = [100 * (simulated / counted - 1) for _, counted, simulated, *_ in read_rows("pictures").values()]
    said = "counted {:.0f} %), CPU|Counted pictures are {:.0f} % too few, {:.0f} % and {:.0f} % too many"
    for claim in said.format(-off[0], -off[1], *off[2:]).split("|"):
        assert claim in plain, claim
    edges = read_rows("edges")
    (own, model_own, late), (third, model_third, also), (least, model_least, more) = (
        edges[name][:3] for name in ("utility all, edge2", "utility all, edge3", "least-loaded, edge3")
    )
    assert f"so {model_own:.0f} pictures of a mission are looked at there and not {own:.0f}" in plain
    assert (
        f"on edge3 {model_third:.0f} and not {third:.0f}, with least-loaded {model_least:.0f} and not {least:.0f}"
        in plain
    )
    assert f"Of these {late:.0f}, {also:.0f} and {more:.0f} come after their robot's last stop" in plain
    found, run = read_rows("local"), load_run(RUN)
    assert f"a picture takes {1000 * measure_picture_s(run):.0f} ms of its robot in the run" in plain
    assert f"an idle host {measure_idle_cores(run):.3f} cores and not 0.016" in plain
    both, real, alone = found["in the model, both"], found["measured"], found["in the model"]
    lacks = real[2] - both[2]
    assert f"{lacks:.2f} pictures a second are still missing ({100 * lacks / real[2]:.0f} %; ADR 129" in plain
    assert f"and {both[3] - real[3]:.2f} scans too many" in plain
    assert (
        f"{alone[-1] - both[-1]:.0f} s longer, and without that it would be {real[-1] - both[-1]:.0f} s too short"
        in plain
    )
    assert f"Detections begin {real[0] - alone[0]:.1f} s too soon" in plain
    assert f"the cycle takes {sum(fmean(each) for each in measure_starts(run, 'local')):.1f} s" in plain


@pytest.mark.slow
def test_the_tables_of_the_model_are_as_the_page_says() -> None:
    text = evaluation.PAGE.read_text()
    assert "<!-- from the model: recoveries -->\n|" in text
    assert evaluation.write_model_parts(text, *evaluation.MODEL_PARTS) == text, "make evaluation"
