# SPDX-License-Identifier: Apache-2.0
"""Moves that take the memory of a task along, between real processes."""

import hashlib
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from edgectl.executor.dry_run import list_dry_run_requests
from edgectl.model.check import Check
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.standby import Activation, SaveMoment, StandbyRule, StateRule
from edgectl.model.task import HandoffContract, HandoffOrder, Task
from edgectl.state import failpoints
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.journal_reader import read_journal
from edgectl.units import format_duration
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.events import EventFilter, list_events
from edgectl.usecases.history import find_last_carries, list_revisions
from tests.builders import a_task, an_edge, an_inventory
from tests.e2e import memory_task
from tests.e2e.bench import EAGER, GENTLE, QUICK, Bench, a_local, open_bench
from tests.e2e.test_handoff import ManagerKilledError, exclude_host
from tests.pace import patience

EDGES = [a_local(an_edge("edge1"), "127.0.0.51"), a_local(an_edge("edge2"), "127.0.0.52")]
SECRET = "tell-no-one-2217"


@dataclass
class Scene:
    """Two hosts and a task that keeps text in memory, behind one socket on each."""

    bench: Bench
    folder: Path
    hosts: Path

    def words(self, verb: str, *more: str) -> str:
        place = f"{shlex.quote(str(self.folder))}/$EDGECTL_HOST"
        return f"{shlex.join([sys.executable, memory_task.__file__, verb])} {place} {shlex.join(more)}"

    def task(self, order: HandoffOrder = HandoffOrder.STOP_FIRST, **state: object) -> Task:
        rule = {"save": Check(command=self.words("save")), "load": Check(command=self.words("load"))}
        return a_task(
            "keeper",
            command="exec " + self.words("serve"),
            up=0.3,
            stop=GENTLE,
            state=StateRule(**{**rule, **state}),  # type: ignore[arg-type]
            handoff=HandoffContract(order=order),
        )

    def talk(self, host: str, *words: str) -> str:
        command = [sys.executable, memory_task.__file__, words[0], str(self.folder / host), *words[1:]]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout

    def apply(self, task: Task) -> ActionResult | None:
        applied = plan_and_apply(self.bench.using(task).fleet, EAGER, options=ApplyOptions(probe=QUICK))
        return applied.results.actions[0] if applied.results else None

    def running(self, task: Task, words: str = SECRET) -> str:
        result = self.apply(task)
        assert result is not None
        assert result.outcome is Outcome.DONE, result
        host = str(result.located)
        self.talk(host, "add", words)
        return host

    def move(self, task: Task, old: str) -> ActionResult:
        result = self.apply(exclude_host(task, old))
        assert result is not None
        return result

    def spools(self) -> list[Path]:
        """What is kept of the state on any host."""
        return [path for path in self.hosts.rglob("agent-state/*/hosts/*/tasks/*/state") if path.is_file()]

    def written(self) -> list[Path]:
        """The files of the manager and of the hosts that have the text of the state in them."""
        files = [*self.bench.fleet.state.rglob("*"), *self.hosts.rglob("*")]
        return [path for path in files if path.is_file() and SECRET.encode() in path.read_bytes()]


@pytest.fixture
def scene(tmp_path: Path, isolated: Path) -> Iterator[Scene]:
    with (
        tempfile.TemporaryDirectory(prefix="edgectl-state-") as short,
        open_bench(an_inventory(*EDGES), tmp_path / "manager", isolated) as bench,
    ):
        yield Scene(bench, Path(short), isolated)


def list_phases(result: ActionResult) -> list[Phase]:
    return [phase.phase for phase in result.phases]


def read_commits(scene: Scene) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    read_journal(scene.bench.fleet.state / JOURNAL_FILE_NAME, lambda entry: found.append(dict(entry)))
    return [entry for entry in found if entry["event"] == "commit"]


def test_stop_first_takes_the_memory_along(scene: Scene) -> None:
    task = scene.task()
    old = scene.running(task)
    result = scene.move(task, old)
    assert result.outcome is Outcome.DONE, result
    assert list_phases(result) == [
        Phase.SAVE, Phase.TRANSFER, Phase.STOP, Phase.START, Phase.LOAD, Phase.READY,
    ]  # fmt: skip
    assert scene.talk(str(result.located), "save") == f"{SECRET}\n"
    kept = result.state
    assert kept is not None
    assert (kept.size_bytes, kept.host) == (len(SECRET) + 1, result.located)
    assert kept.sha256 == hashlib.sha256(f"{SECRET}\n".encode()).hexdigest()
    assert kept.age_s > kept.save_s + kept.transfer_s + kept.load_s
    assert result.downtime_s is not None
    assert result.downtime_s < kept.age_s
    assert not scene.spools()
    assert not scene.written()
    assert read_commits(scene)[-1]["state"]["sha256"] == kept.sha256
    fleet = scene.bench.using(task).fleet
    past = list_revisions(fleet)[-1].actions[0].state
    assert past is not None
    assert (past.size_bytes, past.sha256, past.host) == (kept.size_bytes, kept.sha256, kept.host)
    assert past.age_s == pytest.approx(kept.age_s, abs=1e-3)
    last = find_last_carries(fleet)["keeper"]
    assert (last.previous_host, last.located, last.state) == (old, result.located, past)
    said = list_events(fleet, EventFilter(tasks=("keeper",)))[-1].message
    assert f"state of {kept.size_bytes}B" in said
    assert f"state {format_duration(kept.age_s)} old" in said


def test_a_dry_run_lists_what_hands_over_the_state(scene: Scene) -> None:
    task = scene.task()
    old = scene.running(task)
    before = len(read_commits(scene))
    fleet = scene.bench.using(exclude_host(task, old)).fleet
    listed = list_dry_run_requests(
        scene.bench.using(*fleet.tasks.tasks.values()).plan(), fleet.inventory, fleet.tasks
    )
    phases = [(entry["phase"], entry["host"], dict(entry["stdin"])["op"]) for entry in listed]  # type: ignore[call-overload]
    new = ({"edge1", "edge2"} - {old}).pop()
    assert phases == [
        ("reach", new, "status"), ("save", old, "save-state"), ("transfer", new, "write-state"),
        ("transfer", old, "read-state"), ("stop", old, "stop"), ("start", new, "start"),
        ("load", new, "load-state"), ("ready", new, "wait"),
    ]  # fmt: skip
    assert len(read_commits(scene)) == before
    assert not scene.spools()


def test_start_first_takes_it_along_before_the_old_one_stops(scene: Scene) -> None:
    task = scene.task(HandoffOrder.START_FIRST)
    result = scene.move(task, scene.running(task))
    assert list_phases(result) == [
        Phase.SAVE, Phase.TRANSFER, Phase.START, Phase.LOAD, Phase.READY, Phase.STOP,
    ]  # fmt: skip
    assert scene.talk(str(result.located), "save") == f"{SECRET}\n"
    assert not scene.spools()


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({"save": Check(command="echo no map >&2; exit 3")}, "save of keeper failed: exit code 3: no map"),
        (
            {"save": Check(command="exec sleep 600", timeout=0.5)},
            "save of keeper failed: no end within 0.5 s",
        ),
        ({"save": Check(command="true")}, "save of keeper printed nothing"),
        ({"max_bytes": 10.0}, "the state of keeper is larger than 10 bytes"),
    ],
)
def test_a_save_that_fails_leaves_the_old_instance_with_its_memory(
    scene: Scene, state: dict[str, object], message: str
) -> None:
    task = scene.task(**state)  # type: ignore[arg-type]
    old = scene.running(task)
    before = scene.bench.using(task).sample("keeper").instance
    result = scene.move(task, old)
    assert (result.outcome, result.located, result.error) == (Outcome.FAILED, old, message)
    assert list_phases(result) == [Phase.SAVE]
    assert scene.bench.using(task).sample("keeper").instance == before
    assert scene.talk(old, "save") == f"{SECRET}\n"
    assert not scene.spools()


@pytest.mark.parametrize("order", HandoffOrder)
def test_a_load_that_fails_ends_in_the_old_instance_with_its_memory(
    scene: Scene, order: HandoffOrder
) -> None:
    """start-first: it was never stopped. stop-first: it gets what was saved."""
    task = scene.task(order)
    old = scene.running(task)
    refused = Check(
        command=f"[ $EDGECTL_HOST = {old} ] || exit 9; {scene.words('load')}", timeout=patience(2.0)
    )
    assert task.state is not None
    task = replace(task, state=replace(task.state, load=refused))
    result = scene.move(task, old)
    assert (result.outcome, result.located) == (Outcome.FAILED, old)
    assert result.error.startswith("load of keeper failed: exit code 9")
    assert f"it still runs on {old}" in result.error or result.error.endswith(f"restored on {old}")
    assert scene.talk(old, "save") == f"{SECRET}\n"
    assert scene.bench.where() == {"keeper": old}
    assert not scene.spools()
    assert not scene.written()


def test_an_old_instance_that_takes_nothing_serves_without_its_state(scene: Scene) -> None:
    task = scene.task(load=Check(command="exit 9", timeout=patience(5.0)))
    old = scene.running(task)
    result = scene.move(task, old)
    assert (result.outcome, result.located) == (Outcome.FAILED, old)
    assert f"restored on {old}, without its state: load of keeper failed: exit code 9" in result.error
    assert scene.bench.where() == {"keeper": old}
    assert not scene.spools()


@pytest.mark.parametrize("damage", ["truncate", "change", "remove"])
def test_a_state_that_is_damaged_on_the_way_is_not_loaded(scene: Scene, damage: str) -> None:
    """At the moment before the new host checks it."""
    task = scene.task()
    old = scene.running(task)

    def hook(point: str) -> None:
        if point == "load-state sent":
            for path in scene.spools():
                if old in path.parts:
                    continue
                if damage == "remove":
                    path.unlink()
                else:
                    path.write_bytes(path.read_bytes()[:-1] + (b"x" if damage == "change" else b""))

    remove = failpoints.install_hook(hook)
    result = scene.move(task, old)
    remove()
    assert (result.outcome, result.located) == (Outcome.FAILED, old)
    what = "no state of keeper is kept here" if damage == "remove" else "did not arrive as it was saved"
    assert what in result.error
    assert scene.talk(old, "save") == f"{SECRET}\n"
    assert not scene.spools()


def test_an_instance_that_dies_in_its_save_fails_the_move(scene: Scene) -> None:
    task = scene.task(save=Check(command="kill -KILL $EDGECTL_PID; sleep 0.2; exit 1"))
    old = scene.running(task)
    result = scene.move(task, old)
    assert (result.outcome, list_phases(result)) == (Outcome.FAILED, [Phase.SAVE])
    assert not scene.spools()


POINTS = [
    "save-state sent", "save-state acknowledged", "write-state sent", "read-state sent",
    "read-state acknowledged", "write-state acknowledged", "stop sent", "stop acknowledged", "start sent",
    "start acknowledged", "load-state sent", "load-state acknowledged", "drop-state sent",
    "drop-state acknowledged",
]  # fmt: skip


@pytest.mark.parametrize("point", POINTS)
def test_after_a_manager_that_dies_the_next_apply_runs_one_instance_and_removes_what_is_left(
    scene: Scene, point: str
) -> None:
    task = scene.task()
    old = scene.running(task)
    died: list[str] = []

    def die(reached: str) -> None:
        if reached == point and not died:
            died.append(point)
            raise ManagerKilledError

    remove = failpoints.install_hook(die)
    with suppress(ManagerKilledError):
        scene.move(task, old)
    remove()
    assert died
    scene.apply(exclude_host(task, old))
    where = scene.bench.where()
    assert list(where.values()) == [({"edge1", "edge2"} - {old}).pop()]
    assert not scene.spools()
    assert not scene.written()
    stopped = POINTS.index(point) in range(
        POINTS.index("stop acknowledged"), POINTS.index("load-state acknowledged")
    )
    memory = scene.talk(where["keeper"], "save")
    assert memory == f"{SECRET}\n" or (stopped and not memory)


def test_a_state_is_removed_also_where_the_next_plan_changes_nothing(scene: Scene) -> None:
    task = scene.task()
    old = scene.running(task)

    def die(reached: str) -> None:
        if reached == "stop sent":
            raise ManagerKilledError

    remove = failpoints.install_hook(die)
    with suppress(ManagerKilledError):
        scene.move(task, old)
    remove()
    assert len(scene.spools()) == 2
    assert scene.apply(task) is None
    assert not scene.spools()
    assert scene.talk(old, "save") == f"{SECRET}\n"


@contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """Mount a disk of 2 MB on ``folder``."""
    folder.mkdir(mode=0o700, parents=True)
    folder.parent.chmod(0o700)
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m,mode=700", "disk", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root")
def test_disk_that_is_full(scene: Scene) -> None:
    """On the new host before anything is stopped, then on the old one in the midst of the save."""
    task = scene.task()
    assert task.state is not None
    large = Check(command=f"{scene.words('save')}; exec head -c 3000000 /dev/zero")
    big = replace(task, state=replace(task.state, save=large))
    old = scene.running(task)
    new = ({"edge1", "edge2"} - {old}).pop()
    home = next(scene.hosts.rglob(f"agent-state/*/hosts/{old}")).parent
    with small_disk(home / new / "tasks"):
        result = scene.move(big, old)
        assert (result.outcome, result.located) == (Outcome.FAILED, old)
        assert (result.error, result.hint) == ("the host is out of disk space", "free some space there")
        assert list_phases(result) == [Phase.SAVE, Phase.TRANSFER]
        assert not scene.spools()
        assert scene.move(task, old).outcome is Outcome.DONE
        result = scene.move(big, new)
        assert (result.outcome, result.located) == (Outcome.FAILED, new)
        assert (result.error, list_phases(result)) == ("the host is out of disk space", [Phase.SAVE])
        assert not scene.spools()
        assert scene.talk(new, "save") == f"{SECRET}\n"
        assert scene.bench.where() == {"keeper": new}


def a_warm(scene: Scene, **state: object) -> Task:
    """The task with a copy on the other host; it says in a file of its host that it is active."""
    task, place = scene.task(**state), f"{shlex.quote(str(scene.folder))}/active-$EDGECTL_HOST"  # type: ignore[arg-type]
    rule = StandbyRule(
        activation=Activation(
            activate=Check(command=f"touch {place}"), deactivate=Check(command=f"rm -f {place}")
        )
    )
    return replace(task, standby=rule)


@pytest.mark.parametrize("moment", SaveMoment)
def test_a_warm_move_hands_the_memory_to_the_copy(scene: Scene, moment: SaveMoment) -> None:
    task = a_warm(scene, moment=moment)
    old = scene.running(task)
    new = ({"edge1", "edge2"} - {old}).pop()
    result = scene.move(task, old)
    assert result.outcome is Outcome.DONE, result
    order = [phase for phase in list_phases(result) if phase not in (Phase.STANDBY, Phase.STOP)]
    carry = [Phase.SAVE, Phase.TRANSFER, Phase.LOAD]
    early = moment is SaveMoment.ACTIVE
    assert order == [
        *(carry if early else []), Phase.DEACTIVATE, *([] if early else carry), Phase.ACTIVATE, Phase.READY,
    ]  # fmt: skip
    assert scene.talk(new, "save") == f"{SECRET}\n"
    assert [(scene.folder / f"active-{host}").exists() for host in (old, new)] == [False, True]
    assert result.state is not None
    assert not scene.spools()


@pytest.mark.parametrize("moment", SaveMoment)
@pytest.mark.parametrize("failing", ["save", "load"])
def test_a_warm_move_that_cannot_carry_the_memory_leaves_the_old_one_active(
    scene: Scene, moment: SaveMoment, failing: str
) -> None:
    task = a_warm(scene, moment=moment, **{failing: Check(command="exit 9", timeout=patience(2.0))})
    old = scene.running(task)
    before = scene.bench.using(task).sample("keeper").instance
    result = scene.move(task, old)
    assert (result.outcome, result.located) == (Outcome.FAILED, old)
    assert f"{failing} of keeper failed: exit code 9" in result.error
    assert scene.bench.using(task).sample("keeper").instance == before
    assert scene.talk(old, "save") == f"{SECRET}\n"
    assert [(scene.folder / f"active-{host}").exists() for host in sorted(["edge1", "edge2"])] == [
        host == old for host in sorted(["edge1", "edge2"])
    ]
    assert not scene.spools()


def die_in_a_warm_move(scene: Scene, task: Task, old: str, point: str) -> None:
    """Move the task away from ``old`` with a manager that dies at ``point``."""

    def die(reached: str) -> None:
        if reached == point:
            raise ManagerKilledError

    remove = failpoints.install_hook(die)
    with suppress(ManagerKilledError):
        scene.move(task, old)
    remove()
    assert not list(scene.folder.glob("active-*"))


@pytest.mark.parametrize(
    "point", ["deactivate acknowledged", "read-state sent", "load-state sent", "load-state acknowledged"]
)
@pytest.mark.parametrize("leaves", [True, False], ids=["old host excluded", "old host allowed"])
def test_the_memory_outlives_a_manager_that_dies_while_no_instance_is_active(
    scene: Scene, point: str, leaves: bool
) -> None:
    """It is in the instance that was active last. That one is active again, or hands it over after all."""
    task = a_warm(scene)
    old = scene.running(task)
    new = ({"edge1", "edge2"} - {old}).pop()
    die_in_a_warm_move(scene, task, old, point)
    result = scene.apply(exclude_host(task, old) if leaves else task)
    assert result is not None
    where = new if leaves else old
    assert (result.outcome, result.located) == (Outcome.DONE, where), result
    carry = [Phase.SAVE, Phase.TRANSFER, Phase.LOAD] if leaves else []
    assert list_phases(result) == [*carry, Phase.ACTIVATE, Phase.READY]
    assert (result.state is not None) is leaves
    assert scene.talk(where, "save") == f"{SECRET}\n"
    assert [path.name for path in scene.folder.glob("active-*")] == [f"active-{where}"]
    assert scene.bench.where() == {"keeper": where}
    assert not scene.spools()


@pytest.mark.parametrize("failing", ["save", "load"])
def test_a_task_without_an_active_instance_starts_also_where_its_memory_cannot_come_along(
    scene: Scene, failing: str
) -> None:
    """Nobody serves meanwhile; and a copy that has taken in a part of it is started anew."""
    task = a_warm(scene)
    old = scene.running(task)
    die_in_a_warm_move(scene, task, old, "deactivate acknowledged")
    broken = a_warm(scene, **{failing: Check(command="exit 9", timeout=patience(2.0))})
    result = scene.apply(exclude_host(broken, old))
    assert result is not None
    new = ({"edge1", "edge2"} - {old}).pop()
    assert (result.outcome, result.located) == (Outcome.DONE, new), result
    lost = [phase.detail for phase in result.phases if not phase.ok]
    assert lost == [f"{failing} of keeper failed: exit code 9"]
    assert list_phases(result)[-2:] == [
        Phase.ACTIVATE if failing == "save" else Phase.START, Phase.READY,
    ]  # fmt: skip
    assert scene.talk(new, "save") == ""
    assert [path.name for path in scene.folder.glob("active-*")] == [f"active-{new}"]
    assert not scene.spools()
