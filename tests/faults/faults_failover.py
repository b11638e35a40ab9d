# SPDX-License-Identifier: Apache-2.0
"""Faults around copies from outside: a failover under a second fault, two managers, hosts that are renamed or removed."""

import signal

from tests.faults import oracle
from tests.faults.command_result import ExpectationError
from tests.faults.faults_etcd import PAST_THE_LEASE_S, PATIENT, open_etcd
from tests.faults.faults_failpoints import APPLY_ONE, choose_failpoints, kill_at_failpoint
from tests.faults.faults_two_managers import finish
from tests.faults.faults_warm_move import kill_supervisor_on
from tests.faults.fleet import APPLY, FaultFleet, format_yaml
from tests.faults.hosts import wait_for
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.manager import Manager, signal_manager
from tests.faults.registry import OWN, fault
from tests.faults.standby_fleet import (
    GRACE_S,
    TASK,
    find_active,
    find_copy,
    repair_and_check,
    start_standby_task,
)

# Between two commands a busy machine takes seconds, in which no manager calls: with 4 s tasks fenced themselves then.
SELF_FENCE_S = 10.0
# The clocks of the hosts, and a quarter of self_fence for a request whose answer is lost.
CERTAIN_S = SELF_FENCE_S * 1.25 + GRACE_S + 10.0
REPLACED = {"self_fence": f"{SELF_FENCE_S:g}s", "on_unreachable": {"policy": "replace", "after": "1s"}}
# Of the points of a failover: each waits for the fence, and for the host.
SAMPLED = 4


def cut_off_active(fleet: FaultFleet) -> str:
    """Cut the host of the active instance off until that has certainly stopped itself; returns it."""
    old = find_active(fleet)
    fleet.get_relay(old).set(LinkFault(kind=LinkFaultKind.REFUSE))
    fleet.wait(CERTAIN_S)
    wait_for(lambda: TASK not in oracle.watch_launches(fleet.records, seconds=0.3), "the end of the instance")
    return old


def fail_over(fleet: FaultFleet, old: str) -> None:
    """Apply while ``old`` is silent: the task is active elsewhere, once."""
    fleet.run_edgectl(*APPLY_ONE).expect_exit(4)
    fleet.check_verdict()
    if find_active(fleet) == old:
        raise ExpectationError(f"active on {old}, which was cut off")


@fault("standby: manager killed at every point of a failover", kinds=("loopback",))
def kill_failover(fleet: FaultFleet) -> None:
    start_standby_task(fleet, **REPLACED)
    for name in fleet.edges:
        fleet.get_relay(name)
    fleet.kill_at = 0
    old = cut_off_active(fleet)
    fail_over(fleet, old)
    fleet.kill_at = None
    count = len(fleet.failpoint_log.read_text().splitlines())
    repair_and_check(fleet)
    points = choose_failpoints(fleet, count)
    for point in sorted(fleet.random.sample(points, min(SAMPLED, len(points)))):
        old = cut_off_active(fleet)
        kill_at_failpoint(fleet, APPLY_ONE, point)
        fail_over(fleet, old)
        repair_and_check(fleet)


@fault("standby: failover to a host whose disk is full", kinds=OWN, full=2)
def fail_over_to_full_disk(fleet: FaultFleet) -> None:
    start_standby_task(fleet, **REPLACED)
    fleet.get_relay(find_active(fleet))
    fleet.get_computer(find_copy(fleet)).fill_disk()
    cut_off_active(fleet)
    fleet.apply().expect_exit(1, 4)
    fleet.injected += 1


@fault("standby: failover to a host whose supervisor is dead", full=2)
def fail_over_to_orphan(fleet: FaultFleet) -> None:
    start_standby_task(fleet, **REPLACED)
    fleet.get_relay(find_active(fleet))
    copy = find_copy(fleet)
    old = cut_off_active(fleet)
    kill_supervisor_on(fleet, copy)
    fleet.injected += 1
    fail_over(fleet, old)


def exclude(manager: Manager, host: str) -> None:
    """The file of this manager alone: slam may not be on ``host``."""
    tasks = {name: {"up": "300ms", **task} for name, task in manager.fleet.tasks.items()}
    tasks[TASK] = {**tasks[TASK], "hosts": {"never": [host]}}
    manager.tasks.write_text(format_yaml({"version": 1, **manager.fleet.policy, "tasks": tasks}))


def check_one_at_a_time(fleet: FaultFleet) -> None:
    """No two were active at any moment, by the records and by the messages."""
    clashes = [str(each) for each in oracle.find_overlaps(oracle.list_lifetimes(fleet.records))]
    assert fleet.subscriber is not None
    if clashes := clashes + fleet.subscriber.find_overlaps():
        raise ExpectationError(f"doubled: {clashes}")


def open_disagreeing(fleet: FaultFleet) -> tuple[Manager, Manager]:
    """Two managers that share a real etcd; each of them excludes another host."""
    open_etcd(fleet)
    start_standby_task(fleet)
    return Manager(fleet=fleet, name="ana"), Manager(fleet=fleet, name="ben")


@fault(
    "standby: two managers with etcd move the task at once, to and fro",
    kinds=("loopback",),
    full=2,
)
def move_twice_with_etcd(fleet: FaultFleet) -> None:
    managers = open_disagreeing(fleet)
    for _ in range(4):
        first, second = fleet.random.sample(managers, 2)
        exclude(first, find_active(fleet))
        exclude(second, fleet.random.choice(fleet.edges))
        fleet.injected += 1
        running = first.start(*PATIENT)
        fleet.wait(fleet.random.uniform(0.0, 1.5))
        finish(fleet, running, second.start(*PATIENT), codes=(0, 1, 4))
        check_one_at_a_time(fleet)
        fleet.check_verdict()


@fault(
    "standby: two managers with etcd: one freezes in a warm move past its lease, the other acts, it thaws",
    kinds=("loopback",),
    full=2,
)
def freeze_warm_move_with_etcd(fleet: FaultFleet) -> None:
    managers = open_disagreeing(fleet)
    for _ in range(2):
        first, second = fleet.random.sample(managers, 2)
        active = find_active(fleet)
        exclude(first, active)
        exclude(second, fleet.random.choice([name for name in fleet.edges if name != active]))
        fleet.injected += 1
        frozen = first.start(*PATIENT)
        fleet.wait(fleet.random.uniform(0.6, 1.8))
        signal_manager(frozen, signal.SIGSTOP)
        fleet.wait(PAST_THE_LEASE_S)
        finish(fleet, second.start(*PATIENT), codes=(0, 1, 4))
        signal_manager(frozen, signal.SIGCONT)
        fleet.wait_for_edgectl(frozen).expect_exit(0, 1, 4, 75)
        check_one_at_a_time(fleet)
        second.run(*PATIENT).expect_exit(0)
        fleet.check_verdict()


@fault("standby: host renamed while it has the copy, or the active instance", full=2)
def rename_copy_host(fleet: FaultFleet) -> None:
    """The machine tells under which name it keeps the task and its copy."""
    start_standby_task(fleet)
    for number, find in enumerate((find_copy, find_active)):
        old, before = find(fleet), fleet.count_launches(TASK)
        name = f"a-jetson-{number}" if fleet.random.random() < 0.5 else f"z-jetson-{number}"
        fleet.inventory[name] = fleet.inventory.pop(old)
        fleet.write_files()
        fleet.injected += 1
        fleet.apply_and_check()
        if fleet.count_launches(TASK) != before:
            raise ExpectationError("another instance became active")
    for _ in range(2):
        names = {str(host["host"]): name for name, host in fleet.inventory.items()}
        fleet.tasks[TASK]["hosts"] = {"never": [names[find_active(fleet)]]}
        fleet.write_files()
        fleet.apply_and_check()
    fleet.tasks[TASK].pop("hosts")


@fault("standby: inventory loses the host that has the copy", full=2)
def lose_copy_host(fleet: FaultFleet) -> None:
    """The task is active where it was; the copy that nobody sees any more is found when the host is back."""
    start_standby_task(fleet)
    copy, active = find_copy(fleet), find_active(fleet)
    removed = fleet.inventory.pop(copy)
    fleet.write_files()
    fleet.run_edgectl(*APPLY).expect_exit(0, 4)
    fleet.check_verdict({TASK: active})
    fleet.injected += 1
    fleet.inventory[copy] = removed
    fleet.write_files()
    fleet.apply_and_check()
    if find_active(fleet) != active:
        raise ExpectationError(f"moved from {active}")
