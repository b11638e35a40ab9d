"""Events in scenario files: what is read, and each fault with its place and its hint."""

from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import InputError
from edgectl.experiments.files.experiment_file import load_experiment
from edgectl.experiments.files.run_codec import RUN_KIND, digest_experiment
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.experiment import ExperimentRun, RecoveryMetric
from edgectl.experiments.model.mission_event import (
    CHANGE_KEYS,
    DemandChange,
    EventCommand,
    EventCondition,
    EventPrompt,
    HostLoad,
    LinkChange,
    MissionEvent,
    RobotProgress,
)
from edgectl.model.task import TaskKind, Tasks
from tests.builders import a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.views.fixtures import ROOT

FLEET = an_inventory(an_edge("zinc"), an_edge("mint"), an_edge("alder"), a_robot("rover2"), a_robot("rover1"))
TASKS: Tasks = some_tasks(
    a_task("slam-rover2", template="slam", robots=["rover2"]),
    a_task("slam-rover1", template="slam", robots=["rover1"]),
    a_task("merge", robots=["rover1", "rover2"]),
    a_task("idle", robots=["rover1"]),
    a_task("tour", kind=TaskKind.JOB),
)
HEAD = """\
version: 1
name: test
hosts: {edges: {cores: 4, memory: 4Gi}, robots: {cores: 1, memory: 1Gi}}
jobs:
  map: {task: slam-rover1, work: 5m}
  merge: {task: merge, work: 20s, after: [map]}
events:
"""


def read_events(tmp_path: Path, text: str) -> tuple[MissionEvent, ...]:
    path = tmp_path / "scenario.yaml"
    path.write_text(HEAD + text)
    return load_scenario(path, FLEET, TASKS).events


def test_every_change_and_every_form_is_read(tmp_path: Path) -> None:
    text = """\
  busy: {at: 30s, every: 2m, times: 3, jitter: 5s, for: 1m, load: {host: zinc, cpu: 2, memory: 1Gi}}
  far: {when: {progress: {robot: rover1, reaches: 33%}}, link: {edge: mint, robot: rover1, throughput: 8Mbit/s, delay: 20ms}}
  off: {when: {completed: [merge], placed: [slam]}, for: 30s, lost: alder}
  in: {at: 0s, join: rover2}
  more: {when: {jobs: [map]}, demand: {task: merge, cpu: 500m, throughput: 1MB/s}}
  new: {at: 1m, add: slam}
"""
    both = ("slam-rover1", "slam-rover2")
    assert sorted(read_events(tmp_path, text), key=lambda event: event.name) == [
        MissionEvent(
            name="busy",
            at=30.0,
            every=120.0,
            times=3,
            jitter=5.0,
            duration=60.0,
            load=HostLoad(host="zinc", cpu=2.0, memory=2.0**30),
        ),
        MissionEvent(
            name="far",
            when=EventCondition(progress=RobotProgress(robot="rover1", reaches=0.33)),
            link=LinkChange(edge="mint", robot="rover1", throughput=1e6, delay=0.02),
        ),
        MissionEvent(name="in", at=0.0, join="rover2"),
        MissionEvent(
            name="more",
            when=EventCondition(jobs=("map",)),
            demand=DemandChange(task="merge", demand={"cpu": 0.5, "network": 1e6}),
        ),
        MissionEvent(name="new", at=60.0, add="slam"),
        MissionEvent(
            name="off",
            when=EventCondition(completed=("merge",), placed=tuple(sorted(both))),
            duration=30.0,
            lost="alder",
        ),
    ]


@pytest.mark.parametrize(
    ("line", "place", "words", "hint"),
    [
        ("x: {at: 5s}", "8:3", "an event needs a change", "add one of load, link, lost, demand, join, add"),
        ("x: {lost: zinc}", "8:3", "needs at or when", "add at: 30s"),
        ("x: {at: 5s, when: {placed: [merge]}, lost: zinc}", "8:15", "at or when, not both", "remove one"),
        ("x: {at: 5s, lost: zinc, join: rover1}", "8:27", "one change, not lost and join", "two events"),
        ("x: {at: 5s, times: 2, lost: zinc}", "8:15", "times without every", "add every"),
        ("x: {at: 5s, every: 9s, for: 10s, lost: zinc}", "8:15", "longer than every", "lengthen every"),
        ("x: {at: 5s, for: 9s, join: rover1}", "8:15", "join happens once", "remove for"),
        ("x: {at: 5s, every: 9s, add: merge}", "8:15", "add happens once", "remove every"),
        ("x: {at: 5s, lost: zink}", "8:21", "unknown host zink", "did you mean zinc?"),
        ("x: {at: 5s, join: rover9}", "8:21", "unknown robot rover9", "did you mean rover"),
        ("x: {at: 5s, add: slem}", "8:20", "unknown task slem", ""),
        ("x: {at: 5s, load: {host: zinc}}", "8:21", "a load needs cpu or memory", "add cpu: 1"),
        ("x: {at: 5s, load: {cpu: 1}}", "8:21", "a load needs host", "add host"),
        ("x: {at: 5s, load: {host: zinc, cpu: many}}", "8:39", "many", ""),
        ("x: {at: 5s, link: {edge: zinc, robot: rover1}}", "8:21", "needs throughput or delay", "1.6Mbit/s"),
        (
            "x: {at: 5s, link: {edge: rover1, robot: rover2, delay: 1ms}}",
            "8:28",
            "unknown edge rover1",
            "edges:",
        ),
        (
            "x: {at: 5s, link: {edge: zinc, robot: rover1, bandwidth: 1MB/s}}",
            "8:49",
            "unknown key bandwidth",
            "known keys: edge, robot, throughput, delay",
        ),
        ("x: {at: 5s, demand: {task: merge}}", "8:23", "a demand needs cpu, memory, throughput", "add cpu"),
        ("x: {at: 5s, demand: {task: slam, cpu: 1}}", "8:30", "unknown task slam", "slam-rover1"),
        (
            "x: {when: {completed: [idle]}, lost: zinc}",
            "8:26",
            "idle has no job",
            "name a task that completes",
        ),
        ("x: {when: {jobs: [mop]}, lost: zinc}", "8:21", "unknown job mop", "did you mean map?"),
        ("x: {when: {}, lost: zinc}", "8:13", "when needs a condition", "completed"),
        (
            "x: {when: {progress: {robot: rover2, reaches: 50%}}, lost: zinc}",
            "8:32",
            "rover2 has no job",
            "serves it alone",
        ),
        (
            "x: {when: {progress: {robot: rover1, reaches: 120%}}, lost: zinc}",
            "8:49",
            "must be 1 or less",
            "",
        ),
        ("x: {at: 5s, run: [tc]}", "8:20", "run does not belong in this file", "a scenario has load, link"),
        ("x: {at: 5s, lots: zinc}", "8:15", "unknown key lots in an event", "did you mean lost?"),
        ("Far Away: {at: 5s, lost: zinc}", "8:3", "cannot be the name of an event", "write far-away"),
        ("x: 5s", "8:6", "an event must be a mapping", "write keys such as at"),
        ("x: {at: 5s, lost: zinc}\n  x: {at: 6s, lost: mint}", "9:3", 'duplicate key "x"', "remove line"),
    ],
)
def test_each_fault_has_its_place_and_a_hint(
    tmp_path: Path, line: str, place: str, words: str, hint: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_events(tmp_path, f"  {line}\n")
    told = [(f"{each.line}:{each.column}", each.message, each.hint) for each in caught.value.problems]
    assert len(told) == 1, told
    assert (told[0][0], words in told[0][1], hint in told[0][2]) == (place, True, True), told


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_events(tmp_path, "  a: {at: 5s, lost: zink}\n  b: {at: 5q, join: rover7}\n  c: [1]\n")
    assert [each.line for each in caught.value.problems] == [8, 9, 9, 10]


def test_the_shipped_scenario_has_every_change_of_a_scenario() -> None:
    path = ROOT / "docs" / "scenarios" / "events.yaml"
    inventory_file, tasks_file = load_scenario_paths(path)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, tasks_file)
    events = load_scenario(path, inventory, tasks).events
    assert {event.change for event in events} == set(CHANGE_KEYS) - {"add", "run", "ask"}


SPEC_HEAD = """\
version: 1
name: test
until: [tour]
events:
"""


def read_experiment(tmp_path: Path, text: str) -> tuple[MissionEvent, ...]:
    path = tmp_path / "spec.yaml"
    path.write_text(SPEC_HEAD + text)
    return load_experiment(path, FLEET, TASKS).events


def test_changes_of_an_experiment_are_read(tmp_path: Path) -> None:
    text = """\
  far: {at: 30s, for: 10s, run: [tc, add], on: zinc, undo: [tc, del], deadline: 5s, kind: link}
  door: {when: {progress: {robot: rover2, reaches: 50%}}, ask: "open the door", deadline: 1m}
  in: {when: {placed: [merge]}, join: rover2}
  more: {when: {completed: [tour]}, add: slam}
"""
    assert sorted(read_experiment(tmp_path, text), key=lambda event: event.name) == [
        MissionEvent(
            name="door",
            when=EventCondition(progress=RobotProgress(robot="rover2", reaches=0.5)),
            ask=EventPrompt(text="open the door", deadline=60.0),
        ),
        MissionEvent(
            name="far",
            at=30.0,
            duration=10.0,
            run=EventCommand(argv=("tc", "add"), on="zinc", undo=("tc", "del"), deadline=5.0),
            kind="link",
        ),
        MissionEvent(name="in", when=EventCondition(placed=("merge",)), join="rover2"),
        MissionEvent(name="more", when=EventCondition(completed=("tour",)), add="slam"),
    ]


@pytest.mark.parametrize(
    ("line", "place", "words", "hint"),
    [
        ("x: {at: 5s, load: {host: zinc, cpu: 1}}", "5:21", "load does not belong", "with kind: load"),
        ("x: {at: 5s, run: [tc], for: 9s}", "5:26", "nothing ends this change", "add undo"),
        ("x: {at: 5s, run: tc add}", "5:20", "must be a list of arguments", 'write ["tc", "add"]'),
        ("x: {at: 5s, run: []}", "5:20", "must name a program", ""),
        ("x: {at: 5s, run: [tc], on: zink}", "5:30", "unknown host zink", "did you mean zinc?"),
        ("x: {at: 5s, run: [tc], kind: lnk}", "5:32", "unknown kind lnk", "did you mean link?"),
        ("x: {at: 5s, run: [tc], deadline: 0s}", "5:36", "must be above 0", ""),
        ("x: {at: 5s, join: rover1, undo: [tc]}", "5:29", "undo belongs to run", "remove undo"),
        ("x: {at: 5s, ask: go, on: zinc}", "5:24", "on belongs to run", "remove on"),
        ("x: {at: 5s, ask: go, for: 9s}", "5:24", "has no end", "second event"),
        ("x: {when: {completed: [slam]}, join: rover1}", "5:26", "slam-rover1 never completes", "completes"),
        ("x: {when: {jobs: [map]}, join: rover1}", "5:14", "unknown key jobs in when", ""),
    ],
)
def test_each_fault_of_an_experiment_has_its_place(
    tmp_path: Path, line: str, place: str, words: str, hint: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_experiment(tmp_path, f"  {line}\n")
    first = caught.value.problems[0]
    told = (f"{first.line}:{first.column}", first.message, first.hint)
    assert (told[0], words in told[1], hint in told[2]) == (place, True, True), told


def test_the_metric_of_recovery_is_read(tmp_path: Path) -> None:
    """It is no condition of a trial: a run may be read by another rule."""
    path = tmp_path / "spec.yaml"
    path.write_text("version: 1\nname: test\nuntil: [tour]\n")
    plain = load_experiment(path, FLEET, TASKS)
    found = {}
    for text in ("metric: fps, better: higher", "metric: lag, better: lower, within: 5%, window: 4s"):
        path.write_text(f"version: 1\nname: test\nuntil: [tour]\nrecovery: {{{text}}}\n")
        found[text[8:11]] = load_experiment(path, FLEET, TASKS)
    assert plain.recovery is None
    assert found["fps"].recovery == RecoveryMetric(metric="fps", higher=True, within=0.1, window=10.0)
    assert found["lag"].recovery == RecoveryMetric(metric="lag", higher=False, within=0.05, window=4.0)
    assert len({digest_experiment(each, FLEET, TASKS) for each in (plain, *found.values())}) == 1
    path.write_text("version: 1\nname: test\nuntil: [tour]\nrecovery: {metric: fps, better: more}\n")
    with pytest.raises(InputError) as caught:
        load_experiment(path, FLEET, TASKS)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, problem.message) == (4, 33, "unknown word 'more'")


def test_events_of_a_run_are_stored_with_it(tmp_path: Path) -> None:
    """Everything that can be stated comes back from run.json; a run without events has no such key."""
    text = """\
  far: {at: 30s, every: 1m, times: 2, jitter: 5s, for: 10s, run: [tc, add], on: zinc, undo: [tc, del], kind: link}
  door: {when: {completed: [tour], placed: [merge], progress: {robot: rover2, reaches: 50%}}, ask: "open"}
  in: {at: 0s, join: rover2}
"""
    read_experiment(tmp_path, text)
    experiment = load_experiment(tmp_path / "spec.yaml", FLEET, TASKS)
    run = ExperimentRun(experiment=experiment, digest="sha256:0", machines={})
    assert RUN_KIND.decode(RUN_KIND.encode(run)) == run
    bare = RUN_KIND.encode(replace(run, experiment=replace(experiment, events=())))
    assert "events" not in str(bare["experiment"])
    digests = [
        digest_experiment(each, FLEET, TASKS)
        for each in (
            experiment,
            replace(experiment, events=()),
            replace(experiment, events=experiment.events[:1]),
        )
    ]
    assert len(set(digests)) == 3, "trials under other events are not comparable"
