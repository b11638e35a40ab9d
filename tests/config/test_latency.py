# SPDX-License-Identifier: Apache-2.0
"""Latency, deadline and heard of a task: what files may say, and what is refused."""

from pathlib import Path

import pytest

from edgectl.model.check import CheckLocation
from edgectl.model.latency import HeardRule, LatencyRule
from tests.config.broken_files import BrokenFile, check_problem
from tests.config.test_expand import load_task

PRIORITY, JOB, POSE = "priority: 1", "    kind: job", '    detect: {cmdline: "pose_node"}'
LONELY = "  lonely: {command: x, demand: {cpu: 0, memory: 0}, latency: {topic: /cmd}}"
CASES = [
    BrokenFile(name="latency of nothing", old=PRIORITY, new="latency: {}", at="{}", code="EC011",
        message="latency needs metric or topic", hint="write metric: NAME", mended="latency: {metric: age_ms}"),
    BrokenFile(name="latency of both", old=PRIORITY, new="latency: {metric: a, topic: /cmd}", at="topic: /cmd", code="EC033",
        message="metric and topic do not go together", hint="remove topic or metric", mended="latency: {topic: /cmd}"),
    BrokenFile(name="stamp of a metric", old=PRIORITY, new="latency: {metric: a, stamp: header}", at="stamp: h", code="EC033",
        message="stamp is for a topic", hint="remove stamp", mended="latency: {metric: a}"),
    BrokenFile(name="other stamp", old=PRIORITY, new="latency: {topic: /cmd, stamp: field}", at="field}", code="EC013",
        message="unknown word 'field'", hint="write one of header", mended="latency: {topic: /cmd, stamp: header}"),
    BrokenFile(name="name of a metric", old=PRIORITY, new="latency: {metric: 9ms}", at="9ms", code="EC019",
        message="'9ms' is no name of a metric", hint="beginning with a letter or _", mended="latency: {metric: _9ms}"),
    BrokenFile(name="latency as text", old=PRIORITY, new="latency: age", at="age", code="EC010",
        message="latency must be a mapping, not a string", hint="", mended="latency: {metric: age}"),
    BrokenFile(name="latency without a robot", old=JOB, new=f"{JOB}\n{LONELY}", at="{topic", code="EC033",
        message="latency is read on the robot, and lonely has none", hint="write on: host", mended=f"{JOB}\n{LONELY.replace('/cmd', '/cmd, on: host')}"),
    BrokenFile(name="hard without a bound", old=PRIORITY, new="deadline: {hard: true}", at="{hard", code="EC011",
        message="deadline needs within", hint="", mended="deadline: {within: 100ms, hard: true}"),
    BrokenFile(name="deadline of zero", old=PRIORITY, new="deadline: {within: 0}", at="0}", code="EC015",
        message="must be above 0", hint="write a quantity above 0", mended="deadline: {within: 5ms}"),
    BrokenFile(name="hard as a word", old=PRIORITY, new="deadline: {within: 1s, hard: yes}", at="yes", code="EC010",
        message="must be true or false", hint="write true", mended="deadline: {within: 1s, hard: true}"),
    BrokenFile(name="heard by both", old=PRIORITY, new="heard: {ros_topic: /a, command: b}", at="command: b", code="EC033",
        message="ros_topic and command do not go together", hint="remove command or ros_topic", mended="heard: b"),
    BrokenFile(name="heard by nothing", old=PRIORITY, new="heard: {within: 5s}", at="{within", code="EC011",
        message="heard needs ros_topic or command", hint="write ros_topic: /NAME", mended="heard: {ros_topic: /a, within: 5s}"),
    BrokenFile(name="latency of an unmanaged task", old=POSE, new=f"{POSE}\n    latency: {{metric: a}}", at="latency", code="EC033",
        message="managed: false has none", hint="write topic: /NAME", mended=f"{POSE}\n    latency: {{topic: /p}}"),
    BrokenFile(name="heard of an unmanaged task", old=POSE, new=f"{POSE}\n    heard: b", at="heard", code="EC033",
        message="is never moved", hint="remove heard", mended=POSE),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_broken_task_is_refused_with_its_place_and_a_remedy(tmp_path: Path, case: BrokenFile) -> None:
    check_problem(case, tmp_path, in_tasks=True)


def test_latency_of_a_metric_or_of_a_topic(tmp_path: Path) -> None:
    assert load_task(tmp_path, "latency: {metric: age_ms}").latency == LatencyRule(metric="age_ms")
    task = load_task(tmp_path, "robot: robot1, latency: {topic: '{robot}/cmd', stamp: header}")
    assert task.latency == LatencyRule(topic="/robot1/cmd", on=CheckLocation.ROBOT)


def test_a_deadline_may_be_hard(tmp_path: Path) -> None:
    plain, hard = (
        load_task(tmp_path, f"deadline: {text}") for text in ("100ms", "{within: 100ms, hard: true}")
    )
    assert (plain.deadline, plain.hard_deadline) == (0.1, False)
    assert (hard.deadline, hard.hard_deadline) == (0.1, True)


def test_heard_by_a_topic_or_a_command(tmp_path: Path) -> None:
    assert load_task(tmp_path, "robot: robot1, heard: 'ask {robot}'").heard == HeardRule(command="ask robot1")
    told = load_task(tmp_path, "robot: robot1, heard: {ros_topic: cmd, within: 3s}").heard
    assert told == HeardRule(topic="/cmd", within=3.0)


def test_measuring_does_not_change_what_runs(tmp_path: Path) -> None:
    """A task is not restarted because its latency is to be known."""
    plain = load_task(tmp_path, "robot: robot1")
    measured = load_task(tmp_path, "robot: robot1, latency: {metric: a}, deadline: 1s, heard: b")
    assert plain.spec_hash == measured.spec_hash
