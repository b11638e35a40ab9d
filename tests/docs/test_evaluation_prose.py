# SPDX-License-Identifier: Apache-2.0
"""Figures in the sentences of docs/evaluation.md: each follows from the committed run, or from a table that a test compares."""

import random
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.weights import parse_weights
from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.comparison import SchemeResult
from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.experiments.model.schemes import build_schemes
from edgectl.experiments.scheme_comparison import MISSION_TIME, compare_schemes
from edgectl.experiments.scheme_results import summarize_trials
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.policy import PolicyName
from tests.docs import evaluation
from tests.experiments.whereabouts import measure_whereabouts

TEXT = evaluation.PAGE.read_text()
PLAIN = re.sub(r"[*`]|<!--.*?-->", "", " ".join(TEXT.split()))
LINKED = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", PLAIN)


def get_block(command: str) -> str:
    """The output below a command of the page, which tests/docs/test_pages.py compares with what it prints now."""
    return TEXT.partition(f"$ edgectl {command}\n")[2].partition("```")[0]


def read_column(block: str, row: str, place: int) -> str:
    """The column of the first line that begins so: columns are two spaces or more apart."""
    line = next(line for line in block.splitlines() if line.startswith(row))
    return re.split(r"\s{2,}", line.strip())[place]


def list_claims_about_the_run(run: ExperimentRun) -> Iterator[str]:
    """Sentences, or parts of them, with the figures of the run."""
    results = {result.scheme.name: result for result in summarize_trials(run)}
    compared = {
        each.base: each
        for each in compare_schemes(list(results.values()), run.experiment.equivalence)
        if (each.metric, each.scheme) == (MISSION_TIME, "utility all")
    }
    local, static = compared["local"].ratio, compared["static"].ratio
    assert local is not None
    assert static is not None
    saved, least, most = (100 * (1 - ratio) for ratio in (local.mean, local.high or 0.0, local.low or 0.0))
    yield f"utility all was {saved:.0f} % sooner than local ({least:.0f} to {most:.0f} %)"
    yield f"it was {100 * (1 - static.mean):.0f} % sooner, which ten pairs do not show (p = {compared['static'].p_holm:.3f} after Holm)"
    halves = [_get_mean(results[name], "latency/p50_ms") for name in ("utility all", "static")]
    yield "answered within {:.0f} ms instead of {:.0f}".format(*halves)
    misses = {name: _count_misses(run, name) for name in ("static", "utility all")}
    assert 0.25 < misses["utility all"] / misses["static"] < 0.4
    yield "a third as many come too late"
    rates = [_get_mean(results[name], "fps") for name in ("utility all", "static")]
    assert 1.4 < rates[0] / rates[1] < 1.6
    yield "half as many again are looked at"
    yield f"static keeps {100 - 100 * misses['static']:.0f} % of its pictures within that"
    moves = [_get_mean(results[name], "handoffs") for name in ("least-loaded", "utility all")]
    assert 1.75 < moves[0] / moves[1] < 2.25
    yield "it loses by twice as many moves"
    yield f"{100 * (1 - static.mean):.0f} % were measured"
    found = {name: measure_whereabouts(run, name) for name in ("least-loaded", "utility all")}
    yield f"were near their robot for {100 * found['least-loaded'].near:.0f} % of the time"
    yield f"For {100 * found['least-loaded'].mistaken:.0f} % they stand on a far edge"
    yield f"in the run for {100 * found['utility all'].hosts['edge2']:.0f} %"


def _get_mean(result: SchemeResult, metric: str) -> float:
    found = result.metrics.get(metric) or result.estimates[metric][0]
    assert found is not None
    return found.mean


def _count_misses(run: ExperimentRun, scheme: str) -> float:
    readings = [trial.readings for trial in run.trials if trial.scheme == scheme]
    sums = [
        sum(each[-1].value for reading in readings for each in reading[f"latency/{name}"].values() if each)
        for name in ("misses", "values")
    ]
    return sums[0] / sums[1]


def test_sentences_about_the_run_have_its_figures() -> None:
    run = load_run(evaluation.RUN)
    for claim in list_claims_about_the_run(run):
        assert claim in PLAIN, claim
    late = tuple(
        replace(trial, latency=trial.latency * (1 + (trial.scheme == "static"))) for trial in run.trials
    )
    assert any(claim not in PLAIN for claim in list_claims_about_the_run(replace(run, trials=late)))


def test_sentences_about_the_model_have_the_figures_of_its_tables() -> None:
    block = get_block(
        "simulate docs/scenarios/patrol.yaml --policy local,static,least-loaded,utility --weights all --against docs/experiment"
    )
    off = {
        name: block.partition(f"\n{name} ")[2].partition("off by")[2].split()[0]
        for name in ("local", "static", "least-loaded", "utility all")
    }
    within = {name: abs(int(off[name].rstrip("%"))) for name in off}
    assert max(within.values()) <= 5
    said = "within 5 % for local ({local} %), static ({static} %), least-loaded ({least-loaded} %) and utility all ({utility all} %)"
    assert said.format_map(within) in PLAIN
    sooner = re.search(r"utility all finished the mission ([0-9.]+) % sooner than static", block)
    assert sooner is not None
    assert f"as it is now says {sooner[1]} %" in LINKED
    model = TEXT.partition("<!-- from the model -->")[2].partition("<!-- end -->")[0]
    rows = {
        cells[1].strip(): [cell.strip() for cell in cells[2:7]]
        for cells in (line.split("|") for line in model.splitlines() if line.startswith("| "))
    }
    near, without = (rows[name][0] for name in ("least-loaded", "least-loaded, all three"))
    assert f"and are for {near} in the model, which had {without} without all three" in PLAIN
    assert f"in the model detections stand on edge2 for {rows['utility all'][2]} of the time" in PLAIN


def test_sentences_about_the_paper_have_the_figures_of_its_tables() -> None:
    first, second = (get_block(f"simulate docs/scenarios/paper-{number}.yaml") for number in (1, 2))
    ratios = [
        re.search(r"\nutility all +local .*?\]  +([0-9.]+) \[([0-9.]+), ([0-9.]+)\]", each)
        for each in (first, second)
    ]
    assert ratios[0] is not None
    assert ratios[1] is not None
    assert "{} (95 % interval {} to {})".format(*ratios[0].groups()) in PLAIN
    assert "and {} ({} to {}) of the local latency".format(*ratios[1].groups()) in PLAIN
    shares = [
        re.search(r"local execution: static [0-9.]+ \(published ([0-9.]+)\)", each)
        for each in (first, second)
    ]
    assert f"published static: {' and '.join(each[1] for each in shares if each)}" in PLAIN
    welch = [
        re.search(r"against static \(Welch.*utility all p = ([0-9.]+[0-9])", each) for each in (first, second)
    ]
    assert f"Welch's test gives p = {' and '.join(each[1] for each in welch if each)}" in PLAIN
    for block, said in ((second, "90 to 98 %"), (first, "60 to 63 %")):
        rows = [
            read_column(block, name, 2) for name in ("static", "utility cpu", "utility memory", "utility all")
        ]
        cores = [int(each) for row in rows for each in row.split("/")]
        assert f"{min(cores)} to {max(cores)} %" == said
        assert said in PLAIN
    literal = get_block("simulate docs/scenarios/paper-2.yaml --policy paper,utility --weights cpu,all")
    moves = sorted(float(read_column(literal, f"paper {name}", 4)) for name in ("cpu", "all"))
    assert "It moves tasks {:.0f} and {:.0f} times".format(*moves) in PLAIN
    gains = [
        re.search(rf"\nutility all +paper {name} .*?\]  +([0-9.]+) ", literal) for name in ("cpu", "all")
    ]
    assert (
        "utility all finishes {:.0f} and {:.0f} % sooner".format(
            *(100 - 100 * float(each[1]) for each in gains if each)
        )
        in PLAIN
    )


def test_the_mission_on_changing_links_is_a_committed_world() -> None:
    assert evaluation.write_model_parts(TEXT, "changing links") == TEXT, "make evaluation"
    times = {
        name: float(re.search(rf"\| {name} \| ([0-9.]+)", evaluation.render_changing_links())[1])  # type: ignore[index]
        for name in ("static", "utility all")
    }
    assert (
        f"Against static, utility all gains {100 - 100 * times['utility all'] / times['static']:.0f} %"
        in PLAIN
    )


def test_without_live_links_utility_decides_as_static() -> None:
    path = evaluation.ROOT / "docs" / "scenarios" / "changing-links.yaml"
    inventory_file, tasks_file = load_scenario_paths(path)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, tasks_file)
    scenario = replace(load_scenario(path, inventory, tasks), live_links=False)
    policies = (PolicyName.STATIC, PolicyName.UTILITY)
    static, utility = (
        [
            simulate_mission(
                inventory, tasks, scenario, scheme.policy, partial(random.Random(run).gauss, 0.0, 1.0)
            )
            for run in range(2)
        ]
        for scheme in build_schemes(tasks.policy, policies, {"all": parse_weights("all")}, [])
    )
    assert [run.latency for run in static] == [run.latency for run in utility]
    assert not any(run.handoffs for run in utility)
