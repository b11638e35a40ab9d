# SPDX-License-Identifier: Apache-2.0
"""move, unpin and start: the mark in the manager's state, what refuses it, and what an apply makes of it."""

import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.errors import EdgectlError, LockBusyError, UnansweredError, UsageError
from edgectl.model.manager_state import ManagerState, Pin
from edgectl.model.plan import Action
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import OnboardRule, Task
from edgectl.state.lock import FleetLock
from edgectl.state.manager_state import MANAGER_STATE_FILE_NAME, load_manager_state, save_manager_state
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.drain import drain_hosts
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.history import plan_rollback
from edgectl.usecases.pins import pin_task, unpin_tasks
from edgectl.usecases.plan import make_plan
from edgectl.usecases.stop import start_tasks, stop_tasks
from tests.builders import NOW, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet

HOSTS = ["edge3", "edge2", "edge1"]
POLICY = Policy(min_dwell=0.0)
SLAM = a_task("slam", cpu=1.0)


class Bench:
    """Three edges of 4 cores, edge2 with 2 in use; slam runs on edge3."""

    def __init__(self, state: Path, *tasks: Task) -> None:
        self.hosts, self.now = FakeFleet.of(HOSTS), NOW
        self.hosts["edge2"].used = 2.0
        self.hosts["edge1"].used = 1.0
        self.fleet = Fleet(
            inventory=an_inventory(*map(an_edge, HOSTS)),
            tasks=some_tasks(*(tasks or (SLAM,))),
            transport=self.hosts.transport,
            state=state,
            clock=lambda: self.now,
        )

    def apply(self, **policy: object) -> dict[str, str]:
        plan_and_apply(self.fleet, replace(POLICY, **policy))  # type: ignore[arg-type]
        return self.hosts.placed

    @property
    def pins(self) -> dict[str, Pin]:
        return dict(load_manager_state(self.fleet.state).pins)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    made = Bench(tmp_path)
    assert made.apply() == {"slam": "edge3"}
    return made


def test_a_move_is_planned_at_once_and_made_by_the_next_apply(bench: Bench) -> None:
    moved = pin_task(bench.fleet, POLICY, "slam", "edge2", duration=60.0)
    assert (moved.step.action, moved.step.decision.host) == (Action.MOVE, "edge2")
    assert bench.hosts.placed == {"slam": "edge3"}
    assert bench.apply(min_dwell=1e9, max_moves=0, attended=False) == {"slam": "edge2"}
    assert not make_plan(bench.fleet, POLICY).changes
    bench.now += 60.0
    assert bench.apply() == {"slam": "edge3"}
    assert bench.pins == {}, "an apply forgets what has ended"


def test_unpin_ends_it_before_its_time(bench: Bench) -> None:
    pin_task(bench.fleet, POLICY, "slam", "edge2")
    bench.apply()
    assert unpin_tasks(bench.fleet, ["slam"], dry_run=True) == {"slam": True}
    assert bench.pins["slam"].host == "edge2"
    assert unpin_tasks(bench.fleet, ["slam"]) == {"slam": True}
    assert unpin_tasks(bench.fleet, ["slam"]) == {"slam": False}
    assert bench.apply() == {"slam": "edge3"}


def test_a_dry_run_plans_and_marks_nothing(bench: Bench) -> None:
    assert pin_task(bench.fleet, POLICY, "slam", "edge2", dry_run=True).step.action is Action.MOVE
    assert bench.pins == {}


def test_the_last_of_several_moves_counts(bench: Bench) -> None:
    for host in ("edge2", "edge1"):
        pin_task(bench.fleet, POLICY, "slam", host)
    assert bench.apply() == {"slam": "edge1"}


@pytest.mark.parametrize(
    ("task", "host", "said", "hint"),
    [
        (SLAM, "edge9", "unknown host 'edge9'", "did you mean edge"),
        (a_task("slam", cpu=5.0), "edge2", "demands more than the whole host", "edgectl describe task slam"),
        (a_task("slam", cpu=0.1, labels={"gpu": "yes"}), "edge2", "lacks the labels gpu=yes", "label it"),
        (
            a_task("slam", cpu=0.1, never=["edge2"]),
            "edge2",
            "in hosts.never",
            "hosts.never of slam in its task file",
        ),
        (
            a_task("slam", cpu=0.1, only=["edge1"]),
            "edge2",
            "hosts.only leaves it out",
            "hosts.only of slam in its task file",
        ),
        (
            a_task("slam", cpu=0.1, pin="edge1"),
            "edge2",
            "pinned to edge1 by its task file",
            "hosts.pin of slam in its",
        ),
        (
            replace(a_task("slam", cpu=0.1), onboard=OnboardRule.ONLY),
            "edge2",
            "leaves edge2 out",
            "onboard of slam in its task file",
        ),
        (a_task("slam", cpu=0.1, managed=False), "edge2", "is not managed by edgectl", "managed: true"),
    ],
)
def test_a_pin_that_could_never_be_followed_is_refused(
    tmp_path: Path, task: Task, host: str, said: str, hint: str
) -> None:
    bench = Bench(tmp_path, task)
    with pytest.raises(UsageError) as refused:
        pin_task(bench.fleet, POLICY, "slam", host)
    assert said in refused.value.message
    assert hint in refused.value.hint
    assert bench.pins == {}


def test_a_silent_or_cordoned_host_takes_no_pin(bench: Bench) -> None:
    operator_marks.cordon_hosts(bench.fleet, ["edge2"])
    bench.hosts.down.add("edge1")
    for host, kind, hint in (
        ("edge2", UsageError, "edgectl uncordon edge2"),
        ("edge1", UnansweredError, "edgectl doctor edge1"),
    ):
        with pytest.raises(EdgectlError) as refused:
            pin_task(bench.fleet, POLICY, "slam", host)
        assert (type(refused.value), refused.value.hint) == (kind, hint)
    with pytest.raises(UsageError, match="policy local"):
        pin_task(bench.fleet, Policy(name=PolicyName.LOCAL), "slam", "edge3")


def test_nothing_is_marked_while_another_edgectl_acts(bench: Bench) -> None:
    with FleetLock(bench.fleet.state, verb="apply"), pytest.raises(LockBusyError):
        pin_task(bench.fleet, POLICY, "slam", "edge2")
    assert bench.pins == {}


def test_a_drain_empties_the_pinned_host_and_uncordon_brings_the_task_back(bench: Bench) -> None:
    pin_task(bench.fleet, POLICY, "slam", "edge2")
    assert bench.apply() == {"slam": "edge2"}
    assert drain_hosts(bench.fleet, POLICY, ["edge2"]).done
    assert bench.hosts.placed == {"slam": "edge3"}
    assert bench.pins["slam"].host == "edge2"
    operator_marks.uncordon_hosts(bench.fleet, ["edge2"])
    assert bench.apply() == {"slam": "edge2"}


def test_a_rollback_leaves_a_pinned_task_at_its_pin(bench: Bench) -> None:
    pin_task(bench.fleet, POLICY, "slam", "edge2")
    bench.apply()
    planned = plan_rollback(bench.fleet, POLICY, 1, ApplyOptions())
    assert [step.decision.host for step in planned.steps] == ["edge2"]


def test_a_state_file_of_an_older_edgectl_has_no_pins(bench: Bench) -> None:
    """And one without pins is written as an older edgectl wrote it, so that it can be read there."""
    path = bench.fleet.state / MANAGER_STATE_FILE_NAME
    assert "pins" not in json.loads(path.read_text())
    pin_task(bench.fleet, POLICY, "slam", "edge2", duration=60.0)
    document = json.loads(path.read_text())
    assert document["pins"]["slam"] == {
        "host": "edge2",
        "since": "2025-11-21T01:53:20Z",
        "pinned_until": "2025-11-21T01:54:20Z",
    }
    del document["pins"]
    path.write_text(json.dumps(document))
    assert bench.pins == {}
    assert bench.apply() == {"slam": "edge3"}


def test_the_pin_of_a_task_that_left_the_files_stays_until_it_is_removed(bench: Bench) -> None:
    pin_task(bench.fleet, POLICY, "slam", "edge2")
    other = replace(bench.fleet, tasks=some_tasks(a_task("nav", cpu=0.1)))
    plan_and_apply(other, POLICY)
    assert list(bench.pins) == ["slam"]
    assert unpin_tasks(other, ["slam"]) == {"slam": True}


def test_one_pin_holds_for_tasks_that_go_together(tmp_path: Path) -> None:
    bench = Bench(tmp_path, SLAM, a_task("nav", cpu=0.1, together=("slam",)))
    pin_task(bench.fleet, POLICY, "slam", "edge2")
    pin_task(bench.fleet, POLICY, "nav", "edge1")
    assert list(bench.pins) == ["nav"]
    assert bench.apply() == {"slam": "edge1", "nav": "edge1"}


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (a_task("ant", cpu=3.5, together=("slam",)), "demands more than the whole host"),
        (a_task("ant", cpu=0.1, apart=("slam",), pin="edge2"), "the file of a task that it is apart from"),
    ],
)
def test_a_pin_that_rules_with_other_tasks_forbid_is_refused(tmp_path: Path, other: Task, said: str) -> None:
    bench = Bench(tmp_path, SLAM, other)
    with pytest.raises(UsageError, match=said):
        pin_task(bench.fleet, POLICY, "slam", "edge2")
    assert bench.pins == {}


def test_start_undoes_stop_done_and_a_failure_and_leaves_the_rest_alone(tmp_path: Path) -> None:
    bench = Bench(tmp_path, SLAM, a_task("nav", cpu=0.1), a_task("camera", cpu=0.1))
    bench.apply()
    stop_tasks(bench.fleet, ["slam", "nav"])
    assert bench.hosts.placed.keys() == {"camera"}
    assert start_tasks(bench.fleet, POLICY, ["slam"]).plan.summary == {Action.START: 1}
    assert bench.hosts.placed.keys() == {"camera", "slam"}
    operator_marks.mark_tasks_done(bench.fleet, ["nav"])
    bench.apply()
    assert bench.hosts.placed.keys() == {"camera", "slam"}
    assert start_tasks(bench.fleet, POLICY, ["nav", "slam"]).plan.summary == {Action.START: 1, Action.KEEP: 1}
    assert bench.hosts.placed.keys() == {"camera", "slam", "nav"}
    assert load_manager_state(bench.fleet.state).done == {}
    host = bench.hosts.placed["nav"]
    bench.hosts[host].tasks["nav"] |= {"state": "failed", "pid": 0, "given_up": True, "exit_code": 3}
    start_tasks(bench.fleet, POLICY, ["nav"])
    found = [each.tasks["nav"] for each in bench.hosts.hosts.values() if "nav" in each.tasks]
    assert "running" in {task["state"] for task in found}


def test_start_goes_to_the_pin(bench: Bench) -> None:
    stop_tasks(bench.fleet, ["slam"])
    pin_task(bench.fleet, POLICY, "slam", "edge1")
    start_tasks(bench.fleet, POLICY, ["slam"])
    assert bench.hosts.placed == {"slam": "edge1"}


def test_start_is_refused_where_the_task_may_still_run(bench: Bench) -> None:
    bench.hosts.down.add("edge3")
    with pytest.raises(UnansweredError, match="not started: slam, last known on edge3"):
        start_tasks(bench.fleet, POLICY, ["slam"])


@pytest.mark.parametrize(
    "act", [stop_tasks, lambda fleet, names, options: start_tasks(fleet, POLICY, names, options=options)]
)
def test_a_dry_run_plans_without_the_lock_and_changes_nothing(bench: Bench, act: object) -> None:
    before = (bench.hosts.placed, load_manager_state(bench.fleet.state))
    events = list(bench.hosts.world.events)
    with FleetLock(bench.fleet.state, verb="apply"):
        applied = act(bench.fleet, ["slam"], options=ApplyOptions(dry_run=True))  # type: ignore[operator]
    assert applied.plan.steps
    assert applied.results is None
    assert (bench.hosts.placed, load_manager_state(bench.fleet.state)) == before
    assert bench.hosts.world.events == events


def test_a_dry_run_of_drain_leaves_no_mark(bench: Bench) -> None:
    drained = drain_hosts(bench.fleet, POLICY, ["edge3"], options=ApplyOptions(dry_run=True))
    assert [step.action for step in drained.applied.plan.steps] == [Action.MOVE]
    assert load_manager_state(bench.fleet.state).cordons == frozenset()
    assert drain_hosts(bench.fleet, POLICY, ["edge1"], options=ApplyOptions(dry_run=True)).done
    assert load_manager_state(bench.fleet.state).cordons == frozenset()


def test_pins_survive_what_else_changes_the_state(bench: Bench) -> None:
    pin_task(bench.fleet, POLICY, "slam", "edge2")
    operator_marks.cordon_hosts(bench.fleet, ["edge1"])
    state = load_manager_state(bench.fleet.state)
    save_manager_state(bench.fleet.state, dataclasses.replace(state, done={}))
    assert isinstance(state, ManagerState)
    assert list(bench.pins) == ["slam"]
