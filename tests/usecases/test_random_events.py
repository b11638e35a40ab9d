# SPDX-License-Identifier: Apache-2.0
"""Random seeded sequences of events over simulated hosts: applies, deaths of the manager, lost, returned and
rebooted hosts, edits.

Throughout: at most one instance of each task, no foreign process stopped. After each sequence and repair:
exactly one of every placed task. A hundred of them with ``--whole``, in ``make faults``; else a third.
"""

import contextlib
import dataclasses
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.model.check import Check, CheckLocation
from edgectl.model.policy import Policy
from edgectl.model.task import DetectRule, HandoffContract, Task
from edgectl.state import failpoints
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet

EDGES = ("edge1", "edge2", "edge3")
EVENTS = 30
HOOKS = HandoffContract(
    hold=Check(command="hold", on=CheckLocation.ROBOT),
    release=Check(command="release", on=CheckLocation.ROBOT),
)
FOREIGN = a_task("roscore", managed=False, detect=DetectRule(cmdline="roscore"))
POLICY = Policy(min_dwell=0.0, move_margin=0.05)


class ManagerKilledError(BaseException):
    """The manager was killed: no handler of the product catches this."""


@dataclasses.dataclass
class FleetLife:
    """One fleet and its random events."""

    fate: random.Random
    hosts: FakeFleet
    fleet: Fleet
    now: float = NOW
    applies: int = 0

    @property
    def current(self) -> Fleet:
        self.now += 10.0
        return dataclasses.replace(self.fleet, clock=lambda: self.now)

    def change(self, name: str, **fields: object) -> None:
        tasks = {**self.fleet.tasks.tasks, name: dataclasses.replace(self.fleet.tasks.tasks[name], **fields)}  # type: ignore[arg-type]
        self.fleet = dataclasses.replace(self.fleet, tasks=some_tasks(*tasks.values()))

    def task(self) -> Task:
        return self.fate.choice([task for task in self.fleet.tasks.tasks.values() if task.managed])


def build_life(state: Path, seed: int) -> FleetLife:
    hosts = FakeFleet.of([*EDGES, "robot1"])
    hosts["edge3"].tasks["roscore"] = {
        "state": "running",
        "pid": 7,
        "instance": "",
        "generation": 0,
        "spec_hash": "",
        "managed": False,
    }
    inventory = an_inventory(*(an_edge(name) for name in EDGES), a_robot("robot1"))
    tasks = some_tasks(
        a_task("slam", cpu=0.5, robots=["robot1"], handoff=HOOKS, ready=Check(command="ready")),
        a_task("navigation", cpu=0.4, needs=["slam"]),
        a_task("detection", cpu=1.2),
        FOREIGN,
    )
    state.mkdir(mode=0o700)
    fleet = Fleet(inventory=inventory, tasks=tasks, transport=hosts.transport, state=state)
    return FleetLife(fate=random.Random(seed), hosts=hosts, fleet=fleet)


def apply_plan(life: FleetLife) -> None:
    life.applies += 1
    plan_and_apply(life.current, POLICY, options=ApplyOptions(max_parallel=1))


def kill_manager(life: FleetLife) -> None:
    """The manager dies at some failpoint of an apply, if the apply gets that far."""
    left = [life.fate.randrange(30)]

    def die(_point: str) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise ManagerKilledError

    remove = failpoints.install_hook(die)
    try:
        with contextlib.suppress(ManagerKilledError):
            apply_plan(life)
    finally:
        remove()


def lose_host(life: FleetLife) -> None:
    life.hosts.down.add(life.fate.choice([*EDGES, "robot1"]))


def return_host(life: FleetLife) -> None:
    if life.hosts.down:
        life.hosts.down.discard(life.fate.choice(sorted(life.hosts.down)))


def reboot_host(life: FleetLife) -> None:
    """Everything that ran there is gone, even on a host that is unreachable at the moment."""
    host = life.hosts[life.fate.choice(EDGES)]
    for name in [name for name, entry in host.tasks.items() if entry.get("managed", True)]:
        del host.tasks[name]
        host.world.ends(name, host.name)


def crash_task(life: FleetLife) -> None:
    name = life.task().name
    for host in life.hosts.hosts.values():
        if name in host.tasks:
            host.tasks[name] = {**host.tasks[name], "state": "failed", "pid": 0, "exit_code": 1}
            host.world.ends(name, host.name)


def load_host(life: FleetLife) -> None:
    life.hosts[life.fate.choice(EDGES)].used = life.fate.choice([0.0, 1.0, 2.0, 3.2])


def edit_task(life: FleetLife) -> None:
    life.change(life.task().name, spec_hash=f"spec{life.fate.randrange(1000)}")


def cordon_host(life: FleetLife) -> None:
    operator_marks.cordon_hosts(life.current, [life.fate.choice(EDGES)], drain=life.fate.random() < 0.5)


def uncordon_all(life: FleetLife) -> None:
    operator_marks.uncordon_hosts(life.current, list(EDGES))


def finish_task(life: FleetLife) -> None:
    operator_marks.mark_tasks_done(life.current, [life.task().name])


def reopen_all(life: FleetLife) -> None:
    operator_marks.reopen_tasks(
        life.current, [task.name for task in life.fleet.tasks.tasks.values() if task.managed]
    )


FATES: tuple[Callable[[FleetLife], None], ...] = (
    *(apply_plan,) * 6, *(kill_manager,) * 4, lose_host, *(return_host,) * 2, reboot_host, crash_task, load_host, load_host, edit_task, cordon_host, uncordon_all, finish_task, reopen_all,
)  # fmt: skip


def check_invariants(life: FleetLife) -> None:
    assert not life.hosts.world.overlap
    assert not any(event.startswith("stop roscore") for event in life.hosts.world.events)
    assert "roscore" in life.hosts["edge3"].tasks


def repair_and_check(life: FleetLife) -> None:
    """All hosts answer, nothing is cordoned: one apply, and every task runs exactly once."""
    life.hosts.down.clear()
    for host in life.hosts.hosts.values():
        host.used = 0.0
    uncordon_all(life)
    reopen_all(life)
    apply_plan(life)
    check_invariants(life)
    alive = [
        name
        for host in life.hosts.hosts.values()
        for name, entry in host.tasks.items()
        if entry["state"] in ("running", "ready")
    ]
    assert sorted(alive) == sorted(life.fleet.tasks.tasks)
    assert not make_plan(life.current, POLICY).changes


@pytest.mark.parametrize("block", range(4))
def test_random_lives(block: int, whole: bool, tmp_path: Path) -> None:
    applies, lives = 0, 25 if whole else 8
    for seed in range(block * 25, block * 25 + lives):
        life = build_life(tmp_path / str(seed), seed)
        story = []
        try:
            for _ in range(EVENTS):
                event = life.fate.choice(FATES)
                story.append(event.__name__)
                event(life)
                check_invariants(life)
            repair_and_check(life)
        except AssertionError as error:
            raise AssertionError(f"seed {seed}: {' '.join(story)}") from error
        applies += life.applies
    assert applies > 10 * lives
