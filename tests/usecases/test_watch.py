# SPDX-License-Identifier: Apache-2.0
"""The watch loop over simulated hosts, with the real scheduler, lock, journal, manager state and history."""

import dataclasses
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from edgectl.errors import InputError, LockBusyError, Problem, RefusedError
from edgectl.model.cycle import Cycle
from edgectl.model.event import EventKind
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action
from edgectl.model.policy import WEIGHT_PRESETS, Policy
from edgectl.model.result import Outcome
from edgectl.model.task import UnreachablePolicy
from edgectl.scheduler.partition import FENCE_SLACK_S
from edgectl.state.lock import FleetLock
from edgectl.state.manager_state import load_manager_state
from edgectl.usecases import operator_marks
from edgectl.usecases.control import Control, ControlRequest
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import load_state_with_heartbeats
from tests.builders import a_standby_rule, a_task, some_tasks
from tests.executor.fake_fleet import FakeHost
from tests.pace import patience
from tests.state.journal_files import read_entries
from tests.usecases.watch_site import EVERY, WatchSite


@pytest.fixture
def site(tmp_path: Path) -> WatchSite:
    return WatchSite(tmp_path)


def list_actions(cycles: list[Cycle]) -> dict[int, list[tuple[str, Action]]]:
    """Return the actions carried out by the number of the cycle."""
    return {
        c.number: [(a.task, a.action) for a in c.results.actions] for c in cycles if c.results is not None
    }


def is_clean(cycles: list[Cycle]) -> bool:
    return not any(c.error or c.warnings or c.busy or c.resting for c in cycles)


def test_it_starts_what_is_missing_and_then_changes_nothing(site: WatchSite) -> None:
    cycles = list(site.watch(20))
    assert [c.number for c in cycles] == list(range(1, 21))
    assert list_actions(cycles) == {1: [("slam", Action.START), ("navigation", Action.START)]}
    assert is_clean(cycles)
    assert site.hosts.placed.keys() == {"slam", "navigation"}
    assert site.transport.connected == {"edge1": 1, "edge2": 1, "robot1": 1}
    assert [c.next_in is None for c in cycles] == [False] * 19 + [True]
    assert cycles[-1].at - cycles[0].at == pytest.approx(19 * EVERY, abs=1.0)
    assert load_manager_state(site.fleet.state).placements.keys() == {"slam", "navigation"}


def test_without_apply_it_only_says_what_it_would_do(site: WatchSite) -> None:
    cycles = list(site.watch(3, apply=False))
    assert all(c.plan is not None and c.plan.summary == {Action.START: 2} for c in cycles)
    assert list_actions(cycles) == {}
    assert site.hosts.world.events == []
    assert not (site.fleet.state / "journal.jsonl").exists()


def test_a_lasting_load_moves_each_task_once_after_its_dwell(tmp_path: Path) -> None:
    tasks = some_tasks(
        a_task("slam", cpu=1.0), a_task("navigation", cpu=0.5), policy=Policy(weights=WEIGHT_PRESETS["cpu"])
    )
    site = WatchSite(tmp_path, tasks=tasks)
    site.hosts["edge1"].cores = site.hosts["edge2"].cores = 8.0

    def load() -> None:
        for name in set(site.hosts.placed.values()):
            site.hosts[name].used = 4.0 if name == site.hosts.placed["slam"] else 0.0

    cycles = list(site.watch(60, {2: load}))
    moves = {number: each for number, each in list_actions(cycles).items() if number > 1}
    assert list(moves.values()) == [[("slam", Action.MOVE)]]
    assert 120 / EVERY <= min(moves) <= 120 / EVERY + 3, "not before min_dwell has passed"
    assert not site.hosts.world.overlap
    assert is_clean(cycles)


def test_a_dead_host_is_held_asked_ever_more_rarely_and_taken_back(site: WatchSite) -> None:
    lost: list[str] = []

    def die() -> None:
        lost.append(site.hosts.placed["slam"])
        site.hosts.down.update(lost)

    cycles = list(site.watch(40, {2: die, 30: site.hosts.down.clear}))
    dead = [c for c in cycles if c.snapshot is not None and not c.snapshot.hosts[lost[0]].ok]
    assert [c.number for c in dead][:28] == list(range(3, 31))
    assert len(dead) <= 34, "it is found again within a minute"
    assert all(c.plan is not None and c.plan.summary.get(Action.HOLD) == 2 for c in dead)
    assert 5 <= site.transport.connected[lost[0]] <= 12
    assert list_actions(cycles).keys() == {1}
    assert is_clean(cycles)
    told = [
        (c.number, event.kind)
        for c in cycles
        for event in c.events
        if event.host in lost and event.kind in (EventKind.HOST_LOST, EventKind.HOST_BACK)
    ]
    assert told == [(dead[0].number, EventKind.HOST_LOST), (dead[-1].number + 1, EventKind.HOST_BACK)]
    assert not site.hosts.world.overlap


def test_a_host_that_flaps_costs_no_move(site: WatchSite) -> None:
    list(site.watch(1))
    flapping = site.hosts.placed["slam"]
    site.hands.seconds += 600.0

    def flap() -> None:
        site.hosts.down ^= {flapping}

    cycles = list(site.watch(90, dict.fromkeys(range(1, 90), flap)))
    seen = [cycle.snapshot is not None and cycle.snapshot.hosts[flapping].ok for cycle in cycles]
    assert sum(a != b for a, b in pairwise(seen)) > 10
    assert list_actions(cycles) == {}
    assert not site.hosts.world.overlap


def test_a_failing_action_is_not_repeated_in_every_cycle(site: WatchSite) -> None:
    for edge in ("edge1", "edge2"):
        site.hosts[edge].faults["start:slam"] = RefusedError("disk full")

    def repair() -> None:
        for edge in ("edge1", "edge2"):
            site.hosts[edge].faults.clear()

    cycles = list(site.watch(55, {40: repair}))
    tried = [number for number, actions in list_actions(cycles).items() if ("slam", Action.START) in actions]
    assert tried[0] == 1
    assert 4 <= len(tried) <= 7, tried
    assert [b - a for a, b in pairwise(tried)][:3] == [4, 7, 13], "30, 60, 120 s"
    assert cycles[1].resting == ("slam",)
    assert all(c.results is None or c.results.actions[0].outcome is Outcome.FAILED for c in cycles[:40])
    assert all(
        c.results is None or c.number > 40 or c.results.actions[1].outcome is Outcome.SKIPPED for c in cycles
    ), "nor begun without it"
    assert site.hosts.placed.keys() == {"slam", "navigation"}
    assert not any(c.error for c in cycles)


def test_the_lock_is_taken_for_changes_alone(site: WatchSite) -> None:
    list(site.watch(1))
    with FleetLock(site.fleet.state):
        assert is_clean(list(site.watch(5))), "nothing was to be done, so nobody asked for the lock"
        site.hosts[site.hosts.placed["slam"]].tasks.pop("slam")
        busy = list(site.watch(2))
    assert all("lock held by" in c.busy for c in busy)
    assert list_actions(busy) == {}
    after = list(site.watch(1))
    assert list_actions(after) == {1: [("slam", Action.START)]}


def test_nobody_else_changes_the_fleet_between_the_sample_and_the_end_of_the_actions(site: WatchSite) -> None:
    policy, refused = site.fleet.tasks.policy, []

    def meanwhile(_fleet: Fleet) -> Policy:
        with pytest.raises(LockBusyError) as error, FleetLock(site.fleet.state):
            pass
        refused.append(error.value.message)
        return policy

    list(site.watch(1, policy=meanwhile))
    assert "watch" in refused[0]
    operator_marks.cordon_hosts(site.fleet, ["edge1"])
    assert load_manager_state(site.fleet.state).cordons == {"edge1"}


def test_completed_tasks_are_remembered_although_nothing_is_carried_out(site: WatchSite) -> None:
    list(site.watch(1))
    host = site.hosts[site.hosts.placed["navigation"]]
    host.tasks["navigation"] |= {"state": "completed", "pid": 0}
    cycles = list(site.watch(3))
    assert is_clean(cycles)
    assert list_actions(cycles) == {}
    assert load_manager_state(site.fleet.state).done == {"navigation": "hash-navigation"}


def test_pausing_samples_on_and_plans_nothing_until_asked(site: WatchSite) -> None:
    cycles = list(site.watch(8, {1: site.control.pause, 4: site.control.now, 6: site.control.pause}))
    assert [c.plan is None for c in cycles] == [False, True, True, True, False, True, False, False]
    assert [c.paused for c in cycles] == [c.plan is None for c in cycles]
    assert all(c.snapshot is not None for c in cycles)
    assert cycles[4].at - cycles[3].at < 1.0, "at once"
    assert is_clean(cycles)


def test_stop_ends_it_without_beginning_anything(site: WatchSite) -> None:
    cycles = list(site.watch(9, {3: site.control.stop}))
    assert len(cycles) == 3
    site.control.stop_requested.set()
    site.hosts["edge1"].tasks.clear()
    site.hosts["edge2"].tasks.clear()
    (stopped,) = site.watch(9)
    assert (stopped.plan, stopped.results, stopped.next_in) == (None, None, None)
    assert site.hosts.placed == {}


def test_cycles_that_take_too_long_do_not_pile_up(site: WatchSite) -> None:
    list(site.watch(1))
    site.hands.cost = 7.0
    cycles = list(site.watch(6, apply=False))
    begun = [c.at for c in cycles]
    assert all(c.seconds > EVERY for c in cycles)
    for earlier, later in pairwise(begun):
        assert (later - earlier) / EVERY == pytest.approx(round((later - earlier) / EVERY), abs=0.1)


def test_changed_files_are_taken_over_and_broken_ones_said(site: WatchSite) -> None:
    new = dataclasses.replace(
        site.fleet, tasks=some_tasks(a_task("slam", cpu=1.0, robots=["robot1"])), transport=site.transport
    )
    mistake = InputError(
        [Problem(file="tasks.yaml", line=3, column=5, code="EC012", message="unknown field 'demnd'")]
    )
    answers: list[Fleet | InputError | None] = [None, mistake, mistake, new, None]

    def refresh() -> Fleet | None:
        answer = answers.pop(0) if answers else None
        if isinstance(answer, InputError):
            raise answer
        return answer

    cycles = list(site.watch(6, refresh=refresh))
    said = "tasks.yaml:3:5: unknown field 'demnd'; the files as read before stay in use"
    assert [c.warnings for c in cycles] == [(), (said,), (said,), (), (), ()]
    assert list_actions(cycles)[4] == [("navigation", Action.STOP)]
    assert site.hosts.placed.keys() == {"slam"}
    assert site.transport.connected["edge1"] == 2, "new files, new connections"


def test_another_fleet_is_not_taken_over(site: WatchSite) -> None:
    """Its tasks would be started a second time, under another owner."""
    other = dataclasses.replace(
        site.fleet,
        inventory=dataclasses.replace(site.fleet.inventory, fleet="hall"),
        transport=site.transport,
    )
    answers: list[Fleet | None] = [None, other, None]
    cycles = list(site.watch(3, refresh=lambda: answers.pop(0)))
    assert [bool(c.warnings) for c in cycles] == [False, True, False]
    assert cycles[1].warnings[0].startswith("the inventory names fleet hall now; fleet unnamed stays in use")


def test_an_error_belongs_to_its_cycle(site: WatchSite) -> None:
    list(site.watch(1))
    path = site.fleet.state / "memory.json"
    good = path.read_text()
    newer = good.replace('"format_version": 1', '"format_version": 99')
    assert newer != good
    cycles = list(site.watch(4, {1: lambda: path.write_text(newer), 3: lambda: path.write_text(good)}))
    assert ["newer edgectl" in c.error for c in cycles] == [False, True, True, False]
    assert cycles[3].plan is not None
    assert site.hosts.placed.keys() == {"slam", "navigation"}


def test_noise_does_not_move_what_a_lasting_load_would(site: WatchSite) -> None:
    list(site.watch(1))
    site.hands.seconds += 600.0
    busy = site.hosts[site.hosts.placed["slam"]]
    spikes = {
        number: (lambda n=number: setattr(busy, "used", 3.2 if n % 9 == 0 else 0.0))
        for number in range(1, 80)
    }
    assert list_actions(list(site.watch(80, spikes))) == {}


def test_the_journal_says_who_did_it(site: WatchSite) -> None:
    list(site.watch(2))
    log = read_entries(site.fleet.state / "journal.jsonl")
    assert [entry["verb"] for entry in log if entry["event"] == "begin"] == ["watch"]
    assert isinstance(load_manager_state(site.fleet.state), ManagerState)


def test_tasks_that_fence_themselves_hear_of_it_between_the_cycles(tmp_path: Path) -> None:
    site = WatchSite(tmp_path, tasks=some_tasks(a_task("slam", cpu=1.0, self_fence=0.2)))
    asked: list[str] = []

    def answer(request: dict[str, object]) -> dict[str, object]:
        asked.append(str(request["host"]))
        return {"tasks": {}}

    for name in ("edge1", "edge2"):
        site.hosts[name].faults["status"] = answer

    class Patiently(Control):
        def wait(self, seconds: float) -> ControlRequest | None:
            deadline = time.monotonic() + patience(20)
            while set(asked) != {"edge1", "edge2"} and time.monotonic() < deadline:
                time.sleep(0.01)
            site.hands.seconds += seconds
            return None

    assert is_clean(list(site.watch(2, control=Patiently())))
    assert set(asked) == {"edge1", "edge2"}


def test_a_bug_costs_a_cycle_and_says_that_it_is_one(site: WatchSite) -> None:
    answers: list[Policy] = [site.fleet.tasks.policy]

    def odd(_fleet: Fleet) -> Policy:
        if not answers:
            raise TypeError("not so")
        return answers[0] if site.hosts.placed else answers.pop()

    first, second, third = site.watch(3, {2: lambda: answers.append(site.fleet.tasks.policy)}, policy=odd)
    assert (first.error, third.error) == ("", "")
    assert "unexpected TypeError: not so (a bug" in second.error
    answers.clear()
    with pytest.raises(TypeError):
        list(site.watch(1, policy=odd, debug=True))


def test_usage_above_the_declaration_is_told_once_with_what_mends_it(tmp_path: Path) -> None:
    """The simulated tasks use 0.1 cores."""
    site = WatchSite(tmp_path, tasks=some_tasks(a_task("slam", cpu=0.01)))
    events = [event for c in site.watch(6) for event in c.events if event.kind is EventKind.TASK_OVERUSE]
    assert [(event.task, event.message) for event in events] == [
        ("slam", "uses 0.10 cores of cpu, declares 0.010 cores; edgectl profile slam --write")
    ]


def test_a_fleet_that_is_too_small_says_once_what_it_lacks(tmp_path: Path) -> None:
    site = WatchSite(tmp_path, tasks=some_tasks(a_task("slam", cpu=3.0), a_task("web", cpu=3.0)))
    for name in ("edge1", "edge2"):
        site.hosts[name].used = 2.0
    told = [warning for c in site.watch(4) for warning in c.warnings]
    assert told == ["the edges are short of 2.00 cores of cpu: the least that would help"]


@pytest.mark.parametrize("every", [7.0, 10.0, 60.0])
def test_a_copy_is_activated_within_a_second_of_the_moment_at_which_the_old_one_has_stopped(
    tmp_path: Path, every: float
) -> None:
    """30 s of self_fence, the grace, and 10 s for the clocks after the last contact, whatever the period."""
    rule: dict[str, Any] = {
        "on_unreachable": UnreachablePolicy.REPLACE,
        "self_fence": 30.0,
        "replace_after": 0.0,
    }
    task = a_task("slam", cpu=1.0, robots=["robot1"], standby=a_standby_rule(), **rule)
    site = WatchSite(tmp_path, tasks=some_tasks(task))
    activated: list[float] = []

    def note_activation(host: FakeHost) -> None:
        def answer(request: dict[str, object]) -> dict[str, object]:
            activated.append(site.hands.wall())
            return host._activate(request)

        host.faults["activate"] = answer

    for name in ("edge1", "edge2"):
        note_activation(site.hosts[name])

    def cut_off() -> None:
        site.hosts.down.add(load_manager_state(site.fleet.state).placements["slam"].host)

    list(site.watch(12, {2: cut_off}, every=every))
    old = next(iter(site.hosts.down))
    contact = load_state_with_heartbeats(site.fleet).contact[old]
    (moment,) = activated
    gone = 30.0 + task.stop.grace + FENCE_SLACK_S
    assert gone <= moment - contact <= gone + 1.0
