# SPDX-License-Identifier: Apache-2.0
"""Faults of two managers that share a real etcd while the network is split: each of them sees one half of the hosts.

New tasks, which run nowhere, come in every round: without etcd they would be started on both sides.
"""

import signal

from tests.etcd import EtcdCluster, running_etcd
from tests.faults.faults_two_managers import check_nothing_doubled, finish, watch_twice
from tests.faults.fleet import APPLY, FaultFleet
from tests.faults.manager import Manager, signal_manager
from tests.faults.registry import fault

# Longer than the lease in etcd.
PATIENT = (*APPLY, "--lock-timeout", "60s")
PAST_THE_LEASE_S = 10.0
NEW_TASKS = 3


def open_etcd(fleet: FaultFleet) -> EtcdCluster:
    """A real etcd that the inventory names from now on."""
    directory = fleet.directory / "etcd"
    directory.mkdir()
    cluster = fleet.stack.enter_context(running_etcd(directory))
    fleet.coordination = cluster.address
    fleet.write_files()
    return cluster


def open_halves(fleet: FaultFleet) -> tuple[EtcdCluster, Manager, Manager]:
    """A real etcd, and two managers; the first one sees the first host only, the other one all others."""
    cluster = open_etcd(fleet)
    ana, ben = Manager(fleet=fleet, name="ana"), Manager(fleet=fleet, name="ben")
    ana.hide(*fleet.edges[1:])
    ben.hide(fleet.first)
    return cluster, ana, ben


def add_new_tasks(fleet: FaultFleet, ana: Manager, ben: Manager) -> None:
    """More tasks, each of which either manager wants on its own side."""
    for _ in range(NEW_TASKS):
        fleet.add_task(f"t{len(fleet.tasks)}")
    ana.want(dict.fromkeys(fleet.tasks, fleet.first))
    ben.want({task: fleet.random.choice(fleet.edges[1:]) for task in fleet.tasks})
    fleet.injected += 1


@fault(
    "two managers with etcd: the network is split, both act at once", kinds=("loopback",), quick=True, full=4
)
def split_with_etcd(fleet: FaultFleet) -> None:
    _, ana, ben = open_halves(fleet)
    for _ in range(1 if fleet.sample else 4):
        add_new_tasks(fleet, ana, ben)
        first, second = fleet.random.sample([ana, ben], 2)
        finish(fleet, first.start(*PATIENT), second.start(*PATIENT), codes=(4,))
        check_nothing_doubled(fleet)


@fault(
    "two managers with etcd: one freezes past its lease, the other side acts, it thaws",
    kinds=("loopback",),
    full=3,
)
def freeze_with_etcd(fleet: FaultFleet) -> None:
    _, ana, ben = open_halves(fleet)
    for _ in range(2):
        add_new_tasks(fleet, ana, ben)
        first, second = fleet.random.sample([ana, ben], 2)
        frozen = first.start(*PATIENT)
        fleet.wait(fleet.random.uniform(0.6, 2.5))
        signal_manager(frozen, signal.SIGSTOP)
        fleet.wait(PAST_THE_LEASE_S)
        finish(fleet, second.start(*PATIENT), codes=(4,))
        signal_manager(frozen, signal.SIGCONT)
        thawed = fleet.wait_for_edgectl(frozen).expect_exit(4, 75)
        if thawed.code == 75:
            thawed.expect_output("lease of the fleet in etcd has run out")
        check_nothing_doubled(fleet)


@fault(
    "two managers with etcd: one is killed in an apply, the other side waits for the lease",
    kinds=("loopback",),
    full=3,
)
def kill_with_etcd(fleet: FaultFleet) -> None:
    _, ana, ben = open_halves(fleet)
    for _ in range(2):
        add_new_tasks(fleet, ana, ben)
        first, second = fleet.random.sample([ana, ben], 2)
        killed = first.start(*PATIENT)
        fleet.wait(fleet.random.uniform(0.6, 2.5))
        signal_manager(killed, signal.SIGKILL)
        killed.communicate()
        finish(fleet, second.start(*PATIENT), codes=(4,))
        check_nothing_doubled(fleet)


@fault("two managers with etcd: it dies in an apply and returns", kinds=("loopback",), full=3)
def lose_etcd(fleet: FaultFleet) -> None:
    """Meanwhile nothing is changed, and reading goes on."""
    cluster, ana, ben = open_halves(fleet)
    for _ in range(2):
        add_new_tasks(fleet, ana, ben)
        running = ana.start(*PATIENT)
        fleet.wait(fleet.random.uniform(0.6, 2.5))
        cluster.servers[0].kill()
        code = fleet.wait_for_edgectl(running).expect_exit(4, 75).code
        ben.run(*APPLY).expect_exit(75).expect_output("etcd does not answer")
        ben.run("plan").expect_exit(0, 4).expect_output("that this machine saw last")
        cluster.start()
        cluster.wait_until_healthy()
        ben.run(*PATIENT).expect_exit(4)
        if code == 75:
            ana.run(*PATIENT).expect_exit(4)
        check_nothing_doubled(fleet)


@fault(
    "two managers with etcd: two watches, and a person's command between",
    kinds=("loopback",),
    full=2,
)
def watch_twice_with_etcd(fleet: FaultFleet) -> None:
    open_etcd(fleet)
    watch_twice(fleet)
