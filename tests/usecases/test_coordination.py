# SPDX-License-Identifier: Apache-2.0
"""Managers of one fleet that share a real etcd, over simulated hosts of which each may see only a part."""

import dataclasses
import math
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from edgectl.errors import CoordinationError, LockBusyError, StateError, WatchedError
from edgectl.model.inventory import Coordination
from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from edgectl.model.task import Task
from edgectl.state import failpoints
from edgectl.state.heartbeats import load_heartbeats, record_heartbeats, record_orphans
from edgectl.state.manager_state import load_manager_state
from edgectl.state.uptime import Uptime, read_uptime
from edgectl.transport import etcd_lease
from edgectl.transport.etcd_client import EtcdClient
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import ApplyOptions, ApplyResult, plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.pins import pin_task, unpin_tasks
from edgectl.usecases.plan import make_plan
from edgectl.usecases.watch import WatchOptions, watch_fleet
from tests.builders import a_task, an_edge, an_inventory, some_tasks
from tests.etcd import EtcdCluster, running_etcd
from tests.executor.fake_fleet import FakeFleet
from tests.pace import patience

TASKS = (a_task("t0"), a_task("t1"))
PATIENT = ApplyOptions(lock_timeout=patience(60.0))


class Site:
    """Hosts, and managers that share an etcd (None: that do not), each with a home and a view of its own."""

    def __init__(
        self, place: Coordination | None, folder: Path, names: tuple[str, ...] = ("edge1", "edge2")
    ) -> None:
        self.hosts, self.folder, self.said = FakeFleet.of(names), folder, list[str]()
        inventory = an_inventory(*map(an_edge, names))
        self.inventory = dataclasses.replace(inventory, coordination=place, fleet=folder.name)
        self.want: tuple[Task, ...] = TASKS

    def manager(self, name: str, *silent: str, tasks: tuple[Task, ...] | None = None) -> Fleet:
        """A manager for which the hosts ``silent`` do not answer; ``tasks``: None: those that the site wants."""
        state = self.folder / name
        state.mkdir(mode=0o700, exist_ok=True)
        view = FakeFleet(hosts=self.hosts.hosts, world=self.hosts.world, down=set(silent))
        return Fleet(
            inventory=self.inventory,
            tasks=some_tasks(*(self.want if tasks is None else tasks)),
            transport=view.transport,
            state=state,
            warn=self.said.append,
        )


@pytest.fixture
def site(etcd: EtcdCluster, tmp_path: Path) -> Site:
    return Site(etcd.place, tmp_path)


def apply(fleet: Fleet, options: ApplyOptions = PATIENT) -> ApplyResult:
    return plan_and_apply(fleet, Policy(), options=options)


def apply_on_both_sides(site: Site) -> None:
    """At the same moment each of two managers applies to the half that it sees."""
    failures = list[BaseException]()

    def act(fleet: Fleet) -> None:
        try:
            apply(fleet)
        except BaseException as error:
            failures.append(error)

    sides = [site.manager("ana", "edge2"), site.manager("ben", "edge1")]
    threads = [threading.Thread(target=act, args=(fleet,)) for fleet in sides]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []


def test_on_both_sides_of_a_split_each_task_is_started_once(site: Site) -> None:
    apply_on_both_sides(site)
    assert site.hosts.world.overlap == set()
    assert site.hosts.placed.keys() == {"t0", "t1"}
    # The side that came second holds what the first one has placed.
    places = set(site.hosts.placed.values())
    assert len(places) == 1
    blind = site.manager("ben", *places)
    assert {step.action for step in apply(blind).plan.steps} == {Action.HOLD}


def test_without_etcd_a_split_doubles_them(tmp_path: Path) -> None:
    """The hole that is closed, so that the test above can fail."""
    site = Site(None, tmp_path)
    apply_on_both_sides(site)
    assert site.hosts.world.overlap == {"t0", "t1"}


def test_another_machine_takes_over_with_an_empty_home(site: Site) -> None:
    ana = site.manager("ana")
    apply(ana)
    where = site.hosts.placed
    operator_marks.mark_tasks_done(ana, ["t1"])
    operator_marks.cordon_hosts(ana, ["edge2"])
    operator_marks.fence_hosts(ana, ["edge2"])
    ben = site.manager("ben", "edge1", "edge2")
    plan = make_plan(ben, Policy())  # reading brings the state, too
    assert {step.task: step.action for step in plan.steps}["t0"] is Action.HOLD
    known = load_manager_state(ben.state)
    assert {task: place.host for task, place in known.placements.items()} == where
    assert (set(known.done), known.cordons) == ({"t1"}, frozenset({"edge2"}))
    assert load_heartbeats(ben.state).fenced == {"edge2"}
    apply(site.manager("ben"))
    assert site.hosts.placed == {"t0": where["t0"]}  # done is done
    assert site.hosts.world.overlap == set()
    operator_marks.uncordon_hosts(site.manager("ben"), ["edge2"])
    apply(ana)
    assert load_manager_state(ana.state).cordons == frozenset()


def test_a_pin_of_one_manager_holds_for_the_other(site: Site) -> None:
    """ben, whose own files are empty, unpins it; ana's plan knows, although her own file still has it."""
    ana = site.manager("ana")
    apply(ana)
    there = "edge2" if site.hosts.placed["t1"] == "edge1" else "edge1"
    pin_task(ana, Policy(), "t1", there)
    assert unpin_tasks(site.manager("ben"), ["t1"]) == {"t1": True}
    assert list(load_manager_state(ana.state).pins) == ["t1"]
    pin_task(site.manager("ben"), Policy(), "t1", there)
    apply(ana)
    assert site.hosts.placed["t1"] == there
    unpin_tasks(site.manager("ben"), ["t1"])
    apply(ana)
    assert load_manager_state(ana.state).pins == {}


def test_silence_counts_from_the_take_over(site: Site) -> None:
    """Another machine may have been in touch with a host a moment ago: replacing waits for the whole fence."""
    apply(site.manager("ana"))
    old = Uptime(boot=read_uptime().boot, seconds=read_uptime().seconds - 1000.0)
    ben = site.manager("ben", "edge1", "edge2")
    record_heartbeats(ben.state, {"edge1": old})
    record_orphans(ben.state, {"edge1": ("t0",)})
    began = read_uptime().seconds
    make_plan(ben, Policy())
    known = load_heartbeats(ben.state)
    assert known.last["edge1"].seconds >= began
    assert known.orphans == {"edge1": ("t0",)}  # ana may not have seen it


@pytest.fixture
def short_lease(monkeypatch: pytest.MonkeyPatch) -> float:
    """The shortest lease in which an apply ends here, in seconds; etcd grants whole ones."""
    seconds = math.ceil(patience(1.0))
    monkeypatch.setattr(etcd_lease, "ETCD_LEASE_S", seconds)
    return float(seconds)


def kill_at(point: str, count: int) -> None:
    """Kill this process with SIGKILL the ``count``-th time that it comes to the point."""
    seen = list[str]()

    def die(reached: str) -> None:
        seen.append(reached)
        if seen.count(point) == count:
            os.kill(os.getpid(), signal.SIGKILL)

    failpoints.install_hook(die)


def test_what_a_killed_manager_was_about_to_start_is_held_where_it_may_run(
    site: Site, short_lease: float
) -> None:
    """ana is killed with SIGKILL between its announcement and its result; ben does not reach edge1."""
    pid = os.fork()
    if pid == 0:
        with suppress(BaseException):
            kill_at("state saved in etcd", 2)
            apply(site.manager("ana", "edge2"))
        os._exit(0)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status)
    ben = site.manager("ben", "edge1")
    began = time.monotonic()
    with pytest.raises(LockBusyError, match=r"\(apply, free in .* unless renewed\) holds this fleet in etcd"):
        apply(ben, ApplyOptions())
    held = apply(ben)
    assert time.monotonic() - began < patience(short_lease + 5.0)
    assert {step.action for step in held.plan.steps} == {Action.HOLD}
    assert site.hosts.placed == {}
    apply(site.manager("ben"))  # edge1 answers, and runs nothing: the child had hosts of its own memory
    assert site.hosts.placed.keys() == {"t0", "t1"}


def test_the_next_run_of_the_same_machine_replaces_a_killed_one_at_once(site: Site) -> None:
    pid = os.fork()
    if pid == 0:
        with suppress(BaseException):
            kill_at("fleet taken in etcd", 1)
            apply(site.manager("ana"))
        os._exit(0)
    assert os.WIFSIGNALED(os.waitpid(pid, 0)[1])
    assert apply(site.manager("ana"), ApplyOptions(lock_timeout=0.0)).results is not None


def test_a_second_watch_is_told_of_the_first_one(site: Site, etcd: EtcdCluster) -> None:
    first = etcd_lease.Holder(manager="m", session="s", who="eva@lab", verb="watch", every_s=10.0)
    lease = etcd_lease.take_fleet(EtcdClient(etcd.place), site.inventory.fleet, first, clock=time.monotonic)
    assert isinstance(lease, etcd_lease.EtcdLease)
    with lease.keep_alive():
        with pytest.raises(WatchedError, match=r"eva@lab watches this fleet every 10s"):
            list(watch_fleet(site.manager("ana"), WatchOptions(apply=True, cycles=1)))
        later = WatchOptions(apply=True, cycles=1, take_over=True)
        (cycle,) = watch_fleet(site.manager("ana"), later)
        assert "holds this fleet in etcd" in cycle.busy  # until that cycle has ended
    (cycle,) = watch_fleet(site.manager("ana"), later)
    assert cycle.results is not None


def test_without_etcd_nothing_is_changed_and_reading_goes_on(tmp_path: Path) -> None:
    with running_etcd(tmp_path) as cluster:
        site = Site(cluster.place, tmp_path)
        ana = site.manager("ana")
        apply(ana)
    done = list(site.hosts.world.events)
    for change in (
        lambda: apply(site.manager("ana", tasks=())),
        lambda: operator_marks.cordon_hosts(ana, ["edge1"]),
        lambda: operator_marks.fence_hosts(ana, ["edge1"]),
    ):
        with pytest.raises(
            CoordinationError, match=r"etcd does not answer .127.0.0.1:.*: connection refused"
        ):
            change()
    assert site.hosts.world.events == done
    assert load_manager_state(ana.state).cordons == frozenset()
    assert {step.action for step in make_plan(ana, Policy()).steps} == {Action.KEEP}
    assert site.said[-1].endswith("places and marks are those that this machine saw last")
    cycle = next(iter(watch_fleet(ana, WatchOptions(apply=True, cycles=1))))
    assert (cycle.error, cycle.snapshot is not None) == ("", True)  # nothing to do: it samples


def test_a_minority_of_etcd_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edgectl.transport.etcd_client.CALL_TIMEOUT_S", 1.0)
    with running_etcd(tmp_path, 3) as cluster:
        site = Site(cluster.place, tmp_path)
        apply(site.manager("ana", tasks=TASKS[:1]))
        cluster.servers[1].kill()
        apply(site.manager("ben"))  # two of three go on
        done = list(site.hosts.world.events)
        cluster.servers[0].kill()
        with pytest.raises(CoordinationError, match="etcd does not answer"):
            apply(site.manager("ana", tasks=()))
    assert site.hosts.world.events == done


def test_etcd_that_dies_under_an_apply_doubles_nothing(tmp_path: Path, short_lease: float) -> None:
    """Within its lease the apply goes on; what it did is saved here, and announced there."""
    with running_etcd(tmp_path) as cluster:
        site = Site(cluster.place, tmp_path)
        ana = site.manager("ana", "edge2")
        start = site.hosts["edge1"]._start

        def kill_and_start(request: dict[str, object]) -> dict[str, object]:
            cluster.servers[0].kill()
            return start(request)

        site.hosts["edge1"].faults["start:t0"] = kill_and_start
        result = apply(ana, dataclasses.replace(PATIENT, max_parallel=1))
        assert site.hosts.placed.get("t0") == "edge1"
        assert result.results is not None
        assert "what this run changed is saved on this machine only; apply again" in " ".join(site.said)
        with pytest.raises(CoordinationError):
            apply(ana)
        cluster.start()
        cluster.wait_until_healthy()
        held = apply(site.manager("ben", "edge1"))
        assert {step.action for step in held.plan.steps} == {Action.HOLD}
        apply(ana)  # its own files are newer than what etcd has
    assert site.hosts.world.overlap == set()
    assert set(site.hosts.placed.values()) == {"edge1"}


def test_a_frozen_manager_sends_nothing_after_its_lease(site: Site, short_lease: float) -> None:
    """Its clock jumps over the lease before its first start, as after SIGSTOP; the other one acts meanwhile."""
    lead = [0.0]

    def uptime() -> Uptime:
        now = read_uptime()
        return Uptime(boot=now.boot, seconds=now.seconds + lead[0])

    ana = dataclasses.replace(site.manager("ana", "edge2"), uptime=uptime)
    ben = site.manager("ben", "edge1")

    def freeze(point: str) -> None:
        if point == "begin fsynced" and not lead[0]:
            lead[0] = 60.0
            assert {step.action for step in apply(ben).plan.steps} == {Action.HOLD}

    remove = failpoints.install_hook(freeze)
    try:
        result = apply(ana)
    finally:
        remove()
    assert lead[0]
    assert result.results is not None
    assert not result.results.done
    assert {each.error for each in result.results.actions} == {
        "the lease of the fleet in etcd has run out: nothing was sent"
    }
    assert site.hosts.placed == {}


def test_a_damaged_state_in_etcd_is_refused_and_nothing_is_changed(
    site: Site, etcd: EtcdCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    apply(site.manager("ana", tasks=TASKS[:1]))
    with monkeypatch.context() as patch:
        patch.setattr("edgectl.state.shared_state._MAX_DOCUMENT_BYTES", 100)  # a small state unpacks to more
        with pytest.raises(StateError, match="state of this fleet in etcd cannot be read"):
            apply(site.manager("ben"))
    for junk in (b"", b"x\x9cjunk", bytes(1000)):
        lease = etcd_lease.take_fleet(
            EtcdClient(etcd.place),
            site.inventory.fleet,
            etcd_lease.Holder(manager="m", session="s", who="w", verb="v"),
            clock=time.monotonic,
        )
        assert isinstance(lease, etcd_lease.EtcdLease)
        with lease.keep_alive():
            lease.save_state(junk)
        with pytest.raises(StateError, match="state of this fleet in etcd cannot be read"):
            apply(site.manager("ben"))
    assert site.hosts.placed.keys() == {"t0"}


def test_an_apply_that_changes_nothing_leaves_the_state_in_etcd_as_it_is(
    site: Site, etcd: EtcdCluster
) -> None:
    ana = site.manager("ana")
    apply(ana)
    client = EtcdClient(etcd.place)
    before = etcd_lease.read_fleet_keys(client, site.inventory.fleet)
    apply(ana)
    apply(site.manager("ben"))
    after = etcd_lease.read_fleet_keys(client, site.inventory.fleet)
    assert (after.state_revision, after.holder) == (before.state_revision, None)


def test_pins_that_two_managers_set_at_once_are_all_kept_or_refused(site: Site) -> None:
    """Each with a home of its own, one after the other through etcd: none overwrites what the other has written."""
    apply(site.manager("ana"))
    there = {task: "edge2" if host == "edge1" else "edge1" for task, host in site.hosts.placed.items()}
    refused: dict[str, BaseException] = {}

    def act(name: str, task: str) -> None:
        end = time.monotonic() + patience(30)
        while time.monotonic() < end:
            try:
                pin_task(site.manager(name), Policy(), task, there[task], duration=3600.0)
            except LockBusyError as error:
                refused[task] = error
                time.sleep(0.02)
            else:
                refused.pop(task, None)
                return

    threads = [threading.Thread(target=act, args=given) for given in (("ben", "t1"), ("ana", "t0"))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert refused == {}
    for name in ("ben", "ana", "eve"):
        plan = make_plan(site.manager(name), Policy())
        pins = {step.task: step.decision.pin for step in plan.steps}
        assert {task: pin.host for task, pin in pins.items() if pin is not None} == there, name
    apply(site.manager("eve"))
    assert site.hosts.placed == there
    assert unpin_tasks(site.manager("ana"), ["t1"]) == {"t1": True}
    assert unpin_tasks(site.manager("ben"), ["t1", "t0"]) == {"t1": False, "t0": True}


def test_a_pin_is_refused_while_etcd_does_not_answer(tmp_path: Path) -> None:
    """Neither a mark that only this machine knows, nor one that is lost without a word."""
    with running_etcd(tmp_path) as etcd:
        site = Site(etcd.place, tmp_path)
        ana = site.manager("ana")
        apply(ana)
        there = "edge2" if site.hosts.placed["t0"] == "edge1" else "edge1"
        pin_task(ana, Policy(), "t1", site.hosts.placed["t1"])
    with pytest.raises((CoordinationError, LockBusyError)):
        pin_task(ana, Policy(), "t0", there)
    with pytest.raises((CoordinationError, LockBusyError)):
        unpin_tasks(ana, ["t1"])
    assert list(load_manager_state(ana.state).pins) == ["t1"]
