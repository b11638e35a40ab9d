# SPDX-License-Identifier: Apache-2.0
"""A manager dies in a move; then its hosts fall silent, lose power and come back in every order: no task starts again
while one of its instances may still run.

At one point of each name in one order; with ``--whole`` at each point in nine orders, in ``make faults``.
"""

import dataclasses
import itertools
import random
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from edgectl.errors import ConnectError
from edgectl.model.inventory import Coordination
from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from edgectl.model.task import HandoffContract, HandoffOrder, Task
from edgectl.state import failpoints
from edgectl.state.journal_reader import read_journal
from edgectl.usecases.apply import ApplyResult, plan_and_apply
from tests.builders import a_standby_rule, a_task
from tests.etcd import EtcdCluster
from tests.executor.fake_fleet import Request
from tests.usecases.test_coordination import PATIENT, Site
from tests.usecases.test_recovery import choose_failpoints
from tests.usecases.test_take_over import die_at, pinned

POLICY = Policy(min_dwell=0.0)
OPTIONS = dataclasses.replace(PATIENT, max_parallel=1)
OLD, NEW = "edge3", "edge2"
STOP_FIRST = a_task("t0")
START_FIRST = dataclasses.replace(STOP_FIRST, handoff=HandoffContract(order=HandoffOrder.START_FIRST))
WARM = dataclasses.replace(STOP_FIRST, standby=a_standby_rule())
TASKS = {"stop-first": STOP_FIRST, "start-first": START_FIRST, "warm": WARM}
SILENCES = ((OLD, NEW), (OLD,), (NEW,))
"""The hosts that do not answer an apply."""
Fate = tuple[str, tuple[tuple[str, ...], ...]]
"""The host that loses its power (empty: none), then who is silent, apply by apply."""
FATES: tuple[Fate, ...] = tuple(itertools.product(("", OLD, NEW), itertools.product(SILENCES, repeat=3)))


def open_site(folder: Path, task: Task, place: Coordination | None = None) -> Site:
    """Three hosts, on the first of which ana has started the task; it is about to move to the second."""
    folder.mkdir()
    site = Site(place, folder, (OLD, NEW, "edge1"))
    apply_as(site, "ana", pinned(task, OLD))
    assert site.hosts.world.alive == {"t0": {OLD}}
    return site


def copy_site(site: Site, folder: Path) -> Site:
    shutil.copytree(site.folder, folder)
    copy = Site(None, folder, tuple(site.hosts.hosts))
    copy.inventory, copy.hosts = site.inventory, site.hosts.copy()
    return copy


def apply_as(site: Site, name: str, task: Task, *silent: str) -> ApplyResult:
    return plan_and_apply(site.manager(name, *silent, tasks=(task,)), POLICY, options=OPTIONS)


def list_points(site: Site, task: Task) -> list[str]:
    seen = list[str]()
    remove = failpoints.install_hook(seen.append)
    try:
        apply_as(site, "ana", pinned(task, NEW))
    finally:
        remove()
    assert site.hosts.world.alive == {"t0": {NEW}}
    return seen


def cut_power(site: Site, name: str) -> None:
    """Everything that ran there is gone."""
    for task in list(site.hosts[name].tasks):
        del site.hosts[name].tasks[task]
        site.hosts.world.ends(task, name)


def play_fate(site: Site, name: str, task: Task, fate: Fate, what: object) -> None:
    """Go on as ``name``; in the end all hosts answer."""
    without_power, silences = fate
    if without_power:
        cut_power(site, without_power)
    alive = {*site.hosts.world.alive["t0"]}
    for number, silent in enumerate(silences):
        apply_as(site, name, task, *silent)
        now = {*site.hosts.world.alive["t0"]}
        assert len(now) <= 1 or now <= alive, (what, fate, number, alive, now)
        alive = now
    apply_as(site, name, task)
    assert len(site.hosts.world.alive["t0"]) == 1, (what, fate)
    assert read_journal(site.folder / name / "journal.jsonl").doubtful == {}, (what, fate)


def draw_fates(whole: bool, what: object) -> list[Fate]:
    return random.Random(str(what)).sample(FATES, 9 if whole else 1)


@pytest.mark.parametrize("order", TASKS)
def test_nothing_starts_twice_whichever_hosts_are_silent(order: str, whole: bool, tmp_path: Path) -> None:
    task = TASKS[order]
    prepared = open_site(tmp_path / "prepared", task)
    names = list_points(copy_site(prepared, tmp_path / "whole"), task)
    assert len(set(names)) > 15
    for number in choose_failpoints(names, order, whole=whole):
        dead = copy_site(prepared, tmp_path / f"{number}")
        die_as_ana(dead, task, names, number)
        what = (order, number, names[number])
        for turn, fate in enumerate(draw_fates(whole, what)):
            play_fate(copy_site(dead, tmp_path / f"{number}-{turn}"), "ana", task, fate, what)


def die_as_ana(site: Site, task: Task, names: list[str], number: int) -> None:
    act: Callable[[], object] = partial(apply_as, site, "ana", pinned(task, NEW))
    die_at(names[number], names[: number + 1].count(names[number]), act)


@pytest.mark.parametrize("name", ["ana", "ben"])
@pytest.mark.parametrize("order", TASKS)
def test_nothing_starts_twice_on_the_same_machine_or_another(
    order: str, name: str, etcd: EtcdCluster, whole: bool, tmp_path: Path
) -> None:
    """All of them share an etcd."""
    task = TASKS[order]
    names = list_points(open_site(tmp_path / f"whole-{order}-{name}", task, etcd.place), task)
    wanted = choose_failpoints(names, order + name, whole=whole)
    for number in wanted if whole else random.Random(order + name).sample(wanted, 3):
        what = (order, name, number, names[number])
        for turn, fate in enumerate(draw_fates(whole, what)[:2]):
            site = open_site(tmp_path / f"{order}-{name}-{number}-{turn}", task, etcd.place)
            die_as_ana(site, task, names, number)
            play_fate(site, name, task, fate, what)


def test_a_start_that_could_not_be_taken_back_is_not_forgotten(tmp_path: Path) -> None:
    """The new host gets the start, and then its line is cut: the old instance runs on, until its host is rebooted."""
    site = open_site(tmp_path / "site", START_FIRST)
    host = site.hosts[NEW]

    def start_unheard(request: Request) -> Request:
        host.faults = {}
        host(request)
        host.faults = {"start": ConnectError("cut"), "stop": ConnectError("cut")}
        raise ConnectError("cut")

    host.faults = {"start": start_unheard}
    applied = apply_as(site, "ana", pinned(START_FIRST, NEW))
    assert applied.results is not None
    assert not applied.results.done
    assert site.hosts.world.alive == {"t0": {OLD, NEW}}
    host.faults = {}
    cut_power(site, OLD)
    (step,) = apply_as(site, "ana", START_FIRST, NEW).plan.steps
    assert step.action is Action.HOLD
    (step,) = apply_as(site, "ana", START_FIRST).plan.steps
    assert step.action is Action.KEEP
    assert site.hosts.world.alive == {"t0": {NEW}}


@pytest.mark.parametrize("order", ["start-first", "warm"])
def test_a_task_that_was_to_move_between_two_silent_hosts_is_held(order: str, tmp_path: Path) -> None:
    """The new host comes back first, without the task; the old one, on which it runs, does not answer."""
    task = TASKS[order]
    site = open_site(tmp_path / "site", task)
    die_as_ana(site, task, ["start sent" if order == "start-first" else "deactivate held"], 0)
    assert site.hosts.world.alive == {"t0": {OLD}}

    def act(*silent: str) -> dict[str, Action]:
        applied = apply_as(site, "ana", task, *silent)
        return {step.task: step.action for step in applied.plan.steps}

    assert act(OLD, NEW) == {"t0": Action.HOLD}
    assert act(OLD) == {"t0": Action.HOLD}
    assert site.hosts.world.alive == {"t0": {OLD}}
    assert act(NEW) == {"t0": Action.KEEP}, "the other one has answered, and it is not there"
    assert act() == {"t0": Action.KEEP}
