# SPDX-License-Identifier: Apache-2.0
"""The handoff contract with a robot that records, every 10 ms, which instance controls it and whether it
holds.
"""

import json
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from edgectl.model.check import Check, CheckLocation
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.task import HandoffContract, HandoffOrder, Task
from edgectl.state import failpoints
from edgectl.state.manager_state import load_manager_state
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.stop import restart_tasks
from tests.builders import a_robot, a_task, an_edge, an_inventory
from tests.e2e import robot
from tests.e2e.bench import EAGER, GENTLE, QUICK, Bench, a_local, open_bench

EDGES = [a_local(an_edge("edge1"), "127.0.0.31"), a_local(an_edge("edge2"), "127.0.0.32")]
ROBOT = a_local(a_robot("robot1"), "127.0.0.41")
LINKS = {("edge1", "robot1"): 10e6, ("edge2", "robot1"): 10e6}
Sample = dict[str, Any]


@dataclass
class Scene:
    """A fleet with one robot and one task that controls it."""

    bench: Bench
    socket: Path
    record: Path
    ready: Path
    process: subprocess.Popen[bytes]

    def words(self, *words: str) -> str:
        return shlex.join([sys.executable, robot.__file__, *words])

    def task(self, order: HandoffOrder, safe_within: float = 15.0, **fields: object) -> Task:
        hooks = {
            hook: Check(command=self.words(word, str(self.socket)), on=CheckLocation.ROBOT)
            for hook, word in HOOKS[order].items()
        }
        task = a_task(
            "steer",
            command="exec " + self.words("steer", str(self.socket), str(self.ready)),
            robots=["robot1"],
            ready=Check(command=f"test -e {shlex.quote(str(self.ready))}/$EDGECTL_INSTANCE", timeout=15.0),
            stop=GENTLE,
            handoff=HandoffContract(order=order, timeout=safe_within, **hooks),
        )
        return replace(task, **fields)  # type: ignore[arg-type]

    def broken(self, *hosts: str) -> None:
        Path(f"{self.socket}.broken").write_text(" ".join(hosts))

    def unsafe(self) -> None:
        Path(f"{self.socket}.unsafe").touch()

    def apply(self, task: Task) -> ActionResult | None:
        applied = plan_and_apply(self.bench.using(task).fleet, EAGER, options=ApplyOptions(probe=QUICK))
        return applied.results.actions[0] if applied.results else None

    def running(self, task: Task) -> str:
        """Start the task; return its host."""
        result = self.apply(task)
        assert result is not None
        assert result.outcome is Outcome.DONE, result
        return str(result.located)

    def now(self) -> int:
        """Wait for two more samples; return their number before."""
        count = len(self.samples())
        while len(self.samples()) < count + 2:
            assert self.process.poll() is None, "the robot has ended"
            time.sleep(robot.PERIOD_S)
        return count

    def samples(self) -> list[Sample]:
        return [json.loads(line) for line in self.record.read_text().split("\n")[:-1]]

    def since(self, begin: int) -> list[Sample]:
        self.now()
        return self.samples()[begin:]


HOOKS = {
    HandoffOrder.STOP_FIRST: {"safe_when": "safe", "hold": "hold", "release": "release"},
    HandoffOrder.START_FIRST: {"safe_when": "safe"},
}


@pytest.fixture
def scene(tmp_path: Path, isolated: Path) -> Iterator[Scene]:
    ready = tmp_path / "ready"
    ready.mkdir()
    with tempfile.TemporaryDirectory(
        prefix="edgectl-robot-"
    ) as short:  # the path of a socket has at most 107 bytes
        socket, record = Path(short) / "s", tmp_path / "record"
        process = subprocess.Popen([sys.executable, robot.__file__, "serve", str(socket), str(record)])
        try:
            with open_bench(
                an_inventory(*EDGES, ROBOT, links=LINKS), tmp_path / "manager", isolated
            ) as bench:
                made = Scene(bench, socket, record, ready, process)
                made.broken()
                while not record.exists() or not record.stat().st_size:
                    assert process.poll() is None
                    time.sleep(robot.PERIOD_S)
                yield made
        finally:
            process.kill()
            process.wait()


def exclude_host(task: Task, host: str) -> Task:
    return replace(task, hosts=replace(task.hosts, never=(host,)))


def list_requests(samples: list[Sample]) -> list[str]:
    return [word for sample in samples for word in sample["told"]]


def compute_gap_s(samples: list[Sample]) -> float:
    """Return the time without control: from the first sample without a controlling instance to the next with
    one.
    """
    empty = [sample["t"] for sample in samples if not sample["steer"]]
    return empty[-1] - empty[0] + robot.PERIOD_S if empty else 0.0


def test_start_first_has_no_gap(scene: Scene) -> None:
    task = scene.task(HandoffOrder.START_FIRST)
    old = scene.running(task)
    begin = scene.now()
    result = scene.apply(exclude_host(task, old))
    assert result is not None
    assert (result.outcome, result.downtime_s) == (Outcome.DONE, 0.0)
    assert [phase.phase for phase in result.phases] == [Phase.SAFE, Phase.START, Phase.READY, Phase.STOP]
    samples = scene.since(begin)
    assert all(sample["steer"] for sample in samples)
    assert compute_gap_s(samples) == 0.0
    assert any(len(sample["steer"]) == 2 for sample in samples)
    assert (samples[0]["steer"], samples[-1]["steer"]) == ([old], [result.located])


def test_the_hold_covers_the_whole_gap_of_stop_first(scene: Scene) -> None:
    task = scene.task(HandoffOrder.STOP_FIRST)
    old = scene.running(task)
    begin = scene.now()
    result = scene.apply(exclude_host(task, old))
    assert result is not None
    assert result.outcome is Outcome.DONE
    samples = scene.since(begin)
    assert list_requests(samples) == ["safe", "hold", "lost", "steer", "release"]
    assert all(sample["steer"] or sample["holds"] for sample in samples)
    assert all(len(sample["steer"]) <= 1 for sample in samples)
    assert (samples[-1]["steer"], samples[-1]["holds"]) == ([result.located], False)
    assert result.downtime_s is not None
    assert 0.0 < compute_gap_s(samples) <= result.downtime_s + 2 * robot.PERIOD_S
    spent = {phase.phase: phase.seconds for phase in result.phases}
    assert spent[Phase.STOP] + spent[Phase.START] + spent[Phase.READY] <= result.downtime_s + 0.001
    measured = load_manager_state(scene.bench.fleet.state).downtimes[("steer", str(result.located))]
    assert measured == pytest.approx((result.downtime_s,))


def test_no_event_at_all_while_it_is_not_safe(scene: Scene) -> None:
    task = scene.task(HandoffOrder.STOP_FIRST, safe_within=1.0)
    old = scene.running(task)
    scene.unsafe()
    begin = scene.now()
    result = scene.apply(exclude_host(task, old))
    assert result is not None
    assert (result.outcome, result.located) == (Outcome.DEFERRED, old)
    assert result.error == "not safe to move steer within 1 s"
    samples = scene.since(begin)
    assert set(list_requests(samples)) == {"safe"}
    assert all(sample["steer"] == [old] and not sample["holds"] for sample in samples)


def test_the_old_instance_steers_again_before_the_robot_is_released(scene: Scene) -> None:
    task = scene.task(HandoffOrder.STOP_FIRST, restart=a_task("x").restart.NEVER)
    old = scene.running(task)
    scene.broken(*{"edge1", "edge2"} - {old})
    begin = scene.now()
    result = scene.apply(exclude_host(task, old))
    assert result is not None
    assert (result.outcome, result.located) == (Outcome.FAILED, old)
    assert f"; restored on {old}" in result.error
    samples = scene.since(begin)
    assert list_requests(samples) == ["safe", "hold", "lost", "steer", "release"]
    assert all(sample["steer"] or sample["holds"] for sample in samples)
    assert samples[-1]["steer"] == [old]


def test_a_robot_that_nothing_steers_holds_until_a_restart_mends_it(scene: Scene) -> None:
    """Under ``restart: never`` a failed task is given up: no apply starts it again."""
    task = scene.task(HandoffOrder.STOP_FIRST, restart=a_task("x").restart.NEVER)
    old = scene.running(task)
    scene.broken("edge1", "edge2")
    begin = scene.now()
    result = scene.apply(exclude_host(task, old))
    assert result is not None
    assert "robot1 STILL HOLDS" in result.error
    assert scene.since(begin)[-1]["holds"]
    assert result.hint.endswith("edgectl restart steer, which releases it once an instance is ready")
    scene.broken()
    assert scene.apply(exclude_host(task, old)) is None
    assert scene.since(begin)[-1]["holds"]
    mended = restart_tasks(
        scene.bench.using(exclude_host(task, old)).fleet, ["steer"], options=ApplyOptions(probe=QUICK)
    ).results
    assert mended is not None
    assert mended.done
    samples = scene.since(begin)
    assert list_requests(samples) == ["safe", "hold", "lost", "steer", "release"]
    assert all(sample["steer"] or sample["holds"] for sample in samples)


class ManagerKilledError(BaseException):
    """The manager was killed."""


@pytest.mark.parametrize("point", ["stop sent", "stop acknowledged", "start sent", "start acknowledged"])
def test_a_manager_that_dies_leaves_the_robot_holding_until_it_is_steered(scene: Scene, point: str) -> None:
    task = scene.task(HandoffOrder.STOP_FIRST)
    old = scene.running(task)
    begin = scene.now()

    def die(reached: str) -> None:
        if reached == point:
            raise ManagerKilledError

    remove = failpoints.install_hook(die)
    with suppress(ManagerKilledError):
        scene.apply(exclude_host(task, old))
    remove()
    scene.apply(exclude_host(task, old))
    samples = scene.since(begin)
    assert list_requests(samples)[-1] == "release"
    assert all(sample["steer"] or sample["holds"] for sample in samples)
    assert all(len(sample["steer"]) <= 1 for sample in samples)
    assert len(samples[-1]["steer"]) == 1
