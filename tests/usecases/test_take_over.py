# SPDX-License-Identifier: Apache-2.0
"""A manager dies in the middle of a change; another machine, with files of its own, goes on through a real etcd."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from edgectl.model.task import Task
from edgectl.state import failpoints
from edgectl.usecases.apply import plan_and_apply
from tests.builders import a_task
from tests.etcd import EtcdCluster
from tests.usecases.test_coordination import PATIENT, Site
from tests.usecases.test_recovery import ManagerKilledError

POLICY = Policy(min_dwell=0.0)


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
