# SPDX-License-Identifier: Apache-2.0
"""The record of a trial: each instant is that of the event itself, not of its observation."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest

from edgectl.agent.link import sketch
from edgectl.experiments.model.experiment import (
    HandoffRecord,
    LoadSample,
    MetricReading,
    PlacementInterval,
    Trial,
)
from edgectl.experiments.trial_recorder import TrialRecorder
from edgectl.model.cycle import Cycle
from edgectl.model.latency import LatencySample
from edgectl.model.plan import Action, Plan
from edgectl.model.policy import Policy
from edgectl.model.progress import ProgressEvent, ProgressStage
from edgectl.model.result import ActionResult, Outcome, Phase, PhaseResult
from edgectl.model.snapshot import CapacitySource, HostSample, Snapshot, TaskSample, TaskState
from tests.builders import NOW, a_link, a_sample, silent


def a_task(state: TaskState = TaskState.RUNNING, *, since: float = NOW, **fields: object) -> TaskSample:
    return TaskSample(state=state, started_at=since, instance="i", **fields)  # type: ignore[arg-type]


def a_cycle(at: float, tasks: Mapping[str, Mapping[str, TaskSample]], **hosts: HostSample) -> Cycle:
    snapshot = Snapshot(
        taken_at=NOW + at, hosts={**{name: a_sample(tasks=found) for name, found in tasks.items()}, **hosts}
    )
    plan = Plan(
        created_at=NOW + at,
        policy=Policy(),
        inventory_digest="",
        tasks_digest="",
        snapshot=snapshot,
        settled=True,
        steps=(),
        expected={},
    )
    return Cycle(number=1, at=NOW + at - 0.5, snapshot=snapshot, plan=plan)


def ended(phase: Phase, host: str, *, task: str = "slam", ok: bool = True) -> ProgressEvent:
    result = PhaseResult(phase=phase, host=host, seconds=0.25, ok=ok)
    return ProgressEvent(
        stage=ProgressStage.PHASE_END, task=task, action=Action.MOVE, phase=phase, host=host, ended=result
    )


def moved(outcome: Outcome = Outcome.DONE, downtime: float | None = 1.5) -> ProgressEvent:
    result = ActionResult(
        task="slam",
        action=Action.MOVE,
        outcome=outcome,
        host="edge2",
        previous_host="edge1",
        downtime_s=downtime,
    )
    return ProgressEvent(stage=ProgressStage.ACTION_END, task="slam", action=Action.MOVE, result=result)


def record(recorder: TrialRecorder, ended: float = 100.0) -> Trial:
    return recorder.build_trial("static", 1, limit=60.0, ended=NOW + ended, ssim={})


def test_a_move_ends_one_span_begins_another_and_is_a_handoff() -> None:
    recorder = TrialRecorder(["merge"])
    recorder.record_progress(ended(Phase.START, "edge1"), NOW + 1.0)
    recorder.record_cycle(a_cycle(0.0, {"edge1": {}, "edge2": {}}))
    # The cycle that moves the task had seen it on edge1 before it did.
    recorder.record_progress(ended(Phase.STOP, "edge1"), NOW + 6.0)
    recorder.record_progress(ended(Phase.START, "edge2"), NOW + 7.0)
    recorder.record_progress(moved(), NOW + 8.0)
    recorder.record_cycle(a_cycle(5.0, {"edge1": {"slam": a_task(since=NOW + 0.9)}, "edge2": {}}))
    recorder.record_cycle(a_cycle(10.0, {"edge1": {}, "edge2": {"slam": a_task(since=NOW + 6.9)}}))
    trial = record(recorder, 12.0)
    assert trial.spans == (
        PlacementInterval(task="slam", host="edge1", start=1.0, end=6.0),
        PlacementInterval(task="slam", host="edge2", start=7.0, end=12.0),
    )
    assert trial.handoffs == (
        HandoffRecord(task="slam", source="edge1", target="edge2", at=8.0, downtime=1.5),
    )
    assert (trial.began_at, trial.finished, trial.latency) == (NOW, False, 60.0)
    assert recorder.places == {"slam": "edge2"}


def test_a_move_that_failed_is_no_handoff_and_its_task_is_where_it_was_put_back() -> None:
    recorder = TrialRecorder(["merge"])
    recorder.record_cycle(a_cycle(0.0, {"edge1": {"slam": a_task()}, "edge2": {}}))
    for at, event in enumerate(
        (ended(Phase.STOP, "edge1"), ended(Phase.START, "edge2", ok=False), ended(Phase.RESTORE, "edge1")), 1
    ):
        recorder.record_progress(event, NOW + at)
    recorder.record_progress(moved(Outcome.FAILED, None), NOW + 4.0)
    recorder.record_cycle(a_cycle(0.5, {"edge1": {"slam": a_task()}, "edge2": {}}))
    trial = record(recorder, 9.0)
    assert trial.spans == (
        PlacementInterval(task="slam", host="edge1", start=0.0, end=1.0),
        PlacementInterval(task="slam", host="edge1", start=3.0, end=9.0),
    )
    assert trial.handoffs == ()


def test_a_job_completed_when_its_host_says_it_ended() -> None:
    recorder = TrialRecorder(["merge", "check"])
    recorder.record_cycle(a_cycle(0.0, {"edge1": {"merge": a_task(), "check": a_task()}}))
    job, check = a_task(TaskState.COMPLETED, ended_at=NOW + 3.25), a_task(TaskState.COMPLETED, pid=7)
    recorder.record_cycle(a_cycle(5.0, {"edge1": {"merge": job, "check": a_task()}}))
    half = recorder.finished
    recorder.record_cycle(a_cycle(10.0, {"edge1": {"merge": job, "check": check}}))
    assert (half, recorder.finished) == (False, True)
    trial = record(recorder)
    assert (trial.finished, trial.latency, trial.completed) == (True, 10.0, {"merge": 3.25, "check": 10.0})
    assert [(span.task, span.end) for span in trial.spans] == [("check", 10.0), ("merge", 3.25)]


def test_readings_are_taken_while_a_task_runs_and_once_when_it_is_over() -> None:
    recorder = TrialRecorder(["merge"])
    for at, fps in ((0.0, 10.0), (5.0, 12.0)):
        recorder.record_cycle(a_cycle(at, {"edge1": {"merge": a_task(metrics={"fps": fps})}}))
    for at in (10.0, 15.0):
        recorder.record_cycle(
            a_cycle(
                at,
                {"edge1": {"merge": a_task(TaskState.COMPLETED, ended_at=NOW + 8.0, metrics={"fps": 14.0})}},
            )
        )
    found = record(recorder).readings["fps"]["merge"]
    assert found == (
        MetricReading(at=0.0, value=10.0),
        MetricReading(at=5.0, value=12.0),
        MetricReading(at=8.0, value=14.0),
    )


def test_what_links_carry_is_kept_whenever_it_changes() -> None:
    """Of each link by its edge; a host that does not answer says nothing."""
    recorder = TrialRecorder(["merge"])
    slow = replace(a_link(2e5), capacity_source=CapacitySource.TCP)
    fast = replace(a_link(2e6), capacity_source=CapacitySource.DECLARED)
    for at, near, far in ((0.0, fast, fast), (2.0, fast, slow), (4.0, fast, slow), (8.0, slow, fast)):
        zinc, alder = a_sample(links={"rover2": near, "rover1": far}), a_sample(links={"rover2": far})
        recorder.record_cycle(a_cycle(at, {}, zinc=zinc, alder=alder if at < 8 else silent()))
    links = record(recorder).links
    assert {edge: set(found) for edge, found in links.items()} == {
        "zinc": {"rover2", "rover1"},
        "alder": {"rover2"},
    }
    points = {
        pair: [(each.at, each.bytes_per_s, each.source.value) for each in links[pair[0]][pair[1]]]
        for pair in (("zinc", "rover2"), ("zinc", "rover1"), ("alder", "rover2"))
    }
    assert points == {
        ("zinc", "rover2"): [(0.0, 2e6, "declared"), (8.0, 2e5, "tcp")],
        ("zinc", "rover1"): [(0.0, 2e6, "declared"), (2.0, 2e5, "tcp"), (8.0, 2e6, "declared")],
        ("alder", "rover2"): [(0.0, 2e6, "declared"), (2.0, 2e5, "tcp")],
    }


def test_latency_of_a_trial_is_that_of_all_instances_of_a_task() -> None:
    recorder = TrialRecorder({"slam"})

    def sample(instance: str, values: Sequence[float]) -> TaskSample:
        counted = sketch.merge_buckets({sketch.find_bucket(value): 1} for value in values)
        late = sum(value > 50 for value in values)
        buckets = {str(bucket): count for bucket, count in counted.items()}
        latency = LatencySample(count=len(values), misses=late, bound_ms=50.0, buckets=buckets)
        return replace(a_task(latency=latency), instance=instance)

    values = [float(value) for value in range(1, 101)]
    recorder.record_cycle(a_cycle(0.0, {"edge1": {"slam": sample("a", values[:40])}}))
    recorder.record_cycle(a_cycle(2.0, {"edge1": {"slam": sample("a", values[:90])}}))
    recorder.record_cycle(a_cycle(4.0, {"edge2": {"slam": sample("b", values[90:])}}))
    readings = record(recorder).readings
    last = {name: found["slam"][-1].value for name, found in readings.items()}
    assert (last["latency/values"], last["latency/misses"]) == (100.0, 50.0)
    assert last["latency/p95_ms"] == pytest.approx(95.0, rel=0.01)
    assert last["latency/p50_ms"] == pytest.approx(50.0, rel=0.01)


def test_a_host_that_is_silent_has_no_load_and_keeps_its_tasks() -> None:
    recorder = TrialRecorder(["merge"])
    busy = a_sample(
        used=1.5,
        used_memory=2e9,
        links={"robot1": a_link(used=1e6), "robot2": a_link(used=2e6)},
        tasks={"slam": a_task()},
    )
    recorder.record_cycle(a_cycle(0.0, {}, edge1=busy))
    recorder.record_cycle(a_cycle(5.0, {}, edge1=silent()))
    trial = record(recorder, 20.0)
    assert trial.loads == {"edge1": (LoadSample(at=0.0, cores=1.5, memory=2e9, bytes_per_s=3e6),)}
    assert trial.spans == (PlacementInterval(task="slam", host="edge1", start=0.0, end=20.0),)


def test_a_task_that_is_gone_was_there_until_it_was_missed() -> None:
    recorder = TrialRecorder(["merge"])
    recorder.record_cycle(a_cycle(0.0, {"edge1": {"slam": a_task()}}))
    recorder.record_cycle(a_cycle(5.0, {"edge1": {}}))
    assert record(recorder).spans == (PlacementInterval(task="slam", host="edge1", start=0.0, end=5.0),)


def test_what_was_never_planned_is_a_trial_all_the_same() -> None:
    recorder = TrialRecorder(["merge"])
    recorder.record_cycle(Cycle(number=1, at=NOW, error="no space left"))
    trial = record(recorder, 5.0)
    assert (trial.began_at, trial.latency, trial.finished, trial.spans) == (NOW, 60.0, False, ())
