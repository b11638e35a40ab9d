# SPDX-License-Identifier: Apache-2.0
"""watch over real sshd: a lasting load moves a task once, and a host that is cut off and comes back keeps its
tasks.
"""

import itertools
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.cycle import Cycle
from edgectl.model.inventory import Capacity, Inventory, Role
from edgectl.model.plan import Action
from edgectl.model.result import Outcome
from edgectl.model.task import HostRules
from edgectl.usecases.watch import WatchOptions, watch_fleet
from tests.builders import an_inventory
from tests.e2e.bench import (
    BY_CPU,
    Bench,
    a_mark,
    a_sleeper,
    kill_processes,
    list_sleepers,
    open_bench,
    wait_for_sleepers,
)
from tests.pace import patience
from tests.sshd import Lab, Server, _list_descendants
from tests.usecases.watch_site import EVERY, JumpingWait, SteppedClock

# Small slices: even on a busy machine a busy loop takes a large share of one.
SLICE = Capacity(cpu=0.15, memory=1e9)
# Uses a quarter of a core once its host allows it.
BURNER = """while [ ! -e "$HOME/burn" ]; do sleep 0.1; done
exec python3 -c 'import time
while True:
    end = time.process_time() + 0.05
    while time.process_time() < end: pass
    time.sleep(0.15)'"""


def build_inventory(lab: Lab) -> Inventory:
    edges = [replace(lab.host(name), capacity=SLICE) for name in ("edge1", "edge2")]
    return an_inventory(*edges, replace(lab.host("robot1", role=Role.ROBOT), capacity=SLICE))


@pytest.fixture
def bench(lab: Lab, tmp_path: Path) -> Iterator[Bench]:
    with open_bench(build_inventory(lab), tmp_path / "manager", lab) as made:
        yield made


def list_moves(cycles: list[Cycle]) -> list[tuple[str, str | None]]:
    """Return the moves as (task, hosts)."""
    actions = [action for cycle in cycles if cycle.results is not None for action in cycle.results.actions]
    assert all(action.outcome is Outcome.DONE for action in actions), actions
    return [(action.task, action.host) for action in actions if action.action is Action.MOVE]


def list_until_move(running: Iterator[Cycle], limit: int) -> list[Cycle]:
    """The cycles to the first move, at most ``limit``, and four more.

    A busy machine gives a load that is to build up little of the CPU.
    """
    cycles = []
    for cycle in itertools.islice(running, limit):
        cycles.append(cycle)
        if list_moves([cycle]):
            break
    return [*cycles, *itertools.islice(running, 4)]


def find_task_host(cycle: Cycle, task: str) -> str | None:
    hosts = cycle.snapshot.hosts if cycle.snapshot is not None else {}
    return next(
        (name for name, host in hosts.items() if task in host.tasks and host.tasks[task].state.alive), None
    )


def cut_off(server: Server) -> None:
    """Cut the host off for everyone and close open connections; what runs there goes on."""
    assert server.process is not None
    kill_processes([server.process.pid, *_list_descendants(server.process.pid)])
    server.process.wait()
    server.process = None


def test_a_load_moves_a_task_once_and_a_host_that_was_cut_off_keeps_it(lab: Lab, bench: Bench) -> None:
    mark, hands = a_mark(), SteppedClock()
    # Their names sort last: a task that is placed earlier counts with its demand from then on, not with its
    # usage.
    burners = [
        a_sleeper(f"zz-burner-{name}", a_mark(), command=BURNER, hosts=HostRules(pin=name))
        for name in ("edge1", "edge2")
    ]
    fleet = replace(
        bench.using(a_sleeper("slam", mark), *burners).fleet, clock=hands.wall, uptime=hands.uptime
    )
    options = WatchOptions(
        every=EVERY,
        apply=True,
        control=JumpingWait(hands),
        probe=ProbeOptions(window=0.4, timeout=patience(10.0)),
        policy=lambda _: replace(BY_CPU, move_margin=0.1),
    )
    with closing(watch_fleet(fleet, options)) as running:
        first = list(itertools.islice(running, 3))
        before = find_task_host(first[-1], "slam")
        assert before is not None
        assert list_moves(first) == []
        pids = wait_for_sleepers(mark)

        (lab[before].home / "burn").touch()
        loaded = list_until_move(running, limit=30)
        after = find_task_host(loaded[-1], "slam")
        assert list_moves(loaded) == [("slam", after)]
        assert after not in (None, before)
        now = wait_for_sleepers(mark)
        assert now
        assert not set(now) & set(pids), "the old one is gone"

        server = lab[str(after)]
        cut_off(server)
        silent = list(itertools.islice(running, 2))
        assert all(
            cycle.snapshot is not None and not cycle.snapshot.hosts[server.name].ok for cycle in silent
        )
        assert all(cycle.plan is not None and cycle.plan.summary[Action.HOLD] == 2 for cycle in silent)
        assert list_sleepers(mark) == now, "held, not doubled"
        server.start()
        server.wait()
        back = list(itertools.islice(running, 6))
        assert find_task_host(back[-1], "slam") == after
        assert list_moves([*silent, *back]) == []
        assert list_sleepers(mark) == now
