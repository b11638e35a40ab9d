# SPDX-License-Identifier: Apache-2.0
"""The use cases over simulated hosts, with the real scheduler, lock, journal and manager state."""

import dataclasses
from pathlib import Path

import pytest

from edgectl.errors import LockBusyError, StalePlanError, UnansweredError, UsageError
from edgectl.formats.kinds import PLAN_KIND
from edgectl.model.check import Check
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Plan
from edgectl.model.policy import Policy
from edgectl.model.result import Outcome
from edgectl.model.task import TaskKind, Tasks
from edgectl.state import failpoints
from edgectl.state.journal_reader import read_journal
from edgectl.state.lock import FleetLock
from edgectl.state.manager_state import load_manager_state, save_manager_state, select_saved_fields
from edgectl.transport.agent_client import build_agent_command
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import ApplyOptions, apply_saved_plan, plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.logs import follow_log, read_log
from edgectl.usecases.plan import limit_plan_to_tasks, list_remote_commands, make_plan
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.stop import restart_tasks, stop_tasks
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet, FakeHost

POLICY = Policy()


class Bench:
    """A fleet of two edges and a robot, two tasks, and the files of its manager."""

    def __init__(self, state: Path) -> None:
        self.hosts = FakeFleet.of(["edge1", "edge2", "robot1"])
        self.said: list[str] = []
        self.now = NOW
        inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"))
        tasks = some_tasks(
            a_task("slam", cpu=1.0, robots=["robot1"]),
            a_task("navigation", cpu=0.5, robots=["robot1"], needs=["slam"]),
        )
        self.fleet = Fleet(
            inventory=inventory,
            tasks=tasks,
            transport=self.hosts.transport,
            state=state,
            clock=self._tick,
            warn=self.said.append,
        )

    def _tick(self) -> float:
        self.now += 1.0
        return self.now

    def with_tasks(self, tasks: Tasks) -> Fleet:
        return dataclasses.replace(self.fleet, tasks=tasks)

    @property
    def memory(self) -> ManagerState:
        return load_manager_state(self.fleet.state)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def actions_by_task(made: Plan) -> dict[str, Action]:
    return {step.task: step.action for step in made.steps}


def test_apply_starts_what_is_missing_and_a_second_one_changes_nothing(bench: Bench) -> None:
    applied = plan_and_apply(bench.fleet, POLICY)
    assert applied.results is not None
    assert applied.results.done
    assert applied.results.revision == 1
    assert bench.hosts.placed.keys() == {"slam", "navigation"}
    assert bench.memory.managed
    assert bench.memory.placements["slam"].host == bench.hosts.placed["slam"]
    assert bench.memory.first == bench.hosts.placed
    again = plan_and_apply(bench.fleet, POLICY)
    assert again.results is None
    assert actions_by_task(again.plan) == {"slam": Action.KEEP, "navigation": Action.KEEP}
    assert read_journal(bench.fleet.state / "journal.jsonl").revision == 1


def test_a_declined_plan_touches_nothing(bench: Bench) -> None:
    shown: list[Plan] = []

    def decline(made: Plan) -> bool:
        shown.append(made)
        return False

    applied = plan_and_apply(bench.fleet, POLICY, decline)
    assert applied.declined
    assert shown[0].summary == {Action.START: 2}
    assert bench.hosts.world.events == []
    assert not (bench.fleet.state / "journal.jsonl").exists()


def test_one_apply_at_a_time(bench: Bench) -> None:
    with FleetLock(bench.fleet.state), pytest.raises(LockBusyError):
        plan_and_apply(bench.fleet, POLICY)


def test_another_manager_on_a_host_is_named_with_the_time_until_it_is_free(bench: Bench) -> None:
    """Also where that manager froze and the host counts its lease longer: apply waits only if it is told to."""
    answer, left = bench.hosts["edge1"]._probe, [5.0, 5.0, 0.0]

    def probe(request: dict[str, object]) -> dict[str, object]:
        left_s = left.pop(0)
        held = {
            "state": "held",
            "who": "ana@lab",
            "verb": "apply",
            "age_s": 33.0,
            "left_s": left_s,
            "every_s": 0.0,
        }
        return {**answer(request), **({"lease": held} if left_s else {})}

    bench.hosts["edge1"].faults["probe"] = probe
    expected = r"ana@lab \(apply, for 33s, free in 5.0s unless renewed\) holds this fleet on edge1"
    with pytest.raises(LockBusyError, match=expected):
        plan_and_apply(bench.fleet, POLICY)
    applied = plan_and_apply(bench.fleet, POLICY, options=ApplyOptions(lock_timeout=60.0))
    assert applied.results is not None
    assert applied.results.done
    assert left == []


def test_load_elsewhere_moves_a_task_after_its_dwell(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    first = bench.hosts.placed["slam"]
    other = "edge2" if first == "edge1" else "edge1"
    bench.hosts[first].used = 4.0
    bench.now += 600.0
    made = plan_and_apply(bench.fleet, POLICY)
    assert made.results is not None
    assert made.results.done
    assert bench.hosts.placed["slam"] == other
    assert not bench.hosts.world.overlap
    assert bench.memory.placements["slam"].host == other
    assert len(bench.memory.downtimes["slam", other]) == 1
    assert bench.memory.first["slam"] == first


def test_a_task_that_died_is_started_again(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    bench.hosts[bench.hosts.placed["slam"]].tasks.pop("slam")
    applied = plan_and_apply(bench.fleet, POLICY)
    assert actions_by_task(applied.plan)["slam"] is Action.START
    assert "slam" in bench.hosts.placed


def test_tasks_of_a_silent_host_are_held_and_not_doubled(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    silent = bench.hosts.placed["slam"]
    bench.hosts.down.add(silent)
    applied = plan_and_apply(bench.fleet, POLICY)
    assert actions_by_task(applied.plan)["slam"] is Action.HOLD
    assert applied.results is None
    assert bench.memory.placements["slam"].host == silent
    bench.hosts.down.clear()
    assert not make_plan(bench.fleet, POLICY).changes


def test_generations_grow_even_when_the_manager_forgot(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    before = bench.memory.placements["slam"].generation
    (bench.fleet.state / "memory.json").unlink()
    stop_tasks(bench.fleet, ["slam"])
    plan_and_apply(bench.fleet, POLICY)
    assert bench.memory.placements["slam"].generation > before >= NOW


def test_a_manager_whose_clock_is_behind_takes_over_what_another_one_stopped(
    bench: Bench, tmp_path: Path
) -> None:
    plan_and_apply(bench.fleet, POLICY)
    stop_tasks(bench.fleet, ["slam"])
    (tmp_path / "other").mkdir(mode=0o700)
    bench.now -= 3600.0
    applied = plan_and_apply(dataclasses.replace(bench.fleet, state=tmp_path / "other"), POLICY)
    assert applied.results is not None
    assert applied.results.done, applied.results


def test_a_manager_that_was_overtaken_is_refused_and_recovers(bench: Bench, tmp_path: Path) -> None:
    """Two managers with separate state: the second restarts slam while the first shows its plan."""
    plan_and_apply(bench.fleet, POLICY)
    (tmp_path / "other").mkdir(mode=0o700)
    other = dataclasses.replace(bench.fleet, state=tmp_path / "other")
    changed = bench.with_tasks(
        some_tasks(dataclasses.replace(bench.fleet.tasks.tasks["slam"], spec_hash="new"))
    )

    def overtaken(_plan: Plan) -> bool:
        bench.now += 100.0
        restart_tasks(other, ["slam"])
        bench.now -= 50.0
        return True

    applied = plan_and_apply(changed, POLICY, overtaken)
    assert applied.results is not None
    (result,) = (result for result in applied.results.actions if result.task == "slam")
    assert result.outcome is Outcome.FAILED
    assert "is older than" in result.error
    assert not bench.hosts.world.overlap
    again = plan_and_apply(changed, POLICY)
    assert again.results is not None
    assert again.results.done


def test_a_saved_plan_is_applied_once(bench: Bench) -> None:
    made = PLAN_KIND.decode(PLAN_KIND.encode(make_plan(bench.fleet, POLICY)))
    applied = apply_saved_plan(bench.fleet, made)
    assert applied.results is not None
    assert applied.results.done
    with pytest.raises(StalePlanError, match="it was applied before"):
        apply_saved_plan(bench.fleet, made)


def test_a_plan_without_changes_applies_as_often_as_one_likes(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    made = make_plan(bench.fleet, POLICY)
    assert apply_saved_plan(bench.fleet, made).results is None
    assert apply_saved_plan(bench.fleet, made).results is None


def test_a_stale_plan_is_refused_with_all_that_moved(bench: Bench) -> None:
    made = make_plan(bench.fleet, POLICY)
    bench.hosts["edge2"].runs("slam")
    bench.hosts.down.add("robot1")
    operator_marks.cordon_hosts(bench.fleet, ["edge2"])
    changed = dataclasses.replace(bench.fleet, tasks=dataclasses.replace(bench.fleet.tasks, digest="other"))
    with pytest.raises(StalePlanError) as caught:
        apply_saved_plan(changed, made)
    assert caught.value.changes == (
        "the task files changed",
        "the cordoned hosts changed",
        "slam runs on edge2 now",
        "robot1 no longer answers",
    )
    assert bench.hosts.changes == []


@pytest.mark.parametrize("used", [0.39, 2.0])
def test_a_load_that_changes_no_decision_is_no_reason_to_refuse(bench: Bench, used: float) -> None:
    made = make_plan(bench.fleet, POLICY)
    for host in ("edge1", "edge2"):
        bench.hosts[host].used = used
    assert apply_saved_plan(bench.fleet, made).results is not None


def test_a_load_that_changes_a_decision_makes_a_plan_stale(bench: Bench) -> None:
    made = make_plan(bench.fleet, POLICY)
    (slam,) = (step.decision for step in made.steps if step.task == "slam")
    other = "edge2" if slam.host == "edge1" else "edge1"
    bench.hosts[str(slam.host)].used = 0.39
    with pytest.raises(StalePlanError) as caught:
        apply_saved_plan(bench.fleet, made)
    assert f"slam: {slam.host} in the plan, {other} if planned now" in caught.value.changes[0]
    assert bench.hosts.changes == []


def test_a_restarted_task_makes_a_plan_stale(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    made = make_plan(bench.fleet, POLICY)
    host = bench.hosts.placed["slam"]
    bench.hosts[host].tasks["slam"]["instance"] = "another"
    with pytest.raises(StalePlanError, match=f"slam was restarted on {host}"):
        apply_saved_plan(bench.fleet, made)


def test_targets_act_on_a_part_of_the_plan(bench: Bench) -> None:
    applied = plan_and_apply(
        bench.fleet, POLICY, options=ApplyOptions(choose=lambda made: limit_plan_to_tasks(made, {"slam"}))
    )
    assert applied.results is not None
    assert [result.task for result in applied.results.actions] == ["slam"]
    assert bench.hosts.placed.keys() == {"slam"}


def test_stop_and_apply_again(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    applied = stop_tasks(bench.fleet, ["navigation"])
    assert applied.results is not None
    assert applied.results.revision == 2
    assert bench.hosts.placed.keys() == {"slam"}
    assert "navigation" not in bench.memory.placements
    plan_and_apply(bench.fleet, POLICY)
    assert bench.hosts.placed.keys() == {"slam", "navigation"}


def test_stop_all_takes_tasks_of_other_files_too(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    bench.hosts["edge2"].runs("stranger")
    applied = stop_tasks(bench.fleet, None)
    assert applied.results is not None
    assert applied.results.done
    assert bench.hosts.placed == {}
    assert stop_tasks(bench.fleet, None).results is None


def test_stop_of_an_unknown_task_is_a_usage_error(bench: Bench) -> None:
    with pytest.raises(UsageError, match="unknown task 'slamm'"):
        stop_tasks(bench.fleet, ["slamm"])
    assert stop_tasks(bench.fleet, ["slam"]).results is None


def test_restart_keeps_the_place(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    host = bench.hosts.placed["slam"]
    since = bench.memory.placements["slam"].since
    old = bench.hosts[host].tasks["slam"]["instance"]
    applied = restart_tasks(bench.fleet, ["slam"])
    assert applied.results is not None
    assert applied.results.actions[0].outcome is Outcome.DONE
    assert bench.hosts[host].tasks["slam"]["instance"] != old
    assert bench.memory.placements["slam"].since == since
    with pytest.raises(UsageError, match="camera"):
        restart_tasks(bench.fleet, ["camera"])


def test_done_stops_a_task_until_it_is_reopened(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    operator_marks.mark_tasks_done(bench.fleet, ["navigation"])
    assert actions_by_task(plan_and_apply(bench.fleet, POLICY).plan)["navigation"] is Action.COMPLETE
    assert bench.hosts.placed.keys() == {"slam"}
    assert not make_plan(bench.fleet, POLICY).changes
    operator_marks.reopen_tasks(bench.fleet, ["navigation"])
    assert actions_by_task(make_plan(bench.fleet, POLICY))["navigation"] is Action.START
    with pytest.raises(UsageError, match="unknown task 'nav'"):
        operator_marks.mark_tasks_done(bench.fleet, ["nav"])


def test_a_job_that_ended_is_remembered(bench: Bench) -> None:
    job = bench.with_tasks(some_tasks(a_task("job", kind=TaskKind.JOB)))
    plan_and_apply(job, POLICY)
    host = bench.hosts[bench.hosts.placed["job"]]
    host.tasks["job"] |= {"state": "completed", "pid": 0, "exit_code": 0}
    assert not plan_and_apply(job, POLICY).plan.changes
    host.tasks.clear()
    assert not plan_and_apply(job, POLICY).plan.changes
    assert bench.memory.done == {"job": "hash-job"}


def test_a_reopened_job_runs_again(bench: Bench) -> None:
    job = bench.with_tasks(some_tasks(a_task("job", kind=TaskKind.JOB)))
    plan_and_apply(job, POLICY)
    host = bench.hosts[bench.hosts.placed["job"]]
    host.tasks["job"] |= {"state": "completed", "pid": 0, "exit_code": 0}
    plan_and_apply(job, POLICY)
    operator_marks.reopen_tasks(job, ["job"])
    assert actions_by_task(make_plan(job, POLICY))["job"] is Action.START


def give_up_slam(bench: Bench) -> FakeHost:
    """slam has crashed until it was given up; returns its host."""
    plan_and_apply(bench.fleet, POLICY)
    host = bench.hosts[bench.hosts.placed["slam"]]
    host.tasks["slam"] |= {"state": "crashloop", "pid": 0, "exit_code": 1, "given_up": True}
    return host


def test_a_crash_loop_is_not_started_again_by_every_apply(bench: Bench) -> None:
    host = give_up_slam(bench)
    before = list(bench.hosts.changes)
    for _ in range(3):
        assert actions_by_task(plan_and_apply(bench.fleet, POLICY).plan)["slam"] is Action.UNPLACED
    bench.hosts.down.add(host.name)
    assert actions_by_task(plan_and_apply(bench.fleet, POLICY).plan)["slam"] is Action.HOLD, (
        "nor elsewhere, when its host falls silent"
    )
    assert bench.hosts.changes == before
    bench.hosts.down.clear()
    changed = dataclasses.replace(bench.fleet.tasks.tasks["slam"], spec_hash="new")
    assert actions_by_task(make_plan(bench.with_tasks(some_tasks(changed)), POLICY))["slam"] is Action.START


def test_restart_starts_what_was_given_up(bench: Bench) -> None:
    give_up_slam(bench)
    assert restart_tasks(bench.fleet, ["slam"], lambda _plan: False).declined
    assert actions_by_task(make_plan(bench.fleet, POLICY))["slam"] is Action.UNPLACED, (
        "declined, so it is still given up"
    )
    applied = restart_tasks(bench.fleet, ["slam"])
    assert applied.results is not None
    assert applied.results.done
    assert [action.task for action in applied.results.actions] == ["slam"]
    assert bench.hosts[bench.hosts.placed["slam"]].tasks["slam"]["pid"]
    assert not make_plan(bench.fleet, POLICY).changes


def test_several_tasks_are_restarted_at_once_or_none_is(bench: Bench) -> None:
    """One runs, the other was given up."""
    give_up_slam(bench)
    host = bench.hosts[bench.hosts.placed["navigation"]]
    old = host.tasks["navigation"]["instance"]
    with pytest.raises(UsageError, match="unknown task 'camera'"):
        restart_tasks(bench.fleet, ["navigation", "slam", "camera"])
    assert host.tasks["navigation"]["instance"] == old
    applied = restart_tasks(bench.fleet, ["navigation", "slam", "navigation"])
    assert applied.results is not None
    assert applied.results.done
    assert actions_by_task(applied.plan) == {"navigation": Action.RESTART, "slam": Action.START}
    assert host.tasks["navigation"]["instance"] != old
    assert bench.hosts[bench.hosts.placed["slam"]].tasks["slam"]["pid"]


def test_restart_of_what_was_given_up_and_has_no_place(bench: Bench) -> None:
    give_up_slam(bench)
    operator_marks.cordon_hosts(bench.fleet, ["edge1", "edge2"])
    with pytest.raises(UsageError, match="slam has no placement now"):
        restart_tasks(bench.fleet, ["slam"])


def test_reopen_lets_the_next_apply_start_what_was_given_up(bench: Bench) -> None:
    give_up_slam(bench)
    operator_marks.reopen_tasks(bench.fleet, ["slam"])
    assert actions_by_task(plan_and_apply(bench.fleet, POLICY).plan)["slam"] is Action.START


def test_drained_hosts_are_left(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    host = bench.hosts.placed["slam"]
    operator_marks.cordon_hosts(bench.fleet, [host], drain=True)
    plan_and_apply(bench.fleet, POLICY)
    assert host not in bench.hosts.placed.values()
    operator_marks.uncordon_hosts(bench.fleet, [host])
    assert bench.memory.cordons == bench.memory.draining == frozenset()


def test_logs_come_from_where_the_task_is(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    assert read_log(bench.fleet, "slam", tail=7) == "7 lines of slam\n"
    assert b"".join(follow_log(bench.fleet, "slam", tail=3)) == b"3 lines of slam\n"
    with pytest.raises(UsageError, match="unknown task 'camera'"):
        read_log(bench.fleet, "camera")
    bench.hosts.down.update({"edge1", "edge2"})
    with pytest.raises(UnansweredError, match=r"no logs of slam, last known on edge., which does not answer"):
        read_log(bench.fleet, "slam")


def test_a_probe_carries_the_memory_and_a_plan_from_it_needs_no_host(bench: Bench) -> None:
    save_manager_state(
        bench.fleet.state, ManagerState(managed=True, placements={"slam": Placement(host="edge2", since=1.0)})
    )
    snapshot = probe_fleet(bench.fleet)
    assert snapshot.manager is not None
    assert select_saved_fields(snapshot.manager) == bench.memory
    assert snapshot.manager.contact.keys() == {"edge1", "edge2", "robot1"}
    bench.hosts.down.update(bench.hosts.hosts)
    assert make_plan(bench.fleet, POLICY, snapshot=snapshot).summary == {Action.START: 2}


def test_a_dry_run_shows_the_exact_requests_and_sends_none(bench: Bench) -> None:
    made = make_plan(bench.fleet, POLICY)
    entries = list_remote_commands(bench.fleet, made)
    assert [(entry["task"], entry["phase"]) for entry in entries] == [
        ("slam", "reach"),
        ("slam", "start"),
        ("slam", "ready"),
        ("navigation", "reach"),
        ("navigation", "start"),
        ("navigation", "ready"),
    ]
    assert entries[0]["command"] == build_agent_command("python3")
    stdin = entries[1]["stdin"]
    assert isinstance(stdin, dict)
    assert stdin["spec"]["env"]["EDGECTL_ROBOT_HOST"] == "robot1.lab"
    assert bench.hosts.changes == []


def test_a_cut_off_apply_is_said_and_mended_by_the_next(bench: Bench) -> None:
    """The manager dies after the host accepted the start and before the reply: nothing is started twice."""

    def die(point: str) -> None:
        if point == "start acknowledged":
            raise KeyboardInterrupt

    remove = failpoints.install_hook(die)
    try:
        with pytest.raises(KeyboardInterrupt):
            plan_and_apply(bench.fleet, POLICY)
    finally:
        remove()
    assert bench.hosts.changes == [f"start slam {bench.hosts.placed['slam']}"]
    applied = plan_and_apply(bench.fleet, POLICY)
    assert actions_by_task(applied.plan) == {"slam": Action.KEEP, "navigation": Action.START}
    assert bench.said == [
        "revision 1 was interrupted while it changed slam; the hosts were asked for their running tasks"
    ]
    assert not bench.hosts.world.overlap


def test_a_failed_action_is_in_the_results_and_the_rest_goes_on(bench: Bench) -> None:
    never = a_task("slam", ready=Check(command="never", timeout=0.1))
    tasks = some_tasks(never, a_task("camera"))
    for name in ("edge1", "edge2"):
        bench.hosts[name].faults["wait:slam"] = lambda _request: {"state": "running"}
    applied = plan_and_apply(bench.with_tasks(tasks), POLICY)
    assert applied.results is not None
    assert {result.task: result.outcome for result in applied.results.actions} == {
        "slam": Outcome.FAILED,
        "camera": Outcome.DONE,
    }
    assert bench.memory.placements.keys() == {"slam", "camera"}
