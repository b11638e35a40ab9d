# SPDX-License-Identifier: Apache-2.0
"""The manager dies at every failpoint of an apply; the next plain apply ends with exactly one instance of
each task.

At every failpoint by its name; at each of its occurrences, with ``--whole``, in ``make faults``.
"""

import contextlib
import dataclasses
import itertools
import random
import shutil
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from edgectl.errors import ConnectError, RefusedError
from edgectl.model.check import Check, CheckLocation
from edgectl.model.policy import Policy
from edgectl.model.task import HandoffContract, HandoffOrder, Task, Tasks
from edgectl.state import failpoints
from edgectl.state.journal_reader import read_journal
from edgectl.transport.fake import FakeTransport
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from edgectl.views.plan_sections import list_plan_notes
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet

POLICY = Policy(min_dwell=0.0)
ONE_BY_ONE = ApplyOptions(max_parallel=1)
HOOKS = HandoffContract(
    hold=Check(command="hold", on=CheckLocation.ROBOT),
    release=Check(command="release", on=CheckLocation.ROBOT),
)
SLAM = a_task("slam", cpu=0.5, robots=["robot1"], handoff=HOOKS, ready=Check(command="ready"))
NAVIGATION = a_task("navigation", cpu=0.5, needs=["slam"])


class ManagerKilledError(BaseException):
    """The manager was killed: no handler of the product catches this."""


@dataclasses.dataclass
class RecoveryScene:
    """A fleet just before the apply that is interrupted."""

    hosts: FakeFleet
    fleet: Fleet
    tasks: Tasks

    @property
    def ready(self) -> Fleet:
        return dataclasses.replace(self.fleet, tasks=self.tasks)

    def copy(self, state: Path) -> "RecoveryScene":
        """The same scene with hosts and a state of its own, in a third of the time that its preparation takes."""
        shutil.copytree(self.fleet.state, state)
        hosts = self.hosts.copy()
        fleet = dataclasses.replace(self.fleet, transport=hosts.transport, state=state)
        return RecoveryScene(hosts, fleet, self.tasks)


def build_scene(state: Path, *tasks: Task) -> RecoveryScene:
    hosts = FakeFleet.of(["edge1", "edge2", "robot1"])
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1"))
    state.mkdir(mode=0o700)
    fleet = Fleet(
        inventory=inventory,
        tasks=some_tasks(SLAM, NAVIGATION),
        transport=hosts.transport,
        state=state,
        clock=lambda: NOW + 5,
    )
    return RecoveryScene(hosts, fleet, some_tasks(*tasks) if tasks else fleet.tasks)


def prepare_start(state: Path) -> RecoveryScene:
    return build_scene(state)


def _start_tasks(state: Path, *tasks: Task) -> RecoveryScene:
    scene = build_scene(state, *tasks)
    plan_and_apply(scene.fleet, POLICY, options=ONE_BY_ONE)
    return scene


def prepare_move(state: Path) -> RecoveryScene:
    return _start_tasks(
        state, dataclasses.replace(SLAM, hosts=dataclasses.replace(SLAM.hosts, never=("edge1",))), NAVIGATION
    )


def prepare_start_first(state: Path) -> RecoveryScene:
    order = dataclasses.replace(HOOKS, order=HandoffOrder.START_FIRST)
    task = dataclasses.replace(SLAM, hosts=dataclasses.replace(SLAM.hosts, never=("edge1",)), handoff=order)
    return _start_tasks(state, task, NAVIGATION)


def prepare_restart(state: Path) -> RecoveryScene:
    return _start_tasks(state, dataclasses.replace(SLAM, spec_hash="changed"), NAVIGATION)


def prepare_drain(state: Path) -> RecoveryScene:
    scene = _start_tasks(state)
    operator_marks.cordon_hosts(scene.fleet, ["edge1"], drain=True)
    return scene


def prepare_removal(state: Path) -> RecoveryScene:
    return _start_tasks(state, SLAM)


def prepare_completion(state: Path) -> RecoveryScene:
    scene = _start_tasks(state)
    operator_marks.mark_tasks_done(scene.fleet, ["navigation"])
    return scene


SCENES: list[Callable[[Path], RecoveryScene]] = [
    prepare_start,
    prepare_move,
    prepare_start_first,
    prepare_restart,
    prepare_drain,
    prepare_removal,
    prepare_completion,
]


def list_failpoints(scene: RecoveryScene) -> list[str]:
    """Return every failpoint that the apply of ``scene`` hits."""
    seen: list[str] = []
    remove = failpoints.install_hook(seen.append)
    try:
        plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    finally:
        remove()
    return seen


def choose_failpoints(names: Sequence[str], scene: str, *, whole: bool) -> list[int]:
    """The positions of all ``names``, or one of each name: another one in another scene."""
    if whole:
        return [*range(len(names))]
    chance, places = random.Random(scene), defaultdict(list)
    for place, name in enumerate(names):
        places[name].append(place)
    return sorted(chance.choice(found) for found in places.values())


def interrupt_apply(scene: RecoveryScene, number: int) -> None:
    """Apply, and die at the ``number``-th failpoint."""
    left = [number]

    def die(_point: str) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise ManagerKilledError

    remove = failpoints.install_hook(die)
    try:
        with pytest.raises(ManagerKilledError):
            plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    finally:
        remove()


def apply_and_check(scene: RecoveryScene, expected: dict[str, str]) -> None:
    """Apply once and check that every task runs as expected."""
    applied = plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert applied.results is None or applied.results.done
    counts = [task for host in scene.hosts.hosts.values() for task in host.tasks]
    assert len(counts) == len(set(counts))
    assert scene.hosts.placed.keys() == expected.keys()
    assert not make_plan(scene.ready, POLICY).changes
    hooks = [event for event in scene.hosts.world.events if event.startswith("check")]
    assert not hooks or hooks[-1] == "check release robot1"
    log = read_journal(scene.fleet.state / "journal.jsonl")
    assert (log.broken, log.unfinished) == (0, ())


@pytest.mark.parametrize("make", SCENES, ids=lambda make: make.__name__)
def test_death_at_every_point_is_mended_by_one_apply(
    make: Callable[[Path], RecoveryScene], whole: bool, tmp_path: Path
) -> None:
    prepared = make(tmp_path / "prepared")
    uninterrupted = prepared.copy(tmp_path / "uninterrupted")
    names = list_failpoints(uninterrupted)
    assert len(set(names)) > 15
    for number in choose_failpoints(names, make.__name__, whole=whole):
        scene = prepared.copy(tmp_path / str(number))
        interrupt_apply(scene, number)
        apply_and_check(scene, uninterrupted.hosts.placed)
        assert make is prepare_start_first or not scene.hosts.world.overlap, names[number]


def test_death_during_recovery_is_mended_too(whole: bool, tmp_path: Path) -> None:
    chance = random.Random(7)
    prepared = {make: make(tmp_path / make.__name__) for make in SCENES}
    wholes = {make: scene.copy(tmp_path / f"whole {make.__name__}") for make, scene in prepared.items()}
    lengths = {make: len(list_failpoints(whole)) for make, whole in wholes.items()}
    for number in range(60 if whole else 20):
        make = chance.choice(SCENES)
        length = lengths[make]
        scene = prepared[make].copy(tmp_path / str(number))
        interrupt_apply(scene, chance.randrange(length))
        with contextlib.suppress(pytest.fail.Exception):  # the recovery may have fewer failpoints
            interrupt_apply(scene, chance.randrange(length))
        apply_and_check(scene, wholes[make].hosts.placed)


def _fail_starts(scene: RecoveryScene) -> None:
    """Make every instance fail to become ready."""
    scene.hosts["edge2"].faults["wait:slam"] = lambda _request: {"state": "failed", "exit_code": 3}
    scene.hosts["edge1"].faults["start:slam"] = RefusedError("disk is full")


def _count_releases(scene: RecoveryScene) -> int:
    return scene.hosts.world.events.count("check release robot1")


@pytest.mark.parametrize("killed", [False, True])
def test_a_robot_holds_until_an_instance_is_ready(killed: bool, tmp_path: Path) -> None:
    """Neither the new nor the old instance becomes ready; the manager may die then, too. The apply that gets
    one ready releases the robot.
    """
    scene = prepare_move(tmp_path / "state")
    said: list[str] = []
    scene.fleet = dataclasses.replace(scene.fleet, warn=said.append)
    _fail_starts(scene)
    if killed:
        interrupt_apply(
            scene, list_failpoints(prepare_move(tmp_path / "whole")).index("stop acknowledged") + 1
        )
    else:
        results = plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE).results
        assert results is not None
        (failed,) = (result for result in results.actions if result.task == "slam")
        assert "robot1 STILL HOLDS" in failed.error
    assert _count_releases(scene) == 0
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert _count_releases(scene) == 0
    assert any("robot1 STILL HOLDS: no instance of slam is ready" in text for text in said)
    scene.hosts["edge1"].faults.clear()
    scene.hosts["edge2"].faults.clear()
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert _count_releases(scene) == 1
    assert "slam" in scene.hosts.placed
    apply_and_check(scene, {"slam": "", "navigation": ""})
    assert _count_releases(scene) == 1


def test_a_robot_that_steers_itself_ready_is_asked(tmp_path: Path) -> None:
    """The manager died between the start and the robot's confirmation: the check is repeated, the instance
    marked, the robot released.
    """
    ready = dataclasses.replace(SLAM, ready=Check(command="sees", on=CheckLocation.ROBOT, timeout=1.0))
    scene = _start_tasks(tmp_path / "state", dataclasses.replace(ready, spec_hash="changed"), NAVIGATION)
    names = list_failpoints(
        _start_tasks(tmp_path / "whole", dataclasses.replace(ready, spec_hash="changed"), NAVIGATION)
    )
    interrupt_apply(scene, len(names) - 1 - names[::-1].index("start acknowledged"))
    before = _count_releases(scene)
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert scene.hosts.world.events[-3:] == ["check sees robot1", "mark slam edge1", "check release robot1"]
    assert _count_releases(scene) == before + 1


def test_a_plan_shows_what_the_last_apply_deferred(tmp_path: Path) -> None:
    waiting = dataclasses.replace(HOOKS, safe_when=Check(command="safe", on=CheckLocation.ROBOT), timeout=0.0)
    task = dataclasses.replace(SLAM, hosts=dataclasses.replace(SLAM.hosts, never=("edge1",)), handoff=waiting)
    scene = _start_tasks(tmp_path / "state", task, NAVIGATION)
    scene.hosts["robot1"].checks["safe"] = 1
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    shown = make_plan(scene.ready, POLICY)
    assert "slam: deferred by the last apply, unchanged: not safe to move slam within 0 s" in list_plan_notes(
        shown
    )
    scene.hosts["robot1"].checks["safe"] = 0
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert not any("deferred" in note for note in list_plan_notes(make_plan(scene.ready, POLICY)))


@pytest.mark.parametrize("make", SCENES, ids=lambda make: make.__name__)
@pytest.mark.parametrize("late", [False, True], ids=["request lost", "answer lost"])
def test_a_link_cut_at_every_request_is_mended_by_one_apply(
    make: Callable[[Path], RecoveryScene], late: bool, tmp_path: Path
) -> None:
    """From the k-th request on the target host is unreachable until the apply has ended; the request itself
    may have arrived.
    """
    prepared = make(tmp_path / "prepared")
    whole = prepared.copy(tmp_path / "whole")
    plan_and_apply(whole.ready, POLICY, options=ONE_BY_ONE)
    for number in itertools.count():
        scene = prepared.copy(tmp_path / str(number))
        counted = [0]

        def cutting(
            host: str, scene: RecoveryScene = scene, counted: list[int] = counted, number: int = number
        ) -> Callable[[dict[str, object]], dict[str, object]]:
            def answer(request: dict[str, object]) -> dict[str, object]:
                counted[0] += 1
                if host in scene.hosts.down:
                    raise ConnectError("silent")
                if counted[0] == number + 1:
                    scene.hosts.down.add(host)
                    if late:
                        scene.hosts[host](request)
                    raise ConnectError("cut")
                return scene.hosts[host](request)

            return answer

        cut = FakeTransport({name: cutting(name) for name in scene.hosts.hosts})
        plan_and_apply(dataclasses.replace(scene.ready, transport=cut), POLICY, options=ONE_BY_ONE)
        if not scene.hosts.down:
            assert number > 5, "every request was cut once"
            return
        scene.hosts.down.clear()
        apply_and_check(scene, whole.hosts.placed)
        assert make is prepare_start_first or not scene.hosts.world.overlap
