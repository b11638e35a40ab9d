# SPDX-License-Identifier: Apache-2.0
"""Random sequence of edits, crashes, host losses and returns in one fleet, judged after each convergence."""

import os
import signal
from collections.abc import Callable
from contextlib import suppress

from tests.faults.faults_manager import kill_manager
from tests.faults.fleet import APPLY, FaultFleet, OracleError, repair_fleet
from tests.faults.link_fault import LinkFault, LinkFaultKind
from tests.faults.manager import Manager
from tests.faults.oracle import OracleVerdict
from tests.faults.registry import fault

STEPS = 12
TASKS = ("slam", "nav", "map")


def edit_tasks(fleet: FaultFleet) -> None:
    """The operator moves, removes or restores a task."""
    name = fleet.random.choice(TASKS)
    if name in fleet.tasks and fleet.random.random() < 0.3:
        fleet.remove_task(name)
    elif name in fleet.tasks:
        fleet.pin_task(name, fleet.random.choice(fleet.edges))
    else:
        fleet.add_task(
            name,
            *fleet.random.choice([(), ("--with", "daemon"), ("--deaf",)]),
            on=fleet.random.choice(fleet.edges),
            stop={"grace": "1s"},
        )


def kill_random_apply(fleet: FaultFleet) -> None:
    running = fleet.start_edgectl(*APPLY)
    fleet.wait(fleet.random.uniform(0.2, 2.5))
    kill_manager(running)


def kill_random_process(fleet: FaultFleet) -> None:
    """Kill a random process of a host: a supervisor, a task or one of its daemons."""
    found = [each for host in fleet.hosts.values() for each in host.processes() if "sshd" not in each.command]
    if found:
        victim = fleet.random.choice(found)
        with suppress(ProcessLookupError):
            os.kill(victim.pid, signal.SIGKILL)


def lose_random_host(fleet: FaultFleet) -> None:
    """Cut the power or the link of a host during an apply."""
    name = fleet.random.choice(fleet.edges)
    running = fleet.start_edgectl(*APPLY)
    fleet.wait(fleet.random.uniform(0.0, 2.0))
    harmed = [word for bystander in fleet.bystanders for word in bystander.list_harm()]
    fleet.hosts[name].power_off()
    fleet.wait_for_edgectl(running).expect_exit(0, 4, within=100)
    fleet.hosts[name].boot()
    if harmed:
        raise OracleError(OracleVerdict(foreign=tuple(harmed)))
    # The power cut ended the bystanders there, too.
    fleet.bystanders = [
        each
        for each in fleet.bystanders
        if each.seen.alive or each.record.parent != fleet.hosts[name].records
    ]


def let_other_manager_act(fleet: FaultFleet) -> None:
    """Another manager, with a state and wishes of its own, moves the tasks."""
    converge(fleet)
    other = Manager(fleet=fleet, name="ben")
    other.want_at_random()
    other.run(*APPLY).expect_exit(0)


def cut_random_link(fleet: FaultFleet) -> None:
    relay = fleet.get_relay(fleet.random.choice(fleet.edges))
    relay.set(
        LinkFault(
            kind=fleet.random.choice([LinkFaultKind.CUT_RST, LinkFaultKind.CUT_FIN]),
            after=fleet.random.randrange(20_000),
        )
    )
    fleet.apply().expect_exit(0, 1, 4, within=100)


EVENTS: tuple[Callable[[FaultFleet], None], ...] = (
    edit_tasks,
    edit_tasks,
    kill_random_apply,
    kill_random_process,
    lose_random_host,
    cut_random_link,
    let_other_manager_act,
)


@fault("twelve random events", full=6)
def run_random_events(fleet: FaultFleet) -> None:
    for host in fleet.hosts:
        fleet.start_bystander(host, "recording_task.py", "--task", fleet.random.choice(TASKS))
    for _ in range(STEPS):
        edit_tasks(fleet)
        fleet.random.choice(EVENTS)(fleet)
        if fleet.random.random() < 0.5:
            converge(fleet)


def converge(fleet: FaultFleet) -> None:
    """Repair everything and apply once: exactly the expected tasks run."""
    repair_fleet(fleet)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()
