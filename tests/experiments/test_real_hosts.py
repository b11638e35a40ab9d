# SPDX-License-Identifier: Apache-2.0
"""Experiments with real processes: on this machine through the API, and over sshd through a command that is killed."""

import json
import shlex
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.model.experiment import Experiment
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.runner import ExperimentOptions, run_experiment
from edgectl.experiments.scheme_results import summarize_trials
from edgectl.model.plan import Action
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import Need, NeedCondition, TaskKind
from tests.builders import a_robot, a_task, an_edge, an_inventory
from tests.e2e.bench import Bench, a_local, a_mark, a_sleeper, list_sleepers, open_bench
from tests.forkserver import ForkedProcess
from tests.pace import patience
from tests.sshd import Lab
from tests.transport.test_conversation import CountingTransport

EDGES = [a_local(an_edge("edge1"), "127.0.0.31"), a_local(an_edge("edge2"), "127.0.0.32")]
ROBOT = replace(a_local(a_robot("robot1"), "127.0.0.41"), onboard=True)
LINKS = {("edge1", "robot1"): 10e6, ("edge2", "robot1"): 10e6}
SCHEMES = tuple(
    Scheme(name=name.value, policy=Policy(name=name, min_dwell=0.0))
    for name in (PolicyName.LOCAL, PolicyName.UTILITY)
)
SPEC = Experiment(
    name="mission", schemes=SCHEMES, until=("merge",), repetitions=2, every=0.5, limit=120.0, idle=1.0
)


@pytest.fixture
def bench(tmp_path: Path, isolated: Path) -> Iterator[Bench]:
    with open_bench(an_inventory(*EDGES, ROBOT, links=LINKS), tmp_path / "manager", isolated) as running:
        yield running


def test_two_schemes_twice_with_real_processes(bench: Bench, tmp_path: Path) -> None:
    mark = a_mark()
    slam = a_sleeper("slam", mark, robots=("robot1",))
    slam = replace(slam, command='echo "fps 12.5" >> "$EDGECTL_METRICS"; ' + slam.command)
    merge = a_task(
        "merge",
        command="sleep 0.5",
        kind=TaskKind.JOB,
        robots=("robot1",),
        needs=[Need(task="slam", until=NeedCondition.READY)],
    )
    bench = bench.using(slam, merge)
    run = run_experiment(
        bench.fleet, SPEC, ExperimentOptions(directory=tmp_path / "run", spec_directory=tmp_path)
    )
    assert list_sleepers(mark) == []
    assert [(trial.scheme, trial.repetition, trial.finished) for trial in run.trials] == [
        (scheme, repetition, True) for scheme in ("local", "utility") for repetition in (1, 2)
    ]
    began = {(trial.scheme, trial.repetition): trial.began_at for trial in run.trials}
    assert sorted(began, key=began.__getitem__) == [
        ("local", 1),
        ("utility", 1),
        ("local", 2),
        ("utility", 2),
    ]
    for trial in run.trials:
        assert {span.host == "robot1" for span in trial.spans} == {trial.scheme == "local"}
        assert {span.task for span in trial.spans} == {"slam", "merge"}
        (job,) = (span for span in trial.spans if span.task == "merge")
        assert job.start <= job.end
        assert trial.latency == trial.completed["merge"] == job.end
        assert [reading.value for reading in trial.readings["fps"]["slam"]][-1] == 12.5
        assert trial.loads.keys() == {"edge1", "edge2", "robot1"}
    assert load_run(tmp_path / "run") == run
    assert bench.actions() == {"slam": Action.START, "merge": Action.START}, (
        "its completion counts for the trial alone"
    )


def test_a_trial_asks_and_changes_by_agents_that_stay(bench: Bench, tmp_path: Path) -> None:
    """Each cycle of a mission asks all hosts; the first ones have calls, as the first of an operation on each host."""
    transport, cycles = CountingTransport(), 20
    work = a_task("merge", command=f"sleep {cycles * SPEC.every}", kind=TaskKind.JOB, robots=("robot1",))
    fleet = replace(bench.using(work).fleet, transport=transport)
    spec = replace(SPEC, schemes=SCHEMES[:1], repetitions=1)
    options = ExperimentOptions(directory=tmp_path / "run", spec_directory=tmp_path)
    (trial,) = run_experiment(fleet, spec, options).trials
    assert trial.finished
    hosts = {"edge1", "edge2", "robot1"}
    assert set(transport.agents) == hosts
    asked = Counter(transport.calls)
    assert all(count == 1 for (_, operation), count in asked.items() if operation in ("start", "wait"))
    assert all(asked[host, operation] < cycles / 2 for host in hosts for operation in ("probe", "lease"))


# Uses this much CPU of its own, then sleeps until its time is over; a process that it starts uses a part of it.
BURN = """
import os, subprocess, sys, time
def burn(seconds):
    while time.process_time() < seconds:
        sum(range(1000))
if len(sys.argv) > 3:
    burn(float(sys.argv[1]))
else:
    began = time.monotonic()
    subprocess.run([sys.executable, "-S", "-c", sys.argv[2], "0.8", "", "child"], check=True)
    burn(float(sys.argv[1]))
    time.sleep(max(0.0, 6.0 + began - time.monotonic()))
"""


def test_means_of_a_short_mission_are_those_of_its_processes(bench: Bench, tmp_path: Path) -> None:
    """2.4 and 0.8 s of CPU in a mission of some seconds, of which samples every 2 s see neither begin nor end."""
    words = shlex.join([sys.executable, "-S", "-c", BURN, "2.4", BURN])
    work = a_task("work", command=f"exec {words}", kind=TaskKind.JOB, robots=("robot1",))
    spec = replace(SPEC, until=("work",), schemes=SCHEMES[:1], repetitions=1, every=2.0)
    options = ExperimentOptions(directory=tmp_path / "run", spec_directory=tmp_path)
    run = run_experiment(bench.using(work).fleet, spec, options)
    (trial,) = run.trials
    assert trial.finished
    assert trial.usage["robot1"].cpu_s == pytest.approx(3.2, rel=0.02)
    assert trial.usage["edge1"].cpu_s == trial.usage["edge2"].cpu_s == 0.0
    (result,) = summarize_trials(run)
    (cpu,) = result.estimates["cpu"]
    assert cpu is not None
    assert cpu.mean == pytest.approx(100 * 3.2 / trial.latency / run.machines["robot1"].cores, rel=0.02)
    assert load_run(tmp_path / "run") == run


# -- the command, over ssh ---------------------------------------------------------------------------------------------------------------

INVENTORY = """\
version: 1
edges:
  edge1: {{host: edge1, {0}}}
  edge2: {{host: edge2, {0}}}
robots:
  robot1: {{host: robot1, onboard: true, {0}}}
links:
  - {{edge: edge1, robot: robot1, throughput: 54Mbit/s}}
  - {{edge: edge2, robot: robot1, throughput: 54Mbit/s}}
"""
TASKS = """\
version: 1
tasks:
  slam: {{robot: robot1, command: "setsid sleep {0} & exec sleep {0}", demand: {{cpu: 0.1, memory: 1Mi, throughput: 0}}, stop: {{grace: 2s}}}}
  merge:
    {{robot: robot1, kind: job, needs: [slam], command: "[ ! -e {1} ] || sleep {0}", demand: {{cpu: 0.1, memory: 1Mi, throughput: 0}}}}
"""
SPEC_FILE = """\
version: 1
name: mission
inventory: inventory.yaml
tasks: tasks.yaml
schemes: {policies: [utility], weights: [all]}
repetitions: 9
every: 500ms
limit: 5m
until: [merge]
idle: 100%
"""


def command(site: Path, *words: str) -> ForkedProcess:
    return ForkedProcess(["experiment", *words], cwd=site, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + patience(120)
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_killed_in_a_trial_interrupted_in_the_next_try_and_finished_in_the_third(
    lab: Lab, tmp_path: Path
) -> None:
    mark, hold = a_mark(), tmp_path / "hold"
    (tmp_path / "inventory.yaml").write_text(INVENTORY.format("capacity: {cpu: 2, memory: 1Gi}"))
    (tmp_path / "tasks.yaml").write_text(TASKS.format(mark, hold))
    (tmp_path / "spec.yaml").write_text(SPEC_FILE)
    hold.touch()  # as long as it is there, the mission does not end

    killed = command(tmp_path, "run", "spec.yaml")
    until(lambda: len(list_sleepers(mark)) == 3)
    killed.kill()
    killed.communicate()
    assert len(list_sleepers(mark)) == 3
    before = set(list_sleepers(mark))

    ended = command(tmp_path, "run", "spec.yaml")
    until(lambda: len(set(list_sleepers(mark)) - before) == 3)
    assert len(list_sleepers(mark)) == 3, "the tasks of the trial that was killed were stopped first"
    ended.send_signal(signal.SIGINT)
    _, said = ended.communicate(timeout=patience(120))
    assert (ended.returncode, list_sleepers(mark)) == (130, [])
    assert "ending the trial and stopping its tasks" in said
    assert list((tmp_path / "runs" / "mission" / "trials").iterdir()) == []

    hold.unlink()
    whole = command(tmp_path, "run", "spec.yaml", "-o", "json", "-n", "1")
    out, said = whole.communicate(timeout=patience(240))
    assert (whole.returncode, list_sleepers(mark)) == (0, []), said
    assert json.loads(out)["item"]["trials"] == 1
    assert said.splitlines()[0] == "trial 1 of 1: utility all, repetition 1"
    assert [(trial.scheme, trial.finished) for trial in load_run(tmp_path / "runs" / "mission").trials] == [
        ("utility all", True)
    ]

    shown = command(tmp_path, "show", "-o", "json")
    again, _ = shown.communicate(timeout=patience(60))
    assert (shown.returncode, again) == (0, out)
