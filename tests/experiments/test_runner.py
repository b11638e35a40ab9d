# SPDX-License-Identifier: Apache-2.0
"""Experiments on simulated hosts with a fast clock: order of trials, refusals, clean-up."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.errors import ConnectError, FleetBusyError, HostError, LockBusyError, UsageError
from edgectl.experiments.model.experiment import Experiment, ExperimentRun, MapPair, TrialProgress
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.runner import ExperimentOptions, run_experiment
from edgectl.model.check import Check
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import HandoffContract, TaskKind, Tasks
from edgectl.state.failpoints import install_hook
from edgectl.state.journal import JOURNAL_FILE_NAME, Journal
from edgectl.state.journal_reader import read_journal
from edgectl.state.lock import FleetLock
from edgectl.usecases.operator_marks import cordon_hosts
from edgectl.usecases.plan import make_plan
from edgectl.usecases.stop import stop_tasks
from tests.builders import a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.usecases.watch_site import JumpingWait, WatchSite

FLEET: Inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1", onboard=True))
TASKS: Tasks = some_tasks(
    a_task("slam", cpu=1.0, robots=["robot1"]),
    a_task("merge", cpu=0.5, robots=["robot1"], needs=["slam"], kind=TaskKind.JOB),
)
SCHEMES = tuple(
    Scheme(name=name.value, policy=Policy(name=name)) for name in (PolicyName.LOCAL, PolicyName.UTILITY)
)
SPEC = Experiment(name="mission", schemes=SCHEMES, until=("merge",), repetitions=2, every=5.0, limit=60.0)


class Lab(WatchSite):
    """A site with experiments. ``mission`` is called in every cycle; where it does nothing else, ``merge`` completes in the third."""

    def __init__(self, tmp_path: Path) -> None:
        state = tmp_path / "state"
        state.mkdir(mode=0o700, parents=True)
        super().__init__(state, tasks=TASKS, inventory=FLEET)
        self.directory = tmp_path / "run"
        self.said: list[str] = []
        self.seen: list[TrialProgress] = []
        self.mission: Callable[[TrialProgress], None] = self.complete
        self.fleet = replace(self.fleet, warn=self.said.append)

    def run(self, spec: Experiment = SPEC) -> ExperimentRun:
        def watcher(course: TrialProgress) -> None:
            self.seen.append(course)
            if course.cycle is not None:
                self.mission(course)

        options = ExperimentOptions(
            directory=self.directory, spec_directory=Path(), listener=watcher, control=self.control
        )
        return run_experiment(self.fleet, spec, options)

    def complete(self, course: TrialProgress) -> None:
        """The job ends by itself."""
        assert course.cycle is not None
        if course.cycle.number == 3:
            for host in self.hosts.hosts.values():
                if host.tasks.get("merge", {}).get("pid"):
                    host.tasks["merge"] |= {"state": "completed", "pid": 0, "exit_code": 0}
                    host.world.ends("merge", host.name)

    def running(self) -> list[str]:
        return sorted(task for task, places in self.hosts.world.alive.items() if places)

    def trials(self) -> list[str]:
        return sorted(path.name for path in (self.directory / "trials").glob("*"))


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path)


def order(lab: Lab) -> list[tuple[str, int, int]]:
    """The trials as they began."""
    return [
        (course.scheme, course.repetition, course.number)
        for course in lab.seen
        if course.cycle is None and course.trial is None
    ]


def test_every_repetition_of_all_schemes_comes_before_the_next_and_nothing_is_left(lab: Lab) -> None:
    run = lab.run()
    assert order(lab) == [("local", 1, 1), ("utility", 1, 2), ("local", 2, 3), ("utility", 2, 4)]
    assert [(trial.scheme, trial.repetition, trial.finished) for trial in run.trials] == [
        (scheme, repetition, True) for scheme in ("local", "utility") for repetition in (1, 2)
    ]
    assert {(span.task, span.host) for span in run.trials[0].spans} == {
        ("slam", "robot1"),
        ("merge", "robot1"),
    }
    assert {span.host for span in run.trials[2].spans} == {"edge1"}
    assert {(machine.cores, machine.memory) for machine in run.machines.values()} == {(4.0, 4.0 * 2**30)}
    assert (lab.running(), lab.hosts.world.overlap) == ([], set())
    assert sorted(
        path.name for path in lab.fleet.state.iterdir() if not path.name.startswith("reopened")
    ) == ["lock", "manager-id"]
    assert lab.said == []


def test_the_fleet_s_own_manager_knows_nothing_of_the_trials(lab: Lab) -> None:
    lab.run()
    made = make_plan(lab.fleet, Policy())
    assert made.summary == {Action.START: 2}
    assert made.snapshot.manager is not None
    assert not made.snapshot.manager.managed


def test_a_run_that_is_whole_stays_as_it_is_and_one_that_grows_goes_on(lab: Lab) -> None:
    lab.run(replace(SPEC, repetitions=1))
    before = {path: (lab.directory / "trials" / path).read_bytes() for path in lab.trials()}
    lab.seen.clear()
    assert len(lab.run(replace(SPEC, repetitions=1)).trials) == 2
    assert lab.seen == []
    static = Scheme(name="static", policy=Policy(name=PolicyName.STATIC))
    run = lab.run(replace(SPEC, schemes=(*SCHEMES, static)))
    assert order(lab) == [("static", 1, 3), ("local", 2, 4), ("utility", 2, 5), ("static", 2, 6)]
    assert len(run.trials) == 6
    assert {path: (lab.directory / "trials" / path).read_bytes() for path in before} == before


@pytest.mark.parametrize("change", [{"every": 6.0}, {"limit": 61.0}, {"until": ("slam",)}, {"idle": 0.5}])
def test_a_run_of_something_else_is_refused_before_any_host_is_asked(
    lab: Lab, change: dict[str, object]
) -> None:
    lab.run(replace(SPEC, repetitions=1))
    lab.transport.connected.clear()
    with pytest.raises(UsageError, match="have changed since it began") as caught:
        lab.run(replace(SPEC, **change))  # type: ignore[arg-type]
    assert "--out" in caught.value.hint
    assert not lab.transport.connected
    other = replace(lab.fleet, tasks=replace(TASKS, digest="other"))
    with pytest.raises(UsageError):
        run_experiment(other, SPEC, ExperimentOptions(directory=lab.directory, spec_directory=Path()))


def test_tasks_that_run_already_are_named_and_not_touched(lab: Lab) -> None:
    lab.hosts["edge2"].runs("slam")
    with pytest.raises(FleetBusyError, match="slam runs on edge2") as caught:
        lab.run()
    assert (caught.value.exit_code, lab.running(), lab.directory.exists()) == (75, ["slam"], False)


def test_a_busy_host_is_waited_for_and_then_named(lab: Lab) -> None:
    lab.hosts["edge2"].used = 2.0
    with pytest.raises(FleetBusyError, match="edge2 uses 50% of its CPU \\(limit 25%\\)") as caught:
        lab.run()
    assert (caught.value.exit_code, lab.directory.exists()) == (75, False)
    looked = lab.control.waited
    assert looked
    assert lab.run(replace(SPEC, idle=0.5, repetitions=1)).trials[0].finished


def test_a_host_that_does_not_answer_is_named(lab: Lab) -> None:
    lab.hosts.down.add("edge2")
    with pytest.raises(FleetBusyError, match="edge2 does not answer: no route to host") as caught:
        lab.run()
    assert (caught.value.exit_code, caught.value.hint, lab.directory.exists()) == (
        75,
        "edgectl doctor edge2",
        False,
    )


def test_a_trial_that_reaches_its_limit_is_kept_as_unfinished_and_the_next_comes(lab: Lab) -> None:
    lab.mission = lambda course: lab.complete(course) if course.scheme == "utility" else None
    run = lab.run(replace(SPEC, repetitions=1))
    assert [(trial.scheme, trial.finished) for trial in run.trials] == [("local", False), ("utility", True)]
    assert (run.trials[0].latency, lab.running()) == (60.0, [])


def test_a_mission_whose_last_task_was_given_up_is_not_waited_for(lab: Lab) -> None:
    def fail(course: TrialProgress) -> None:
        for host in lab.hosts.hosts.values():
            if host.tasks.get("merge", {}).get("pid"):
                host.tasks["merge"] |= {"state": "crashloop", "pid": 0, "exit_code": 1, "given_up": True}
                host.world.ends("merge", host.name)

    lab.mission = fail
    began = lab.hands.seconds
    run = lab.run(replace(SPEC, repetitions=1, limit=10000.0))
    assert [(trial.finished, trial.latency) for trial in run.trials] == [(False, 10000.0)] * 2
    assert lab.hands.seconds - began < 1000.0
    assert lab.running() == []


def test_one_that_is_told_to_end_stops_its_tasks_and_the_same_call_goes_on(lab: Lab) -> None:
    def ended_in_the_second(course: TrialProgress) -> None:
        if course.number == 2:
            lab.control.stop()
        else:
            lab.complete(course)

    lab.mission = ended_in_the_second
    assert [trial.scheme for trial in lab.run().trials] == ["local"]
    assert lab.running() == []
    lab.control, lab.mission = JumpingWait(lab.hands), lab.complete
    lab.seen.clear()
    assert len(lab.run().trials) == 4
    assert order(lab)[0] == ("utility", 1, 2)


class KilledError(BaseException):
    """As if the process had been killed: nothing is cleaned up."""


def killed(lab: Lab) -> None:
    """End as a kill does in the second cycle of the second trial."""

    def kill(course: TrialProgress) -> None:
        assert course.cycle is not None
        if course.number == 2 and course.cycle.number == 2:
            raise KilledError
        lab.complete(course)

    lab.mission = kill
    with pytest.raises(KilledError):
        lab.run()
    assert lab.running() == ["merge", "slam"]
    lab.mission = lab.complete
    lab.seen.clear()


def test_after_a_kill_what_was_left_is_stopped_and_its_trial_made_again(lab: Lab) -> None:
    killed(lab)
    run = lab.run()
    assert order(lab)[0] == ("utility", 1, 2)
    assert (len(run.trials), lab.running(), lab.hosts.world.overlap) == (4, [], set())
    assert lab.said == []


class Bomb:
    """Counts the points that the main thread comes to; at number ``at`` the process is as if it had been killed."""

    def __init__(self, at: int = 0) -> None:
        self.at, self.count = at, 0

    def __enter__(self) -> "Bomb":
        self.defuse = install_hook(self.reached)
        return self

    def __exit__(self, *exc: object) -> None:
        self.defuse()

    def reached(self, _point: str) -> None:
        if threading.current_thread() is threading.main_thread():
            self.count += 1
            if self.count == self.at:
                raise KilledError


def test_killed_at_any_point_of_a_trial_the_same_call_ends_with_it_done_and_nothing_left(
    tmp_path: Path,
) -> None:
    once = replace(SPEC, repetitions=1, schemes=SCHEMES[1:])
    with Bomb() as counted:
        Lab(tmp_path / "whole").run(once)
    assert counted.count > 20
    for at in sorted({*range(1, 6), *range(6, counted.count + 1, counted.count // 12)}):
        lab = Lab(tmp_path / str(at))
        with Bomb(at), pytest.raises(KilledError):
            lab.run(once)
        run = lab.run(once)
        assert [trial.finished for trial in run.trials] == [True], at
        assert (lab.running(), lab.hosts.world.overlap) == ([], set()), at
        assert not list(lab.fleet.state.glob("trial-*")), at
        assert make_plan(lab.fleet, Policy()).summary == {Action.START: 2}, at


def test_after_a_kill_another_experiment_clears_the_fleet_too(lab: Lab) -> None:
    killed(lab)
    lab.directory = lab.directory.with_name("other")
    assert len(lab.run(replace(SPEC, name="other", limit=61.0)).trials) == 4


def test_what_another_edgectl_has_taken_over_since_is_not_stopped(lab: Lab) -> None:
    killed(lab)
    stop_tasks(lab.fleet, ["merge"])  # by hand, with the fleet's own state: it is managed again
    with pytest.raises(FleetBusyError, match="slam runs on edge1"):
        lab.run()
    assert lab.running() == ["slam"]
    stop_tasks(lab.fleet, None)
    assert len(lab.run().trials) == 4


def test_a_later_start_by_another_manager_is_not_ours(lab: Lab) -> None:
    killed(lab)
    lab.hosts["edge1"].tasks["slam"]["generation"] = 2**32
    with pytest.raises(FleetBusyError, match="slam runs on edge1"):
        lab.run()
    assert lab.running() == ["slam"]


@pytest.mark.parametrize("exit_code", [0, 1])
def test_a_robot_that_holds_is_let_go_by_a_trial_or_remembered_after_it(lab: Lab, exit_code: int) -> None:
    handoff = HandoffContract(hold=Check(command="hold"), release=Check(command="let go"))
    tasks = some_tasks(replace(TASKS.tasks["slam"], handoff=handoff), TASKS.tasks["merge"])
    lab.fleet = replace(lab.fleet, tasks=tasks)
    for host in lab.hosts.hosts.values():
        host.checks["let go"] = exit_code
    with Journal.open(lab.fleet.state) as journal:
        journal.append("phase", task="slam", phase="hold", host="robot1")
    lab.run(replace(SPEC, repetitions=1))
    assert read_journal(lab.fleet.state / JOURNAL_FILE_NAME).held == (() if exit_code == 0 else ("slam",))
    assert [event for event in lab.hosts.world.events if "let go" in event][:1]


def test_what_cannot_be_stopped_is_said_and_its_trial_is_kept(lab: Lab) -> None:
    lab.hosts["edge1"].faults["stop:slam"] = HostError("it hangs")
    with pytest.raises(FleetBusyError, match="slam did not stop"):
        lab.run()
    assert lab.trials() == ["local-1.json", "utility-1.json"]
    lab.hosts["edge1"].faults.clear()
    assert len(lab.run().trials) == 4


def test_a_host_that_falls_silent_in_a_trial_ends_the_run_after_it(lab: Lab) -> None:
    def falls(course: TrialProgress) -> None:
        lab.complete(course)
        if course.number == 2 and course.cycle is not None and course.cycle.number == 1:
            lab.hosts.down.add("edge2")

    lab.mission = falls
    with pytest.raises(FleetBusyError, match="edge2 does not answer"):
        lab.run()
    assert lab.trials() == ["local-1.json", "utility-1.json"]
    lab.hosts.down.clear()
    lab.mission = lab.complete
    run = lab.run()
    assert (len(run.trials), lab.running()) == (4, [])
    assert len(run.trials[2].loads["edge2"]) == 1


def test_no_other_edgectl_changes_the_fleet_meanwhile(lab: Lab) -> None:
    def look(course: TrialProgress) -> None:
        with pytest.raises(LockBusyError, match="experiment"), FleetLock(lab.fleet.state):
            pytest.fail("the lock is free")
        lab.complete(course)

    lab.mission = look
    assert len(lab.run(replace(SPEC, repetitions=1)).trials) == 2


def test_no_other_fleet_s_experiment_writes_into_the_directory_meanwhile(tmp_path: Path) -> None:
    lab, other = Lab(tmp_path / "lab"), Lab(tmp_path / "again")
    other.directory = lab.directory

    def look(course: TrialProgress) -> None:
        with pytest.raises(LockBusyError, match=r"lock held by .*experiment"):
            other.run()
        lab.complete(course)

    lab.mission = look
    assert len(lab.run().trials) == 4
    assert (other.seen, other.running()) == ([], [])
    assert len(other.run().trials) == 4
    assert order(other) == []


def test_what_another_experiment_has_done_while_this_one_waited_is_not_done_again(lab: Lab) -> None:
    other = replace(SPEC, repetitions=1)
    options = ExperimentOptions(directory=lab.directory, spec_directory=Path(), lock_timeout=30.0)
    done: list[ExperimentRun] = []

    def wait_for_it(course: TrialProgress) -> None:
        if not waiting.is_alive() and not done:
            waiting.start()
        lab.complete(course)

    waiting = threading.Thread(target=lambda: done.append(run_experiment(lab.fleet, other, options)))
    lab.mission = wait_for_it
    first = lab.run(other)
    waiting.join(30)
    assert [run.trials for run in done] == [first.trials]


def test_cordoned_hosts_get_no_task_and_are_named(lab: Lab) -> None:
    cordon_hosts(lab.fleet, ["edge1"])
    run = lab.run(replace(SPEC, repetitions=1))
    assert {span.host for span in run.trials[1].spans} == {"edge2"}
    assert lab.said == ["cordoned: edge1; trials start no tasks there"]


def test_a_map_that_cannot_be_had_is_said_and_costs_no_trial(lab: Lab) -> None:
    lab.hosts["edge1"].faults["fetch"] = lab.hosts["robot1"].faults["fetch"] = ConnectError("it is gone")
    maps = {
        "ssim": MapPair(task="merge", file="out/map.yaml", truth="world.yaml"),
        "other": MapPair(task="slam", file="x.pgm", truth="y.pgm"),
    }
    run = lab.run(replace(SPEC, repetitions=1, maps=maps))
    assert [trial.ssim for trial in run.trials] == [{}, {}]
    assert lab.said[0] == "ssim: no map of merge from robot1: it is gone"
    assert len(lab.said) == 4


def test_generations_grow_from_trial_to_trial_even_on_a_clock_that_went_back(lab: Lab) -> None:
    lab.run(replace(SPEC, repetitions=1))
    before = dict(lab.hosts["robot1"].seen)
    lab.hands.seconds -= 5000.0
    run = lab.run()
    assert all(trial.finished for trial in run.trials)
    assert all(lab.hosts["robot1"].seen[task] > generation for task, generation in before.items())
