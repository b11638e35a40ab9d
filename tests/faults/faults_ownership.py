# SPDX-License-Identifier: Apache-2.0
"""Faults of ownership and heartbeats: two fleets on one login, orphans on silent hosts, a host that hangs."""

import signal

from tests.faults import oracle, scan
from tests.faults.command_result import ExpectationError
from tests.faults.faults_two_managers import check_nothing_doubled, finish
from tests.faults.fleet import APPLY, FaultFleet, format_yaml
from tests.faults.hosts import wait_for
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.manager import Manager, signal_manager
from tests.faults.registry import ALL, fault

# Later than self_fence + grace + 10 s, from which a fenced task may be started elsewhere.
REPLACED_S = 30.0


@fault("two fleets on one login, with equal names of hosts and tasks", full=4, kinds=ALL)
def share_a_login(fleet: FaultFleet) -> None:
    """Both change at the same time, three times; then one stops everything. No fleet touches a task of the other."""
    for task in ("slam", "nav"):
        fleet.add_task(task)
    other = Manager(fleet=fleet, name="ben", own_fleet=True)
    both = {**fleet.expected, "other-slam": None, "other-nav": None}
    for _ in range(3):
        for task in ("slam", "nav"):
            fleet.pin_task(task, fleet.random.choice(fleet.edges))
        _want_elsewhere(fleet, other)
        own = fleet.start_edgectl(*APPLY)
        fleet.wait(fleet.random.uniform(0.0, 1.0))
        fleet.injected += 1
        finish(fleet, own, other.start(*APPLY), codes=(0,))
        fleet.check_verdict({**both, **fleet.expected})
    before = {task: fleet.count_launches(task) for task in fleet.expected}
    other.run("stop", "--all", "--yes").expect_exit(0)
    fleet.check_verdict()
    lives = oracle.group_by_task(oracle.list_lifetimes(fleet.records))
    if any(lives[task][-1].signals or len(lives[task]) != count for task, count in before.items()):
        raise ExpectationError("a task of the first fleet was touched")


def _want_elsewhere(fleet: FaultFleet, other: Manager) -> None:
    """The second fleet has tasks of the same names; their records call them by others."""
    tasks = {
        task: {
            **fleet.tasks[task],
            "command": str(fleet.tasks[task]["command"]).replace(f"--task {task}", f"--task other-{task}"),
            "hosts": {"pin": fleet.random.choice(fleet.edges)},
        }
        for task in fleet.tasks
    }
    other.tasks.write_text(format_yaml({"version": 1, "tasks": tasks}))


@fault(
    "supervisor killed, then the host falls silent under self_fence and replace",
    full=3,
    kinds=ALL,
)
def lose_an_orphan(fleet: FaultFleet) -> None:
    """An orphan does not fence itself, so it is held; its neighbour does, and is started elsewhere."""
    fenced = {"self_fence": "10s", "on_unreachable": {"policy": "replace", "after": "10s"}}
    fleet.add_task("slam", on=fleet.first, **fenced)
    fleet.add_task("nav", on=fleet.first, **fenced)
    fleet.apply().expect_exit(0)
    # At once: after 10 s without a command the task would stop itself.
    _kill_supervisor(fleet, "slam")
    fleet.pin_task("slam", None)
    fleet.pin_task("nav", None)
    fleet.run_edgectl("status").expect_output("orphaned")
    relay = fleet.get_relay(fleet.first)
    relay.set(LinkFault(kind=LinkFaultKind.REFUSE))
    for _ in range(6):
        fleet.wait(REPLACED_S / 6)
        fleet.apply().expect_exit(4)
    check_nothing_doubled(fleet)
    hosts = {
        task: [life.host for life in lives]
        for task, lives in oracle.group_by_task(oracle.list_lifetimes(fleet.records)).items()
    }
    if hosts["slam"] != [fleet.first] or set(hosts["nav"]) == {fleet.first}:
        raise ExpectationError(f"the orphan was replaced, or its neighbour was not: {hosts}")
    relay.heal()


def _kill_supervisor(fleet: FaultFleet, task: str) -> None:
    (supervisor,) = fleet.list_supervisors(fleet.first, f"--task {task} ")
    scan.kill_processes([supervisor])
    wait_for(lambda: not supervisor.alive, "the end of the supervisor")


@fault("a host hangs while a watch samples it, tasks elsewhere fence themselves", full=2, kinds=ALL)
def hang_while_sampling(fleet: FaultFleet) -> None:
    for number, edge in enumerate(fleet.edges):
        fleet.add_task(f"t{number}", on=edge, self_fence="10s")
    relay = fleet.get_relay(fleet.first)
    fleet.apply().expect_exit(0)
    watch = fleet.start_edgectl("watch", "--apply", "--every", "2s")
    for _ in range(2):
        fleet.wait(4.0)
        relay.set(LinkFault(kind=LinkFaultKind.BLACK_HOLE))
        fleet.wait(20.0)
        relay.heal()
    fleet.wait(4.0)
    signal_manager(watch, signal.SIGTERM)
    fleet.wait_for_edgectl(watch).expect_exit(0, 4, 130)
    if any(fleet.count_launches(f"t{number}") != 1 for number in (1, 2)):
        events = fleet.run_edgectl("events").out
        raise ExpectationError(f"a task on a healthy host stopped itself: {events}")
