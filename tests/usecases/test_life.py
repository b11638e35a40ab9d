"""Seeded random lives of a fleet over simulated hosts: applies, deaths of the manager, hosts lost, back and rebooted, changes of everything.

Throughout: at most one instance of each task, nothing foreign stopped. After each life is mended: exactly one of every placed task.
"""

import contextlib
import dataclasses
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.model.policy import Policy
from edgectl.model.task import Check, CheckLocation, DetectRule, HandoffContract, Task
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


class Died(BaseException):
    """The manager was killed: nothing of its own handles this."""


@dataclasses.dataclass
class Life:
    """One fleet and what fate has in store for it."""

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


def a_life(state: Path, seed: int) -> Life:
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
    return Life(fate=random.Random(seed), hosts=hosts, fleet=fleet)


def applied(life: Life) -> None:
    life.applies += 1
    plan_and_apply(life.current, POLICY, options=ApplyOptions(max_parallel=1))


def killed(life: Life) -> None:
    """The manager dies at some point of an apply, if it gets that far."""
    left = [life.fate.randrange(30)]

    def die(_point: str) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise Died

    remove = failpoints.install_hook(die)
    try:
        with contextlib.suppress(Died):
            applied(life)
    finally:
        remove()


def lost(life: Life) -> None:
    life.hosts.down.add(life.fate.choice([*EDGES, "robot1"]))


def back(life: Life) -> None:
    if life.hosts.down:
        life.hosts.down.discard(life.fate.choice(sorted(life.hosts.down)))


def rebooted(life: Life) -> None:
    """Everything that ran there is gone, also what nobody can see at the moment."""
    host = life.hosts[life.fate.choice(EDGES)]
    for name in [name for name, entry in host.tasks.items() if entry.get("managed", True)]:
        del host.tasks[name]
        host.world.ends(name, host.name)


def crashed(life: Life) -> None:
    name = life.task().name
    for host in life.hosts.hosts.values():
        if name in host.tasks:
            host.tasks[name] = {**host.tasks[name], "state": "failed", "pid": 0, "exit_code": 1}
            host.world.ends(name, host.name)


def loaded(life: Life) -> None:
    life.hosts[life.fate.choice(EDGES)].used = life.fate.choice([0.0, 1.0, 2.0, 3.2])


def edited(life: Life) -> None:
    life.change(life.task().name, spec_hash=f"spec{life.fate.randrange(1000)}")


def cordoned(life: Life) -> None:
    operator_marks.cordon_hosts(life.current, [life.fate.choice(EDGES)], drain=life.fate.random() < 0.5)


def uncordoned(life: Life) -> None:
    operator_marks.uncordon_hosts(life.current, list(EDGES))


def finished(life: Life) -> None:
    operator_marks.mark_tasks_done(life.current, [life.task().name])


def reopened(life: Life) -> None:
    operator_marks.reopen_tasks(
        life.current, [task.name for task in life.fleet.tasks.tasks.values() if task.managed]
    )


FATES: tuple[Callable[[Life], None], ...] = (
    *(applied,) * 6, *(killed,) * 4, lost, *(back,) * 2, rebooted, crashed, loaded, loaded, edited, cordoned, uncordoned, finished, reopened,
)  # fmt: skip


def sound(life: Life) -> None:
    assert not life.hosts.world.overlap
    assert not any(event.startswith("stop roscore") for event in life.hosts.world.events)
    assert "roscore" in life.hosts["edge3"].tasks


def mended(life: Life) -> None:
    """All hosts answer, nothing is closed: one apply, and every task runs exactly once."""
    life.hosts.down.clear()
    for host in life.hosts.hosts.values():
        host.used = 0.0
    uncordoned(life)
    reopened(life)
    applied(life)
    sound(life)
    alive = [
        name
        for host in life.hosts.hosts.values()
        for name, entry in host.tasks.items()
        if entry["state"] in ("running", "ready")
    ]
    assert sorted(alive) == sorted(life.fleet.tasks.tasks)
    assert not make_plan(life.current, POLICY).changes


@pytest.mark.parametrize("block", range(4))
def test_random_lives(block: int, tmp_path: Path) -> None:
    applies = 0
    for seed in range(block * 25, block * 25 + 25):
        life = a_life(tmp_path / str(seed), seed)
        story = []
        try:
            for _ in range(EVENTS):
                event = life.fate.choice(FATES)
                story.append(event.__name__)
                event(life)
                sound(life)
            mended(life)
        except AssertionError as error:
            raise AssertionError(f"seed {seed}: {' '.join(story)}") from error
        applies += life.applies
    assert applies > 250
