# SPDX-License-Identifier: Apache-2.0
"""A manager dies in the middle of a change; another machine, with files of its own, goes on through a real etcd."""

import dataclasses
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from edgectl.errors import StalePlanError, UsageError
from edgectl.model.assignment import DemandSource
from edgectl.model.check import Check
from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from edgectl.model.resource import CPU, Usage
from edgectl.model.revision import RevisionOutcome
from edgectl.model.task import Task
from edgectl.state import failpoints
from edgectl.state.journal_reader import read_journal
from edgectl.state.lock import describe_manager
from edgectl.state.open_work import OpenWork, SharedRevision, collect_open_work, take_over_work
from edgectl.state.revisions import collect_shared_revisions, load_revisions
from edgectl.state.shared_state import load_local_copy, save_local_copy
from edgectl.state.store import Store
from edgectl.transport.etcd_client import EtcdClient
from edgectl.transport.etcd_lease import read_fleet_keys
from edgectl.usecases.apply import ApplyResult, apply_saved_plan, plan_and_apply
from edgectl.usecases.history import list_shared_revisions, roll_back_fleet
from edgectl.usecases.plan import make_plan
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.watch import WatchOptions, watch_fleet
from tests.builders import NOW, a_robot, a_run, a_snapshot, a_task
from tests.etcd import EtcdCluster
from tests.usecases.test_coordination import PATIENT, Site
from tests.usecases.test_recovery import HOOKS, ManagerKilledError, choose_failpoints

POLICY = Policy(min_dwell=0.0)
ONE_BY_ONE = dataclasses.replace(PATIENT, max_parallel=1)


@pytest.fixture
def three_hosts(etcd: EtcdCluster, tmp_path: Path) -> Site:
    return Site(etcd.place, tmp_path, ("edge3", "edge2", "edge1"))


def die_at(point: str, count: int, act: Callable[[], object]) -> None:
    """Do ``act`` until it has come to the point ``count`` times; nothing is sent or saved any more then."""
    seen = list[str]()

    def die(reached: str) -> None:
        seen.append(reached)
        if seen.count(point) == count:
            raise ManagerKilledError

    remove = failpoints.install_hook(die)
    try:
        with pytest.raises(ManagerKilledError):
            act()
    finally:
        remove()


def pinned(task: Task, host: str) -> Task:
    return dataclasses.replace(task, hosts=dataclasses.replace(task.hosts, only=(host,)))


@pytest.mark.parametrize("sent", [False, True], ids=["announced", "started"])
def test_what_was_to_move_between_two_silent_hosts_starts_nowhere_else(three_hosts: Site, sent: bool) -> None:
    """Nobody knows whether the old instance was stopped: it counts as there until its host has answered."""
    site, task = three_hosts, a_task("t0")
    plan_and_apply(site.manager("ana", tasks=(pinned(task, "edge3"),)), POLICY, options=PATIENT)
    moving = site.manager("ana", tasks=(pinned(task, "edge2"),))
    point, count = ("start acknowledged", 1) if sent else ("state saved in etcd", 1)
    die_at(point, count, lambda: plan_and_apply(moving, POLICY, options=PATIENT))
    where = site.hosts.placed["t0"]
    assert where == ("edge2" if sent else "edge3")

    def act_as_ben(*silent: str) -> dict[str, Action]:
        applied = plan_and_apply(site.manager("ben", *silent, tasks=(task,)), POLICY, options=PATIENT)
        assert site.hosts.world.overlap == set()
        return {step.task: step.action for step in applied.plan.steps}

    assert act_as_ben("edge3", "edge2") == {"t0": Action.HOLD}
    other = "edge3" if sent else "edge2"
    assert act_as_ben(where) == {"t0": Action.HOLD}, f"{other} has answered, and it is not there"
    assert act_as_ben(other) == {"t0": Action.KEEP}
    assert site.hosts.placed == {"t0": where}
    assert act_as_ben() == {"t0": Action.KEEP}


HOOKED = a_task("slam", robots=["robot1"], handoff=HOOKS, ready=Check(command="ready"))
NEXT = a_task("navigation", needs=["slam"])


def open_robot_site(etcd: EtcdCluster, tmp_path: Path, number: int = 0) -> Site:
    """Two hosts and a robot, on which ana has started two tasks, and is about to move the one with hooks."""
    folder = tmp_path / f"{tmp_path.name}-{number}"
    folder.mkdir()
    site = Site(etcd.place, folder, ("edge2", "edge1", "robot1"))
    hosts = {**site.inventory.hosts, "robot1": a_robot("robot1")}
    site.inventory = dataclasses.replace(site.inventory, hosts=hosts)
    site.want = (pinned(HOOKED, "edge2"), NEXT)
    apply_as(site, "ana")
    site.want = (pinned(HOOKED, "edge1"), NEXT)
    return site


def apply_as(site: Site, name: str, *silent: str) -> ApplyResult:
    return plan_and_apply(site.manager(name, *silent), POLICY, options=ONE_BY_ONE)


def count_hooks(site: Site) -> tuple[int, int]:
    events = site.hosts.world.events
    return events.count("check hold robot1"), events.count("check release robot1")


def list_points(etcd: EtcdCluster, tmp_path: Path) -> list[str]:
    site, seen = open_robot_site(etcd, tmp_path, -1), list[str]()
    remove = failpoints.install_hook(seen.append)
    try:
        apply_as(site, "ana")
    finally:
        remove()
    assert count_hooks(site) == (1, 1)
    return seen


def test_another_machine_ends_what_a_death_at_any_point_has_left(
    etcd: EtcdCluster, whole: bool, tmp_path: Path
) -> None:
    """Its files are empty: what it knows of a robot on hold, a plan and a revision comes from etcd. When the first
    machine is back, nothing is done twice.
    """
    names = list_points(etcd, tmp_path)
    assert {"state saved in etcd", "intent fsynced", "check sent", "stop acknowledged"} <= {*names}
    for number in choose_failpoints(names, "take over", whole=whole):
        what = f"{number}: {names[number]}"
        site = open_robot_site(etcd, tmp_path, number)
        point = names[number]
        die_at(point, names[: number + 1].count(point), partial(apply_as, site, "ana"))
        ended = apply_as(site, "ben")
        assert ended.results is None or ended.results.done, what
        assert site.hosts.placed == {"slam": "edge1", "navigation": site.hosts.placed["navigation"]}, what
        held, released = count_hooks(site)
        hooks = [event for event in site.hosts.world.events if event.startswith("check")]
        assert released <= held + 1, what
        assert hooks[-1:] in ([], ["check release robot1"]), what
        log = read_journal(site.folder / "ben" / "journal.jsonl")
        assert (log.unfinished, log.held, log.broken) == ((), (), 0), what
        apply_as(site, "ana")
        assert count_hooks(site) == (held, released), what
        assert collect_open_work(site.folder / "ana") == collect_open_work(site.folder / "ben"), what
        assert site.hosts.world.overlap == set(), what


def test_the_next_machine_says_what_was_interrupted_and_goes_on_counting(
    etcd: EtcdCluster, tmp_path: Path
) -> None:
    site = open_robot_site(etcd, tmp_path)
    die_at("stop acknowledged", 1, lambda: apply_as(site, "ana"))
    ended = apply_as(site, "ben")
    assert ended.results is not None
    assert ended.results.revision == 3
    assert any("revision 2 was interrupted while it changed slam" in text for text in site.said)
    assert [each.number for each in load_revisions(site.folder / "ben")] == [1, 3]


def move_as(site: Site, name: str, host: str) -> None:
    plan_and_apply(site.manager(name, tasks=(pinned(a_task("t0"), host),)), POLICY, options=PATIENT)


def roll_back_as(site: Site, name: str) -> None:
    roll_back_fleet(site.manager(name, tasks=(a_task("t0"),)), POLICY, None, options=PATIENT)


def test_any_machine_lists_the_revisions_of_all_and_goes_back_to_the_one_before(three_hosts: Site) -> None:
    """ben has changed the fleet, too, so that his own newest revision is not that of the fleet."""
    site = three_hosts
    for name, host in (("ana", "edge3"), ("ben", "edge2"), ("ana", "edge1"), ("ana", "edge3")):
        move_as(site, name, host)
    seen = list_shared_revisions(site.manager("ben"))
    assert [each.number for each in seen] == [1, 2, 3, 4]
    assert [each.placements for each in seen] == [
        {"t0": host} for host in ("edge3", "edge2", "edge1", "edge3")
    ]
    assert [bool(each.actions) for each in seen] == [False, True, False, False]
    assert seen[3].user == describe_manager()
    assert {each.ending for each in seen} == {RevisionOutcome.DONE}
    roll_back_as(site, "ben")
    assert site.hosts.placed == {"t0": "edge1"}
    assert [each.verb for each in list_shared_revisions(site.manager("dan"))] == [*["apply"] * 4, "rollback"]
    assert [each.verb for each in list_shared_revisions(site.manager("ana"))] == [*["apply"] * 4, "rollback"]


def test_the_revision_in_which_a_machine_died_is_the_last_one(three_hosts: Site) -> None:
    site = three_hosts
    move_as(site, "ana", "edge3")
    move_as(site, "ana", "edge2")
    die_at("stop acknowledged", 1, lambda: move_as(site, "ana", "edge1"))
    roll_back_as(site, "ben")
    assert site.hosts.placed == {"t0": "edge2"}
    with pytest.raises(UsageError, match="revision 3, the one before the last, was made on another machine"):
        roll_back_as(site, "cem")


def test_what_is_shared_of_revisions_is_bounded(tmp_path: Path) -> None:
    tasks = {f"t{number}": "edge1" for number in range(1000)}
    known = [SharedRevision(number=number, began_at=NOW, placements=tasks) for number in range(1, 30)]
    kept = collect_shared_revisions(tmp_path, known, "lab-pc")
    assert [each.number for each in kept] == [*range(14, 30)]
    assert [each.number for each in kept if each.placements is not None] == [26, 27, 28, 29]


def test_a_robot_of_a_lost_machine_holds_until_the_next_one_gets_a_task_ready(
    etcd: EtcdCluster, tmp_path: Path
) -> None:
    """ben gets none ready and shares that; cem releases the robot; ana, back at last, does not do so again."""
    site = open_robot_site(etcd, tmp_path)
    die_at("stop acknowledged", 1, lambda: apply_as(site, "ana"))
    assert count_hooks(site) == (1, 0)
    site.hosts["edge1"].faults["wait:slam"] = lambda _request: {"state": "failed", "exit_code": 3}
    apply_as(site, "ben")
    assert count_hooks(site) == (1, 0)
    assert any("robot1 STILL HOLDS" in text for text in site.said)
    site.hosts["edge1"].faults.clear()
    apply_as(site, "cem")
    assert count_hooks(site) == (1, 1)
    apply_as(site, "ana")
    apply_as(site, "ben")
    assert count_hooks(site) == (1, 1)


def test_a_hold_that_etcd_was_never_told_of_is_released_by_its_own_machine(
    etcd: EtcdCluster, tmp_path: Path
) -> None:
    """etcd was lost with the manager, and ben was the first to save something there again."""
    site = open_robot_site(etcd, tmp_path)
    die_at("stop acknowledged", 1, lambda: apply_as(site, "ana"))
    alone = site.folder / "ana"
    copy = load_local_copy(alone)
    save_local_copy(alone, dataclasses.replace(copy, journal=dataclasses.replace(copy.journal, held=())))
    take_over_work(alone, OpenWork(revision=7), load_local_copy(alone).journal, lambda: NOW)
    assert collect_open_work(alone) == OpenWork(revision=7, applied=copy.journal.applied, held=("slam",))


def test_a_saved_plan_is_applied_once_by_all_machines_together(etcd: EtcdCluster, tmp_path: Path) -> None:
    site = Site(etcd.place, tmp_path)
    plan = make_plan(site.manager("ana"), POLICY)
    apply_saved_plan(site.manager("ana"), plan, PATIENT)
    with pytest.raises(StalePlanError, match="it was applied before"):
        apply_saved_plan(site.manager("ben"), plan, PATIENT)


MEASURED = a_task("slam", cpu=None)


def record_use(site: Site, name: str, cores: float, *, samples: int = 80) -> None:
    """Samples of the task on a host like those of the site, from which this machine alone knows what it uses."""
    measured = probe_fleet(site.manager(name)).hosts["edge1"]
    run = a_run(spec_hash=MEASURED.spec_hash, started_at=NOW - 5000, used=Usage(cpu=cores, memory=1e6))
    with Store.open(site.folder / name) as store:
        for n in range(samples):
            seen = dataclasses.replace(measured, tasks={"slam": run})
            store.record_snapshot(a_snapshot({"edge1": seen}, taken_at=NOW - 10 * (samples - n)))


def open_measured_site(etcd: EtcdCluster, tmp_path: Path) -> Site:
    site = Site(etcd.place, tmp_path)
    site.want = (MEASURED,)
    record_use(site, "ana", 1.25)
    apply_as(site, "ana")
    return site


def find_demand(site: Site, name: str) -> tuple[float, DemandSource]:
    (step,) = make_plan(site.manager(name), POLICY).steps
    (found,) = (each for each in step.decision.demand if each.resource == CPU)
    return found.value, found.source


def read_revision(site: Site) -> int:
    place = site.inventory.coordination
    assert place is not None
    return read_fleet_keys(EtcdClient(place), site.inventory.fleet).state_revision


def test_what_one_machine_has_measured_counts_for_the_next(etcd: EtcdCluster, tmp_path: Path) -> None:
    site = open_measured_site(etcd, tmp_path)
    assert find_demand(site, "ben") == (1.25, DemandSource.MEASURED)
    record_use(site, "ben", 0.5, samples=30)  # not enough yet
    assert find_demand(site, "ben") == (1.25, DemandSource.MEASURED)
    record_use(site, "ben", 0.5, samples=80)
    assert find_demand(site, "ben") == (0.5, DemandSource.MEASURED)
    apply_as(site, "ben")
    assert find_demand(site, "dan") == (0.5, DemandSource.MEASURED)
    site.want = (dataclasses.replace(MEASURED, spec_hash="another"),)
    assert find_demand(site, "eve")[1] is DemandSource.NONE


def test_demands_are_saved_in_etcd_only_where_they_are_off_by_a_tenth(
    etcd: EtcdCluster, tmp_path: Path
) -> None:
    """A watch that has nothing else to do shares them, too."""
    site = open_measured_site(etcd, tmp_path)
    before = read_revision(site)
    for cores, written in ((1.35, False), (1.39, True)):
        record_use(site, "ana", cores, samples=1000)
        list(watch_fleet(site.manager("ana"), WatchOptions(apply=True, cycles=1)))
        assert (read_revision(site) > before) is written
    assert find_demand(site, "ben") == (1.39, DemandSource.MEASURED)
