# SPDX-License-Identifier: Apache-2.0
"""Broken files as single changes of valid ones: the change, the place of the problem, and the text repaired
by its hint.
"""

from dataclasses import dataclass
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import InputError, Problem

INVENTORY = """\
version: 1
defaults: {user: jetson, env: {ROS_DOMAIN_ID: "7"}}
edges:
  edge1: {host: 192.168.1.11, labels: {gpu: maxwell}}
  edge2: {host: jetson-b, limits: {cpu: 80%}}
  edge3: {host: 192.168.1.13, capacity: {cpu: 2, memory: 4Gi}, base: {cpu: 0.5}}
robots:
  robot1: {host: 192.168.1.21, onboard: true}
  robot2: {host: 192.168.1.22}
links:
  - {edge: edge1, robot: robot1, throughput: 54Mbit/s}
fleet: lab
"""
TASKS = """\
version: 1
weights: all
sequence: connectivity
tasks:
  slam:
    for_each: robot
    command: roslaunch slam.launch robot:={robot}
    demand: {cpu: 35.2%, memory: 2.5%, throughput: 2.5%}
    ready: {command: "rosnode info /{robot}/slam", timeout: 20s}
  navigation:
    for_each: robot
    needs: [slam]
    command: roslaunch nav.launch
    env: {ROBOT: "{robot}"}
    demand: {cpu: 500m, memory: 90Mi, throughput: 300kB/s}
    priority: 1
    onboard: allow
    hosts: {never: [edge3], labels: {gpu: maxwell}}
    stop: ros
    on_unreachable: hold
  pose:
    robot: robot1
    managed: false
    detect: {cmdline: "pose_node"}
  map-merge:
    robots: all
    needs: [{task: slam, until: ready}]
    command: roslaunch merge.launch
    demand: {cpu: 9.6%, memory: 100Mi, throughput: 0}
    kind: job
"""


@dataclass(frozen=True, kw_only=True)
class BrokenFile:
    """``old`` becomes ``new``; the problem is at ``at`` (in the broken text, default ``new``); ``mended``
    replaces ``new``.
    """

    name: str
    old: str
    new: str
    code: str
    message: str
    hint: str
    mended: str
    at: str = ""
    position: tuple[int, int] | None = None


def locate(text: str, at: str) -> tuple[int, int]:
    assert at in text, at
    before = text[: text.index(at)]
    return before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1


def list_problems(directory: Path, inventory: str, tasks: str) -> tuple[Problem, ...]:
    (directory / "inventory.yaml").write_text(inventory)
    (directory / "tasks.yaml").write_text(tasks)
    try:
        load_inventory_and_tasks(directory / "inventory.yaml", directory / "tasks.yaml")
    except InputError as error:
        return error.problems
    return ()


def check_problem(case: BrokenFile, directory: Path, *, in_tasks: bool) -> None:
    """Check place, message and hint of the problem; following the hint makes the file valid."""
    good = TASKS if in_tasks else INVENTORY
    assert case.old in good
    broken = good.replace(case.old, case.new, 1)

    def problems(text: str) -> tuple[Problem, ...]:
        return list_problems(directory, *((INVENTORY, text) if in_tasks else (text, TASKS)))

    found = [problem for problem in problems(broken) if problem.code == case.code]
    assert found, problems(broken)
    problem = found[0]
    assert (problem.line, problem.column) == (case.position or locate(broken, case.at or case.new.strip()))
    assert Path(problem.file).name == ("tasks.yaml" if in_tasks else "inventory.yaml")
    assert problem.source == broken.split("\n")[problem.line - 1]
    assert problem.column - 1 + problem.length <= len(problem.source) + 1
    assert case.message in problem.message
    assert case.hint in problem.hint
    assert "\n" not in problem.message + problem.hint
    if problems(good.replace(case.old, case.mended, 1)):
        pytest.fail(f"the hint does not mend it: {problems(good.replace(case.old, case.mended, 1))}")
