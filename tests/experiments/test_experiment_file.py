# SPDX-License-Identifier: Apache-2.0
"""Experiment files: a valid one, and each fault with its position and a hint that mends it."""

from pathlib import Path

import pytest

from edgectl.config.problems import Problems
from edgectl.errors import InputError
from edgectl.experiments.files.experiment_file import load_experiment, load_experiment_paths
from edgectl.experiments.model.experiment import Experiment, MapPair, MetricAggregation
from edgectl.model.check import Check
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import TaskKind, Tasks
from tests.builders import a_robot, a_task, an_edge, an_inventory, some_tasks

FLEET = an_inventory(an_edge("zinc"), an_edge("mint"), an_edge("alder"), a_robot("rover2"), a_robot("rover1"))
TASKS: Tasks = some_tasks(
    a_task("map-merge", kind=TaskKind.JOB),
    a_task("slam"),
    a_task("follow", done_when=Check(command="true")),
    policy=Policy(move_margin=0.3),
)
GOOD = """\
version: 1
name: mission
inventory: ../lab.yaml
tasks: ../mission.yaml
schemes: {policies: [local, utility], weights: [cpu, "cpu=.5,task=1"]}
repetitions: 2
every: 2s
limit: 5m
until: [map-merge, follow]
idle: 25%
metrics: {fps: mean, loss: last}
maps: {ssim: {task: map-merge, file: out/map.yaml, truth: world.yaml}}
"""
# To be added to it.
EVENTS = """\
recovery: {metric: fps, better: higher, within: 5%}
events:
  far: {at: 30s, every: 1m, times: 2, for: 10s, jitter: 5s, run: [tc, add], on: zinc, undo: [tc, del], kind: link}
  door: {when: {completed: [map-merge], progress: {robot: rover2, reaches: 50%}}, ask: "open the door", deadline: 1m}
  in: {when: {placed: [slam]}, join: rover2}
"""


def read(tmp_path: Path, text: str) -> Experiment:
    (tmp_path / "world.yaml").touch()
    path = tmp_path / "spec.yaml"
    path.write_text(text)
    return load_experiment(path, FLEET, TASKS)


def test_a_good_spec_says_all_there_is(tmp_path: Path) -> None:
    found = read(tmp_path, GOOD)
    assert [variant.name for variant in found.schemes] == ["local", "utility cpu", "utility cpu=.5,task=1"]
    assert found.schemes[0].policy == Policy(name=PolicyName.LOCAL, move_margin=0.3)
    assert (found.name, found.repetitions, found.every, found.limit, found.idle) == (
        "mission",
        2,
        2.0,
        300.0,
        0.25,
    )
    assert (found.until, found.metrics) == (
        ("map-merge", "follow"),
        {"fps": MetricAggregation.MEAN, "loss": MetricAggregation.LAST},
    )
    assert found.maps == {"ssim": MapPair(task="map-merge", file="out/map.yaml", truth="world.yaml")}
    assert load_experiment_paths(tmp_path / "spec.yaml") == (
        tmp_path / "../lab.yaml",
        tmp_path / "../mission.yaml",
    )


def test_a_template_stands_for_all_of_its_tasks(tmp_path: Path) -> None:
    path = tmp_path / "spec.yaml"
    path.write_text("version: 1\nname: short\nuntil: [tour, tour-robot2]\n")
    tours = [a_task(f"tour-robot{number}", template="tour", kind=TaskKind.JOB) for number in (1, 2)]
    assert load_experiment(path, FLEET, some_tasks(*tours)).until == ("tour-robot1", "tour-robot2")


def test_a_short_spec_compares_as_simulate_does(tmp_path: Path) -> None:
    found = read(tmp_path, "version: 1\nname: short\nuntil: [map-merge]\n")
    assert [variant.name for variant in found.schemes] == [
        "local",
        "static",
        *(f"utility {word}" for word in ("cpu", "memory", "network", "all")),
    ]
    assert load_experiment_paths(tmp_path / "spec.yaml") == (None, None)


@pytest.mark.parametrize(
    ("old", "new", "place", "words", "mended"),
    [
        ("name: mission\n", "", "1:1", "an experiment needs name", ""),
        ("until: [map-merge, follow]\n", "", "1:1", "an experiment needs until", ""),
        (
            "name: mission",
            "name: My Mission",
            "2:7",
            "cannot be the name of an experiment",
            "name: my-mission",
        ),
        ("repetitions: 2", "repetitions: 0", "6:14", "must be 1 to 1000", "repetitions: 1"),
        ("every: 2s", "every: 10ms", "7:8", "is too short", "every: 500ms"),
        ("limit: 5m", "limit: 5min", "8:8", "cannot be read as a duration", "limit: 5m"),
        ("idle: 25%", "idle: 0.25", "10:7", "cannot be read as a percentage", "idle: 25%"),
        ("idle: 25%", "idle: 120%", "10:7", "must be above 0% and at most 100%", "idle: 25%"),
        ("[map-merge, follow]", "[map-merg]", "9:9", "unknown task map-merg", "[map-merge]"),
        ("[map-merge, follow]", "[slam]", "9:9", "slam never completes", "[map-merge]"),
        (
            "[map-merge, follow]",
            "[map-merge, map-merge]",
            "9:20",
            "duplicate value map-merge",
            "[map-merge]",
        ),
        ("[map-merge, follow]", "[]", "9:8", "no task ends a trial", "[map-merge]"),
        ("[map-merge, follow]", "map-merge", "9:8", "must be a list", "[map-merge]"),
        ("[local, utility]", "[lokal]", "5:22", "unknown word 'lokal'", "[local]"),
        ("[local, utility]", "[local, local]", "5:29", "duplicate value local", "[local]"),
        ("[local, utility]", "[]", "5:21", "no policies given", "[local, static, utility]"),
        (
            "{policies: [local, utility], weights",
            "{weights",
            "5:10",
            "schemes needs policies",
            "{policies: [local], weights",
        ),
        ("[cpu, ", "[tpu, ", "5:49", "unknown weights 'tpu'", "[cpu, "),
        ("fps: mean", "fps: median", "11:16", "unknown word 'median'", "fps: mean"),
        (
            "task: map-merge, file",
            "task: merge, file",
            "12:21",
            "unknown task merge",
            "task: map-merge, file",
        ),
        ("truth: world.yaml", "truth: word.yaml", "12:59", "file not found", "truth: world.yaml"),
        (", truth: world.yaml", "", "12:14", "a map needs truth", ", truth: world.yaml"),
        ("limit: 5m", "limits: 5m", "8:1", "unknown key limits in an experiment", "limit: 5m"),
    ],
)
def test_each_mistake_has_its_place_and_is_mended(
    tmp_path: Path, old: str, new: str, place: str, words: str, mended: str
) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as caught:
        read(tmp_path, GOOD.replace(old, new, 1))
    told = [
        (f"{problem.line}:{problem.column}", problem.message, problem.hint)
        for problem in caught.value.problems
    ]
    (hint,) = [hint for at, message, hint in told if at == place and words in message] or [
        pytest.fail(str(told))
    ]
    assert hint
    assert read(tmp_path, GOOD.replace(old, mended or old, 1)).name


def test_that_others_may_write_the_file_is_noticed(tmp_path: Path) -> None:
    """It names the inventory and the tasks that are run on real hosts."""
    read(tmp_path, GOOD)
    (tmp_path / "spec.yaml").chmod(0o666)
    problems = Problems()
    load_experiment(tmp_path / "spec.yaml", FLEET, TASKS, problems)
    assert [problem.code for problem in problems.warnings] == ["EC104"]
