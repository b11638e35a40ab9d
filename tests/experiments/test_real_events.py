# SPDX-License-Identifier: Apache-2.0
"""Events of trials with real processes, on three edges whose names are in reverse order, through the real agent."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
import yaml

from edgectl.errors import FleetBusyError
from edgectl.experiments.commands.person import ask_person
from edgectl.experiments.event_actions import EventMeans, ask_nobody, run_event_command
from edgectl.experiments.event_draws import build_uniform_draw
from edgectl.experiments.event_performer import EventPerformer
from edgectl.experiments.event_results import measure_trial_recoveries
from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.model.experiment import Experiment, Trial
from edgectl.experiments.model.mission_event import (
    EventCommand,
    EventCondition,
    EventPrompt,
    MissionEvent,
    RobotProgress,
)
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.runner import ExperimentOptions, run_experiment
from edgectl.experiments.trial import clean_up_trials
from edgectl.experiments.trial_state import create_trial_fleet
from edgectl.model.policy import Policy
from edgectl.model.task import Task, TaskKind
from tests.builders import a_robot, a_task, an_edge, an_inventory
from tests.e2e.bench import Bench, a_local, a_mark, a_sleeper, list_sleepers, open_bench
from tests.experiments.lab.patrol import PATROL
from tests.pace import patience

EDGES = [
    a_local(an_edge(name), f"127.0.0.{number}") for number, name in enumerate(("zinc", "mint", "alder"), 34)
]
ROBOTS = [
    a_local(a_robot(name, onboard=True), f"127.0.0.{number}")
    for number, name in enumerate(("rover2", "rover1"), 44)
]
LINKS = {(edge.name, robot.name): 10e6 for edge in EDGES for robot in ROBOTS}
SCHEME = Scheme(name="utility", policy=Policy(min_dwell=0.0))
LOG = "import sys; open(sys.argv[1], 'a').write(sys.argv[2] + '\\n')"


@pytest.fixture
def bench(tmp_path: Path, isolated: Path) -> Iterator[Bench]:
    with open_bench(an_inventory(*EDGES, *ROBOTS, links=LINKS), tmp_path / "manager", isolated) as running:
        yield running


def log_to(path: Path, word: str) -> tuple[str, ...]:
    return sys.executable, "-c", LOG, str(path), word


def logged(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def build_spec(events: Sequence[MissionEvent]) -> Experiment:
    return Experiment(
        name="mission",
        schemes=(SCHEME,),
        until=("tour",),
        repetitions=1,
        every=0.5,
        limit=patience(120.0),
        idle=1.0,
        events=tuple(events),
    )


def run_trial(bench: Bench, events: Sequence[MissionEvent], folder: Path, *tasks: Task) -> Trial:
    experiment = build_spec(events)
    options = ExperimentOptions(directory=folder / "run", spec_directory=folder)
    run = run_experiment(bench.using(*tasks).fleet, experiment, options)
    assert load_run(folder / "run") == run
    return run.trials[0]


def test_events_act_on_hosts_and_on_the_manager_and_are_undone(bench: Bench, tmp_path: Path) -> None:
    mark, log, gate = a_mark(), tmp_path / "log", tmp_path / "gate"
    odd = "$(touch gone); `touch gone` \"'&"
    slam = a_sleeper("slam-rover1", mark, robots=("rover1",))
    slam = replace(slam, command='echo "progress 0.5" >> "$EDGECTL_METRICS"; ' + slam.command)
    tour = a_task("tour", kind=TaskKind.JOB, command=f"until test -e {gate}; do sleep 0.1; done")
    late = a_sleeper("slam-rover2", mark, robots=("rover2",))
    events = [
        MissionEvent(
            name="first",
            at=0.0,
            run=EventCommand(argv=log_to(log, "first"), on="zinc", undo=log_to(log, "undone")),
            kind="link",
        ),
        MissionEvent(
            name="half",
            when=EventCondition(progress=RobotProgress(robot="rover1", reaches=0.5)),
            duration=0.3,
            run=EventCommand(argv=log_to(log, odd), undo=log_to(log, "half undone")),
        ),
        MissionEvent(name="in", when=EventCondition(placed=("slam-rover1",)), join="rover2"),
        MissionEvent(name="door", at=0.2, ask=EventPrompt(text="open the door", deadline=0.3)),
        MissionEvent(name="broken", at=0.1, run=EventCommand(argv=("false",), on="alder")),
        MissionEvent(
            name="never", when=EventCondition(completed=("tour",)), run=EventCommand(argv=("true",))
        ),
        MissionEvent(
            name="open",
            when=EventCondition(placed=("slam-rover2",)),
            run=EventCommand(argv=("touch", str(gate))),
        ),
    ]
    trial = run_trial(bench, events, tmp_path, slam, tour, late)
    assert trial.finished
    assert logged(log)[0] == "first", "before the first plan"
    assert sorted(logged(log)[1:]) == sorted([odd, "half undone", "undone"])
    assert list(tmp_path.rglob("gone")) == []
    records = {record.event: record for record in trial.events}
    assert records.keys() == {"first", "half", "in", "door", "broken", "open"}
    assert [record.at for record in trial.events] == sorted(record.at for record in trial.events)
    assert (records["first"].kind, records["first"].subject, records["first"].at) == ("link", "zinc", 0.0)
    assert (records["first"].until or 0.0) >= trial.latency - 1.0, "undone at the end of the trial"
    assert 0.3 <= (records["half"].until or 0.0) - records["half"].at < patience(10.0)
    assert records["door"].error == "no one confirmed it within 0.3 s"
    assert records["broken"].error == "false exited with 1"
    assert [record.error for name, record in records.items() if name not in ("door", "broken")] == [""] * 4
    starts = {span.task: span.start for span in trial.spans}
    assert starts["slam-rover1"] < records["in"].at < starts["slam-rover2"] <= records["open"].at
    recoveries = {record.event: found for record, found in measure_trial_recoveries(build_spec(()), trial)}
    assert records["in"].tasks == ("slam-rover2",)
    assert recoveries["in"] == pytest.approx(starts["slam-rover2"] - records["in"].at, abs=0.51)
    assert any("event broken: false exited with 1" in said for said in bench.said)
    assert list_sleepers(mark) == []


@pytest.mark.parametrize("on", ["", "mint"])
def test_a_program_ends_at_its_deadline_with_all_that_it_started(bench: Bench, on: str) -> None:
    mark = a_mark()
    script = f"import subprocess; subprocess.run(['sleep', '{mark}'])"
    command = EventCommand(argv=(sys.executable, "-c", script), on=on, deadline=2.0)
    said = run_event_command(bench.fleet, command, command.argv)
    assert said == f"{sys.executable} did not end within 2 s"
    wait_for(lambda: list_sleepers(mark) == [])


@pytest.mark.parametrize("on", ["", "mint"])
def test_what_a_program_leaves_goes_on(bench: Bench, on: str) -> None:
    """Also in the process group of the program, in which a process is before it makes one of its own."""
    mark = a_mark()
    command = EventCommand(argv=("sh", "-c", f"sleep {mark} >/dev/null 2>&1 & :"), on=on)
    assert run_event_command(bench.fleet, command, command.argv) == ""
    wait_for(lambda: len(list_sleepers(mark)) == 1)
    (left,) = list_sleepers(mark)
    os.kill(left, signal.SIGTERM)
    wait_for(lambda: list_sleepers(mark) == [])


def read_stranger(*changes: tuple[str, str]) -> EventCommand:
    """The load of the shipped experiment, on one of these hosts."""
    spec = yaml.load((PATROL / "experiment.yaml").read_text(), Loader=yaml.BaseLoader)
    script = spec["events"]["stranger"]["run"][-1]
    for old, new in changes:
        assert old in script
        script = script.replace(old, new)
    return EventCommand(argv=("sh", "-c", script), on="zinc")


def test_the_stranger_of_the_patrol_computes(bench: Bench) -> None:
    mark = f": {a_mark()}; "
    command = read_stranger(("while", f"{mark}while"))
    assert run_event_command(bench.fleet, command, command.argv) == ""
    words = ["sh", "-c", f"{mark}while :; do :; done"]
    try:
        wait_for(lambda: len(find_processes(words)) == 2)
        wait_for(lambda: all(sum(each.cpu_times()[:2]) >= 0.05 for each in find_processes(words)))
        assert len(find_processes(words)) == 2
    finally:
        for each in find_processes(words):
            each.kill()


def find_processes(words: Sequence[str]) -> list[psutil.Process]:
    return [each for each in psutil.process_iter(["cmdline"]) if each.info["cmdline"] == words]


def test_a_stranger_that_does_not_run_is_an_error(bench: Bench) -> None:
    command = read_stranger(("timeout 25", "edgectl-no-such-program"), ("sleep 0.5", "wait $p"))
    assert run_event_command(bench.fleet, command, command.argv).startswith("sh exited with 1")


@pytest.mark.parametrize("on", ["", "mint"])
def test_what_a_program_says_is_told_without_control_characters(bench: Bench, on: str) -> None:
    script = r"print('first'); print('\x1b[31mno device eth7'); raise SystemExit(3)"
    command = EventCommand(argv=(sys.executable, "-c", script), on=on)
    said = run_event_command(bench.fleet, command, command.argv)
    assert said == f"{sys.executable} exited with 3: \\x1b[31mno device eth7"
    missing = EventCommand(argv=("/nowhere/tc",), on=on)
    assert "/nowhere/tc: No such file or directory" in run_event_command(bench.fleet, missing, missing.argv)


def test_repetitions_are_drawn_by_the_repetition_of_the_trial(bench: Bench, tmp_path: Path) -> None:
    """Three times within 0.9 s, each as late as the stream of the first repetition says."""
    log = tmp_path / "log"
    event = MissionEvent(
        name="again",
        at=0.1,
        every=0.4,
        times=3,
        jitter=0.2,
        duration=0.1,
        run=EventCommand(argv=log_to(log, "on"), undo=log_to(log, "off")),
    )
    fleet = create_trial_fleet(bench.fleet, "again", bench.probe())
    means = EventMeans(fleet=fleet, ask=ask_nobody, ended=threading.Event())
    with EventPerformer([event], means, build_uniform_draw("1"), until=("tour",)) as performer:
        began = fleet.clock()
        performer.begin_mission()
        performer.begin_mission()
        wait_for(lambda: len(logged(log)) == 6)
        records = performer.finish()
    draw = build_uniform_draw("1")
    due = [0.1 + 0.4 * number + 0.2 * draw("again") for number in range(3)]
    assert logged(log) == ["on", "off"] * 3
    assert [0.0 <= each.at - began - at < patience(5.0) for each, at in zip(records, due, strict=True)] == [
        True
    ] * 3
    clean_up_trials(bench.fleet)
    assert logged(log) == ["on", "off"] * 3, "nothing is undone twice"


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + patience(60.0)
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_what_a_killed_run_has_changed_is_undone_by_the_next(bench: Bench, tmp_path: Path) -> None:
    """The last change first; one that cannot be undone stops the run until somebody has seen to it."""
    log = tmp_path / "log"
    fleet = create_trial_fleet(bench.fleet, "killed", bench.probe())
    means = EventMeans(fleet=fleet, ask=ask_nobody, ended=threading.Event())
    changes = [
        MissionEvent(
            name=name,
            at=0.0,
            run=EventCommand(argv=log_to(log, name), on=on, undo=log_to(log, f"un{name}")),
        )
        for name, on in (("a", ""), ("b", "zinc"))
    ]
    EventPerformer(changes, means, build_uniform_draw("1"), until=("tour",)).__enter__()
    assert logged(log) == ["a", "b"]
    clean_up_trials(bench.fleet)
    assert logged(log) == ["a", "b", "unb", "una"]
    assert not fleet.state.exists()

    fleet = create_trial_fleet(bench.fleet, "stuck", bench.probe())
    stuck = MissionEvent(name="c", at=0.0, run=EventCommand(argv=("true",), on="mint", undo=("false",)))
    other = MissionEvent(name="d", at=0.0, run=EventCommand(argv=log_to(log, "d"), undo=log_to(log, "und")))
    means = EventMeans(fleet=fleet, ask=ask_nobody, ended=threading.Event())
    with EventPerformer([stuck, other], means, build_uniform_draw("1"), until=("tour",)) as performer:
        records = performer.finish()
    assert [record.error for record in records] == ["not undone: false exited with 1", ""]
    assert logged(log)[-2:] == ["d", "und"], "what comes after it is undone all the same"
    with pytest.raises(FleetBusyError, match="not undone: false exited with 1") as caught:
        clean_up_trials(bench.fleet)
    assert caught.value.hint == f"undo it on mint by hand, then delete {fleet.state / 'changes.json'}"
    (fleet.state / "changes.json").unlink()
    clean_up_trials(bench.fleet)
    assert not fleet.state.exists()


def test_changes_that_hold_at_the_end_are_undone_in_reverse(bench: Bench, tmp_path: Path) -> None:
    """Three on one link, one upon the other; the first again after the third."""
    log = tmp_path / "log"
    fleet = create_trial_fleet(bench.fleet, "nested", bench.probe())
    means = EventMeans(fleet=fleet, ask=ask_nobody, ended=threading.Event())
    runs = {
        name: EventCommand(argv=log_to(log, name), undo=log_to(log, f"un{name}"))
        for name in ("zed", "mid", "ant")
    }
    events = [
        MissionEvent(name="zed", run=runs["zed"], at=0.0, every=0.2, times=2),
        *(MissionEvent(name=name, run=runs[name], at=0.0) for name in ("mid", "ant")),
    ]
    with EventPerformer(events, means, build_uniform_draw("1"), until=("tour",)) as performer:
        performer.begin_mission()
        wait_for(lambda: len(logged(log)) == 4)
        performer.finish()
    assert logged(log) == ["zed", "mid", "ant", "zed", "unzed", "unant", "unmid"]


def test_a_change_during_which_the_manager_is_killed_is_undone(bench: Bench, tmp_path: Path) -> None:
    """By its own command, after it has acted and before anybody could note that."""
    log = tmp_path / "log"
    fleet = create_trial_fleet(bench.fleet, "dead", bench.probe())
    killer = f"{LOG}; import os; os.kill(os.getppid(), 9)"
    events = [
        MissionEvent(name="zed", at=0.0, run=EventCommand(argv=log_to(log, "a"), undo=log_to(log, "una"))),
        MissionEvent(
            name="ant",
            at=0.0,
            run=EventCommand(argv=(sys.executable, "-c", killer, str(log), "b"), undo=log_to(log, "unb")),
        ),
    ]
    manager = os.fork()
    if manager == 0:
        means = EventMeans(fleet=fleet, ask=ask_nobody, ended=threading.Event())
        EventPerformer(events, means, build_uniform_draw("1"), until=("tour",)).__enter__()
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(manager, 0)[1]) == -signal.SIGKILL
    assert logged(log) == ["a", "b"]
    clean_up_trials(bench.fleet)
    assert logged(log) == ["a", "b", "unb", "una"]


def test_nothing_is_changed_that_could_not_be_undone_after_a_kill(bench: Bench, tmp_path: Path) -> None:
    """The disk does not take the record of the change, so that the program does not run."""
    log = tmp_path / "log"
    fleet = create_trial_fleet(bench.fleet, "full", bench.probe())
    (fleet.state / "changes.json.tmp").mkdir()
    means = EventMeans(fleet=fleet, ask=ask_nobody, ended=threading.Event())
    run = EventCommand(argv=log_to(log, "on"), undo=log_to(log, "off"))
    event = MissionEvent(name="a", at=0.0, run=run)
    with EventPerformer([event], means, build_uniform_draw("1"), until=("tour",)) as performer:
        (record,) = performer.finish()
    assert "cannot open" in record.error
    assert logged(log) == []
    assert any("event a: cannot open" in said for said in bench.said)
    clean_up_trials(bench.fleet)


def test_a_person_is_asked_at_the_terminal_only(capsys: pytest.CaptureFixture[str]) -> None:
    """Without a terminal the time passes, or the trial ends first."""
    assert not ask_person("open the \x1b[31mdoor", 0.05, threading.Event())
    ended = threading.Event()
    ended.set()
    assert not ask_person("close it", 3600.0, ended)
    assert capsys.readouterr().err.splitlines() == [
        "open the \\x1b[31mdoor (within 0.1s; stdin is not a terminal)",
        "close it (within 1h00m; stdin is not a terminal)",
    ]


def test_a_person_confirms_with_enter(monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, terminal = os.openpty()
    with os.fdopen(terminal) as stdin, os.fdopen(keyboard, "wb", buffering=0) as keys:
        monkeypatch.setattr(sys, "stdin", stdin)
        assert not ask_person("wait", 0.05, threading.Event()), "nobody typed anything"
        keys.write(b"\n")
        assert ask_person("open the door", patience(30.0), threading.Event())
