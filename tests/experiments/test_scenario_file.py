# SPDX-License-Identifier: Apache-2.0
"""Scenario files: the shipped ones load, and each fault is reported with its position."""

from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import InputError
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.scenario import Scenario, SimCycle, SimJob
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from tests.builders import a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.views.fixtures import ROOT

FLEET: Inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"), a_robot("robot2"))
TASKS: Tasks = some_tasks(a_task("slam-robot1"), a_task("slam-robot2"), a_task("merge"))
GOOD = """\
version: 1
name: test
hosts: {edges: {cores: 4, memory: 4Gi}, edge2: {cores: 2, memory: 1Gi}, robots: {cores: 1, memory: 1Gi, base_cores: 0.5}}
jobs:
  map: {for_each: robot, task: slam, work: 5m, spread: 10%}
  check: {for_each: robot, task: slam, work: 10s, after: [map]}
  merge: {task: merge, work: 20s, after: [check]}
placed: {merge: edge1}
rate: {slam-robot1: 3.6}
published: {local: {cpu: [99.8], latency: [14.4]}}
published_std: {local: 7.78}
published_runs: 5
"""


def read(tmp_path: Path, text: str) -> Scenario:
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    return load_scenario(path, FLEET, TASKS)


def test_hosts_and_jobs_are_spelled_out(tmp_path: Path) -> None:
    found = read(tmp_path, GOOD)
    assert {name: host.cores for name, host in found.hosts.items()} == {
        "edge1": 4.0,
        "edge2": 2.0,
        "robot1": 1.0,
        "robot2": 1.0,
    }
    assert [(job.name, job.task, job.after) for job in found.jobs] == [
        ("map-robot1", "slam-robot1", ()),
        ("map-robot2", "slam-robot2", ()),
        ("check-robot1", "slam-robot1", ("map-robot1",)),
        ("check-robot2", "slam-robot2", ("map-robot2",)),
        ("merge", "merge", ("check-robot1", "check-robot2")),
    ]
    assert found.jobs[0] == SimJob(name="map-robot1", task="slam-robot1", work=300.0, spread=0.1)
    assert found.published["local"]["latency"] == (14.4,)
    assert (found.published_std, found.published_runs) == ({"local": 7.78}, 5)


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("name: test\n", "", "1:1", "a scenario needs name"),
        ("merge: edge1", "merge: edge7", "8:17", "unknown host edge7"),
        ("slam-robot1: 3.6", "slam-robot9: 3.6", "9:8", "unknown task slam-robot9"),
        ("slam-robot1: 3.6", "slam-robot1: fast", "9:21", "must be a number"),
        ("task: merge", "task: nothing", "7:17", "unknown task nothing"),
        ("work: 20s", "work: 0s", "7:30", "must be above 0"),
        ("after: [check]", "after: [chek]", "7:43", "unknown job chek"),
        ("work: 5m", "work: 5m, after: [merge]", "5:3", "cycle of jobs: map"),
        (
            "robots: {cores: 1, memory: 1Gi, base_cores: 0.5}",
            "robot1: {cores: 1, memory: 1Gi}",
            "3:8",
            "no values for robot2",
        ),
        ("edges: {cores: 4, memory: 4Gi}", "edges: {cores: 4}", "3:16", "a computer needs memory"),
        ("edge2: {", "edge8: {", "3:41", "unknown host edge8"),
        ("spread: 10%", "spraed: 10%", "5:48", "unknown key spraed in a job"),
        ("jobs:\n", "jobs: 5\nrest:\n", "4:7", "jobs must be a mapping"),
        ("[99.8]", "99.8", "10:26", "must be a list"),
        ("placed:", "cycles: 5\nplaced:", "8:9", "cycles must be a mapping"),
        ("placed:", "cycles: {slam: {for_each: robot, rate: 5}}\nplaced:", "8:16", "a cycle needs cpu"),
        ("placed:", "cycles: {slam: {rate: 5, cpu: 1ms}}\nplaced:", "8:10", "unknown task slam"),
        (
            "placed:",
            "cycles: {merge: {rate: 5, cpu: 1ms, source: camera}}\nplaced:",
            "8:45",
            "unknown task camera",
        ),
        ("cpu: [99.8]", "cpu: [x]", "10:27", "must be a number"),
        ("after: [check]}", "after: [check], senses: [slam-robot1]}", "7:60", "unknown task with cycles"),
    ],
)
def test_each_mistake_has_its_place(tmp_path: Path, old: str, new: str, place: str, words: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as caught:
        read(tmp_path, GOOD.replace(old, new, 1))
    told = [(f"{problem.line}:{problem.column}", problem.message) for problem in caught.value.problems]
    assert any(at == place and words in message for at, message in told), told


def test_cycles_are_those_of_each_robot(tmp_path: Path) -> None:
    cycles = (
        "cycles: {slam: {for_each: robot, rate: 5, cpu: 8ms, transfer: 64kB}, merge: {rate: 1, cpu: 1s}}\n"
    )
    text = GOOD.replace("placed:", f"{cycles}placed:").replace(
        "after: [map]", "after: [map], senses: [slam], fresh: 2s"
    )
    found = read(tmp_path, text)
    slam = SimCycle(rate=5.0, cpu=0.008, transfer=64e3)
    assert found.cycles == {"slam-robot1": slam, "slam-robot2": slam, "merge": SimCycle(rate=1.0, cpu=1.0)}
    assert [(job.senses, job.fresh) for job in found.jobs if job.name.startswith("check")] == [
        (("slam-robot1",), 2.0),
        (("slam-robot2",), 2.0),
    ]


@pytest.mark.parametrize("name", ["paper-1", "paper-2"])
def test_shipped_scenarios_are_good(name: str) -> None:
    path = ROOT / "docs" / "scenarios" / f"{name}.yaml"
    inventory_file, tasks_file = load_scenario_paths(path)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, tasks_file)
    found = load_scenario(path, inventory, tasks)
    assert (found.name, len(found.jobs), len(found.published)) == (name, 10, 6)
    assert len(found.assumptions) >= 7


def test_no_command_is_named_that_would_make_a_scenario(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_scenario(tmp_path / "none.yaml", FLEET, TASKS)
    assert caught.value.problems[0].hint == "name an existing file"
