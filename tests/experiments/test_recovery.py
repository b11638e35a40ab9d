# SPDX-License-Identifier: Apache-2.0
"""Recovery after events: by hand, in simulated runs, and of trials."""

from dataclasses import replace

import pytest

from edgectl.experiments.event_results import (
    Recovered,
    measure_sim_recoveries,
    measure_trial_recoveries,
    summarize_events,
    summarize_kinds,
)
from edgectl.experiments.model.comparison import Estimate
from edgectl.experiments.model.experiment import (
    Experiment,
    MetricReading,
    PlacementInterval,
    RecoveryMetric,
    Trial,
)
from edgectl.experiments.model.mission_event import EventRecord, HostLoad, LinkChange, MissionEvent
from edgectl.experiments.model.scenario import SimJob, SimRun
from edgectl.experiments.recovery import Course, RecoveryRule, compute_recoveries
from edgectl.model.task import Need, NeedCondition
from tests.builders import a_task
from tests.experiments.test_simulated_events import build_scenario, find_first_host, run_scenario, simulate

RULE = RecoveryRule(window=10.0, steady=20.0, within=0.1)
Points = list[tuple[float, float | None]]


def recover(points: Points, at: float = 50.0, end: float = 200.0, rule: RecoveryRule = RULE) -> float | None:
    return compute_recoveries({"t": Course(points, end)}, [(at, ())], end, rule)[0]


@pytest.mark.parametrize(
    ("points", "recovery"),
    [
        ([(0.0, 1.0)], 0.0),
        ([(0.0, 1.0), (50.0, None), (57.25, 1.0)], 7.25),
        ([(0.0, 1.0), (62.0, None), (65.0, 1.0)], 15.0),
        ([(0.0, 1.0), (50.0, 0.5), (80.0, 1.0)], 28.0),
        ([(0.0, 1.0), (50.0, 0.95)], 0.0),
        ([(0.0, 1.0), (50.0, 0.85)], None),
        ([(0.0, 1.0), (50.0, None)], None),
        ([(0.0, 1.0), (85.0, None), (88.0, 1.0)], 0.0),
        ([(0.0, None), (55.0, 1.0)], 0.0),
        ([(0.0, 0.5), (45.0, 1.0), (50.0, 0.7)], 0.0),
    ],
    ids=[
        "undisturbed",
        "a gap at once",
        "a gap that the scheduler makes with its next plan",
        "slow until 80 s; a mean of ten seconds forgives one of them, to 90 %",
        "slower by less than a tenth",
        "slower by more, for good",
        "gone",
        "what comes later than the steady time is another story",
        "a task that did not run before was not disturbed",
        "as good as the mean of the ten seconds before, 0.75",
    ],
)
def test_recovery_by_hand(points: Points, recovery: float | None) -> None:
    found = recover(points)
    assert found == (None if recovery is None else pytest.approx(recovery, abs=1.01))
    if recovery is not None and recovery in (7.25, 15.0):
        assert found == pytest.approx(recovery)


def test_the_next_event_ends_the_time_to_recover() -> None:
    """Slow from 50 s to 80 s, and another event at 75 s; one at 60 s belongs to the first."""
    course = Course([(0.0, 1.0), (50.0, 0.5), (80.0, 1.0)], 200.0)
    assert compute_recoveries({"t": course}, [(50.0, ()), (75.0, ())], 200.0, RULE)[0] is None
    near = compute_recoveries({"t": course}, [(50.0, ()), (60.0, ())], 200.0, RULE)
    assert near == [pytest.approx(29.0, abs=1.01), pytest.approx(0.0, abs=20.0)]


def test_a_task_that_has_completed_need_not_run() -> None:
    gone = {"t": Course([(0.0, 1.0), (50.0, None)], 58.0), "u": Course([(0.0, 1.0)], 200.0)}
    assert compute_recoveries(gone, [(50.0, ())], 200.0, RULE) == [8.0]


def test_tasks_that_enter_have_to_run() -> None:
    courses = {"t": Course([(0.0, 1.0)], 200.0), "new": Course([(50.0, None), (64.0, 1.0)], 200.0)}
    assert compute_recoveries(courses, [(50.0, ("new",))], 200.0, RULE) == [14.0]
    late = {**courses, "new": Course([(64.0, 1.0)], 200.0)}
    assert compute_recoveries(late, [(50.0, ("new",))], 200.0, RULE) == [14.0], "seen only once it ran"
    assert compute_recoveries({"t": courses["t"]}, [(50.0, ("new",))], 200.0, RULE) == [None]


def test_of_a_metric_that_should_be_low_gaps_do_not_count() -> None:
    """A latency of 20 ms, a gap of 6 s, 80 ms for 10 s, and 20 ms again."""
    points: Points = [(0.0, 20.0), (50.0, None), (56.0, 80.0), (66.0, 20.0)]
    rule = replace(RULE, higher=False)
    found = recover(points, rule=rule)
    assert found == pytest.approx(16.0, abs=0.51)


def test_recovery_in_a_simulated_run() -> None:
    """A plan every 10 s: the link becomes slow at 15 s, and the task moves with the plan at 20 s, in no time. Where it may
    not move it never recovers. A stranger on another edge disturbs nothing.
    """
    task = a_task("t", cpu=1.0, throughput=8e5, robots=["rover2"], never=["alder"])
    slow = LinkChange(edge=find_first_host(task), robot="rover2", throughput=1e5)
    far = MissionEvent(name="far", at=15.0, link=slow, kind="")
    run = simulate((far,), task, t=200.0)
    ((record, recovery),) = measure_sim_recoveries(run, 10.0)
    assert record.event == "far"
    assert recovery == pytest.approx(5.0, abs=1.01)
    only = a_task("t", cpu=1.0, throughput=8e5, robots=["rover2"], only=[slow.edge])
    stays = simulate((far,), only, t=80.0)
    assert [each for _, each in measure_sim_recoveries(stays, 10.0)] == [None]
    stranger = MissionEvent(name="s", at=15.0, load=HostLoad(host="alder", cpu=4.0))
    assert [each for _, each in measure_sim_recoveries(simulate((stranger,), task), 10.0)] == [0.0]


def test_a_lost_host_is_recovered_once_its_tasks_run_again() -> None:
    """Off from 15 s to 32 s, and the plan at 40 s."""
    event = MissionEvent(name="off", at=15.0, duration=17.0, lost="zinc")
    tasks = (a_task("t", cpu=1.0, only=["zinc"]), a_task("u", cpu=1.0, only=["mint"]))
    ((_, recovery),) = measure_sim_recoveries(simulate((event,), *tasks), 10.0)
    assert recovery == pytest.approx(25.0)


def test_a_joining_robot_is_recovered_once_its_tasks_run() -> None:
    event = MissionEvent(name="in", at=22.0, join="rover2")
    ((record, recovery),) = measure_sim_recoveries(
        simulate((event,), a_task("t", cpu=1.0, robots=["rover2"]), a_task("u", cpu=1.0)), 10.0
    )
    assert record.tasks == ("t",)
    assert recovery == pytest.approx(8.0)


def test_what_a_joining_robot_brings_later_is_not_waited_for() -> None:
    """The robot's own task has no job in the model, and the tour of its second task begins after that of its first. To
    merge the maps comes at the end: it waits for another task to complete, and what is told of it waits for it.
    """
    event = MissionEvent(name="in", at=22.0, join="rover2")
    body = a_task("body", cpu=0.1, robots=["rover2"])
    merge = a_task("merge", cpu=0.1, needs=[Need(task="t", until=NeedCondition.COMPLETED)])
    tell = a_task("tell", cpu=0.1, needs=[Need(task="merge", until=NeedCondition.READY)])
    tour = a_task("t", cpu=1.0, robots=["rover2"], needs=[Need(task="body", until=NeedCondition.READY)])
    other = a_task("u", cpu=1.0)
    jobs = (
        *(SimJob(name=f"do-{task.name}", task=task.name, work=5.0) for task in (tell, merge)),
        SimJob(name="drive", task="t", work=60.0),
        SimJob(name="wait", task="u", work=150.0),
    )
    run = run_scenario(build_scenario((event,), jobs), tell, merge, tour, body, other)
    ((record, recovery),) = measure_sim_recoveries(run, 10.0)
    assert set(record.tasks) == {"t", "body"}
    assert recovery == pytest.approx(8.0)


RECORD = EventRecord(event="far", kind="link", subject="zinc", at=50.0)
SPEC = Experiment(name="mission", schemes=(), until=("tour",), every=5.0)
TRIAL = Trial(
    scheme="utility",
    repetition=1,
    began_at=0.0,
    latency=200.0,
    finished=True,
    spans=(
        PlacementInterval(task="slam", host="zinc", start=1.0, end=58.0),
        PlacementInterval(task="slam", host="mint", start=64.5, end=200.0),
        PlacementInterval(task="detect", host="alder", start=1.0, end=200.0),
    ),
    readings={
        "fps": {
            "detect": tuple(
                MetricReading(at=float(at), value=4.0 if 50 < at < 90 else 10.0) for at in range(5, 200, 5)
            )
        }
    },
    events=(RECORD,),
)


def test_recovery_of_a_trial_is_by_its_metric() -> None:
    """The move ends at 64.5 s; the frames are back at 90 s. Without a metric only running counts."""
    metric = RecoveryMetric(metric="fps")
    assert measure_trial_recoveries(SPEC, TRIAL) == [(RECORD, 14.5)]
    ((_, recovery),) = measure_trial_recoveries(replace(SPEC, recovery=metric), TRIAL)
    assert recovery == pytest.approx(40.0, abs=2.0)
    unknown = replace(SPEC, recovery=RecoveryMetric(metric="other"))
    ((_, recovery),) = measure_trial_recoveries(unknown, TRIAL)
    assert recovery == pytest.approx(14.5, abs=0.5)
    assert measure_trial_recoveries(SPEC, replace(TRIAL, events=())) == []


def test_each_run_counts_once() -> None:
    """Runs of means 4 and 8; of the second one event was not overcome."""
    later = replace(RECORD, at=90.0, error="exited with 1")
    runs: list[Recovered] = [[(RECORD, 3.0), (later, 5.0)], [(RECORD, 8.0), (later, None)], []]
    (event,) = summarize_events(runs)
    assert (event.event, event.kind, event.subject, event.failed) == ("far", "link", "zinc", 2)
    assert (event.at and event.at.mean) == 50.0
    kinds = summarize_kinds(runs)
    assert kinds == {"link": event.recoveries}
    assert (kinds["link"].count, kinds["link"].not_recovered) == (4, 1)
    assert isinstance(kinds["link"].recovery, Estimate)
    assert (kinds["link"].recovery.mean, kinds["link"].recovery.count) == (6.0, 2)


def test_a_run_without_events_keeps_no_courses() -> None:
    run: SimRun = simulate((), a_task("t", cpu=1.0))
    assert (run.events, run.courses, measure_sim_recoveries(run, 10.0)) == ((), {}, [])
