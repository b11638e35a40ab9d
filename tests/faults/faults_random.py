"""A random life: many applies, wishes, crashes, losses and returns in one fleet, with the oracle's word after each convergence."""

import os
import signal
from collections.abc import Callable
from contextlib import suppress

from tests.faults.faults_manager import kill
from tests.faults.fleet import APPLY, Fleet, OracleError, heal
from tests.faults.oracle import Verdict
from tests.faults.registry import fault
from tests.faults.trouble import Kind, Trouble

STEPS = 12
TASKS = ("slam", "nav", "map")


def wish(fleet: Fleet) -> None:
    """Somebody wants a task elsewhere, or gone, or back."""
    name = fleet.draw.choice(TASKS)
    if name in fleet.tasks and fleet.draw.random() < 0.3:
        fleet.unwant(name)
    elif name in fleet.tasks:
        fleet.pin(name, fleet.draw.choice(["edge1", "edge2"]))
    else:
        fleet.want(
            name,
            *fleet.draw.choice([(), ("--with", "daemon"), ("--deaf",)]),
            on=fleet.draw.choice(["edge1", "edge2"]),
            stop={"grace": "1s"},
        )


def manager_dies(fleet: Fleet) -> None:
    running = fleet.begin(*APPLY)
    fleet.clock(fleet.draw.uniform(0.2, 2.5))
    kill(running)


def process_dies(fleet: Fleet) -> None:
    """Any process of a host: a supervisor, a task, a daemon of it."""
    found = [each for host in fleet.hosts.values() for each in host.processes() if "sshd" not in each.command]
    if found:
        victim = fleet.draw.choice(found)
        with suppress(ProcessLookupError):
            os.kill(victim.pid, signal.SIGKILL)


def host_is_lost(fleet: Fleet) -> None:
    """The power of a host fails while an apply runs, or its line does."""
    name = fleet.draw.choice(["edge1", "edge2"])
    running = fleet.begin(*APPLY)
    fleet.clock(fleet.draw.uniform(0.0, 2.0))
    harmed = [word for canary in fleet.canaries for word in canary.harm()]
    fleet.hosts[name].power_off()
    fleet.end(running).must(0, 4, within=100)
    fleet.hosts[name].boot()
    if harmed:
        raise OracleError(Verdict(foreign=tuple(harmed)))
    # The power cut has ended the strangers there, too.
    fleet.canaries = [
        each for each in fleet.canaries if each.seen.alive or each.record.parent != fleet.hosts[name].records
    ]


def line_is_cut(fleet: Fleet) -> None:
    relay = fleet.relay(fleet.draw.choice(["edge1", "edge2"]))
    relay.set(
        Trouble(kind=fleet.draw.choice([Kind.CUT_RST, Kind.CUT_FIN]), after=fleet.draw.randrange(20_000))
    )
    fleet.apply().must(0, 1, 4, within=100)


EVENTS: tuple[Callable[[Fleet], None], ...] = (
    wish,
    wish,
    manager_dies,
    process_dies,
    host_is_lost,
    line_is_cut,
)


@fault("a random life of twelve events", full=6)
def random_life(fleet: Fleet) -> None:
    for host in fleet.hosts:
        fleet.canary(host, "beacon.py", "--task", fleet.draw.choice(TASKS))
    for _ in range(STEPS):
        wish(fleet)
        fleet.draw.choice(EVENTS)(fleet)
        if fleet.draw.random() < 0.5:
            converge(fleet)


def converge(fleet: Fleet) -> None:
    """Everything mended and one apply: exactly what is wanted."""
    heal(fleet)
    fleet.apply().must(0)
    fleet.check()
