# SPDX-License-Identifier: Apache-2.0
"""A manager with its files over real hosts, and an independent view of /proc."""

import itertools
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.inventory import Capacity, Connection, Host, Inventory
from edgectl.model.plan import Action, Plan
from edgectl.model.policy import Policy, Weights
from edgectl.model.snapshot import Snapshot, TaskSample
from edgectl.model.task import StopRule, Task, Tasks
from edgectl.state.paths import get_state_root
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.usecases.apply import ApplyOptions, ApplyResult, plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.stop import stop_tasks
from tests.builders import a_task, some_tasks
from tests.compiled_agent import give_agent
from tests.leftovers import end_started_in
from tests.pace import patience
from tests.sshd import Lab

QUICK = ProbeOptions(window=0.2, timeout=patience(10.0))
EAGER = Policy(min_dwell=0.0)
# A small margin: on a busy machine a process without limit may get little CPU.
BY_CPU = Policy(min_dwell=0.0, move_margin=0.01, weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0))
GENTLE = StopRule(grace=2.0)
_numbers = itertools.count(1)


def a_slice(host: Host) -> Host:
    """Return ``host`` as a slice of two cores and 1 GB, so that many fit on one machine."""
    return replace(host, capacity=Capacity(cpu=2.0, memory=1e9))


def a_local(host: Host, address: str) -> Host:
    """Return ``host`` as a slice of this very machine."""
    return a_slice(replace(host, host=address, connection=Connection.LOCAL))


def a_mark() -> str:
    """Return a number of seconds to sleep that no other process on this machine sleeps."""
    return f"{100_000 + next(_numbers)}.{os.getpid()}"


def a_sleeper(name: str, mark: str, **fields: object) -> Task:
    """A task with a child in a session of its own, all of them asleep for ``mark`` seconds."""
    command = f"setsid sleep {mark} & sleep {mark} & echo up; wait"
    return replace(a_task(name, command=command, stop=GENTLE), **fields)  # type: ignore[arg-type]


def list_sleepers(mark: str) -> list[int]:
    """List the processes that sleep for ``mark`` seconds."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            if path.read_bytes() == f"sleep\0{mark}\0".encode():
                found.append(int(path.parent.name))
    return found


def wait_for_sleepers(mark: str, count: int = 2) -> list[int]:
    """List them once there are ``count``: a shell that was just started may not sleep yet."""
    deadline = time.monotonic() + patience(30)
    while len(found := list_sleepers(mark)) < count:
        assert time.monotonic() < deadline, f"{len(found)} of {count} sleep"
        time.sleep(0.02)
    return found


def kill_processes(pids: list[int]) -> None:
    assert all(pid > 1 for pid in pids)
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@dataclass(frozen=True)
class Bench:
    """A manager: its fleet, and its commands with a short sample window."""

    fleet: Fleet
    said: list[str] = field(default_factory=list)

    def using(self, *tasks: Task, inventory: Inventory | None = None) -> "Bench":
        fleet = replace(self.fleet, tasks=some_tasks(*tasks), inventory=inventory or self.fleet.inventory)
        return Bench(fleet, self.said)

    def probe(self) -> Snapshot:
        return probe_fleet(self.fleet, QUICK)

    def plan(self, policy: Policy = EAGER) -> Plan:
        return make_plan(self.fleet, policy, options=QUICK)

    def actions(self, policy: Policy = EAGER) -> dict[str, Action]:
        return {step.task: step.action for step in self.plan(policy).steps}

    def apply(self, policy: Policy = EAGER) -> ApplyResult:
        applied = plan_and_apply(self.fleet, policy, options=ApplyOptions(probe=QUICK))
        assert applied.results is None or applied.results.done, applied.results
        return applied

    def stop(self, *names: str) -> ApplyResult:
        return stop_tasks(self.fleet, names or None, options=ApplyOptions(probe=QUICK))

    def where(self) -> dict[str, str]:
        """Return the host of each living task."""
        return {
            task: host
            for host, sample in self.probe().hosts.items()
            for task, entry in sample.tasks.items()
            if entry.state.alive
        }

    def sample(self, task: str) -> TaskSample:
        return next(host.tasks[task] for host in self.probe().hosts.values() if task in host.tasks)


@contextmanager
def open_bench(inventory: Inventory, state: Path, hosts: Path | Lab) -> Iterator[Bench]:
    """Open a manager of ``inventory``. In the end what runs on ``hosts``, servers or the HOME of local hosts, is ended
    by signals: to have edgectl stop it takes 30 times the CPU.
    """
    state.mkdir(mode=0o700)
    give_agent(get_state_root())
    said: list[str] = []
    bench = Bench(
        Fleet(
            inventory=inventory,
            tasks=Tasks(tasks={}),
            transport=FleetTransport(),
            state=state,
            warn=said.append,
        ),
        said,
    )
    try:
        yield bench
    finally:
        if isinstance(hosts, Lab):
            hosts.end_tasks()
        else:
            end_started_in([hosts])
