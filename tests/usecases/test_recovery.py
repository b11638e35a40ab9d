"""The manager dies at every named point of an apply; the next plain apply ends with exactly one instance of each task."""

import contextlib
import dataclasses
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.errors import ConnectError, RefusedError
from edgectl.model.policy import Policy
from edgectl.model.task import Check, CheckLocation, HandoffContract, HandoffOrder, Task, Tasks
from edgectl.state import failpoints
from edgectl.state.journal_reader import read_journal
from edgectl.transport.fake import FakeTransport
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from edgectl.views.plan_sections import render_plan_notes
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


class Died(BaseException):
    """The manager was killed: nothing of its own handles this."""


@dataclasses.dataclass
class Scene:
    """A fleet just before the apply that is cut off."""

    hosts: FakeFleet
    fleet: Fleet
    tasks: Tasks

    @property
    def ready(self) -> Fleet:
        return dataclasses.replace(self.fleet, tasks=self.tasks)


def a_scene(state: Path, *tasks: Task) -> Scene:
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
    return Scene(hosts, fleet, some_tasks(*tasks) if tasks else fleet.tasks)


def starting(state: Path) -> Scene:
    return a_scene(state)


def _running(state: Path, *tasks: Task) -> Scene:
    scene = a_scene(state, *tasks)
    plan_and_apply(scene.fleet, POLICY, options=ONE_BY_ONE)
    return scene


def moving(state: Path) -> Scene:
    return _running(
        state, dataclasses.replace(SLAM, hosts=dataclasses.replace(SLAM.hosts, never=("edge1",))), NAVIGATION
    )


def overlapping(state: Path) -> Scene:
    order = dataclasses.replace(HOOKS, order=HandoffOrder.START_FIRST)
    task = dataclasses.replace(SLAM, hosts=dataclasses.replace(SLAM.hosts, never=("edge1",)), handoff=order)
    return _running(state, task, NAVIGATION)


def restarting(state: Path) -> Scene:
    return _running(state, dataclasses.replace(SLAM, spec_hash="changed"), NAVIGATION)


def draining(state: Path) -> Scene:
    scene = _running(state)
    operator_marks.cordon_hosts(scene.fleet, ["edge1"], drain=True)
    return scene


def leaving(state: Path) -> Scene:
    return _running(state, SLAM)


def completing(state: Path) -> Scene:
    scene = _running(state)
    operator_marks.mark_tasks_done(scene.fleet, ["navigation"])
    return scene


SCENES: list[Callable[[Path], Scene]] = [
    starting,
    moving,
    overlapping,
    restarting,
    draining,
    leaving,
    completing,
]


def points_of(scene: Scene) -> list[str]:
    """Every point that the apply of ``scene`` comes to."""
    seen: list[str] = []
    remove = failpoints.install_hook(seen.append)
    try:
        plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    finally:
        remove()
    return seen


def cut_off(scene: Scene, number: int) -> None:
    """Apply, and die at the ``number``-th point."""
    left = [number]

    def die(_point: str) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise Died

    remove = failpoints.install_hook(die)
    try:
        with pytest.raises(Died):
            plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    finally:
        remove()


def converged(scene: Scene, expected: dict[str, str]) -> None:
    """One plain apply, and everything is as it should be."""
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
def test_death_at_every_point_is_mended_by_one_apply(make: Callable[[Path], Scene], tmp_path: Path) -> None:
    whole = make(tmp_path / "whole")
    names = points_of(whole)
    assert len(names) > 15
    for number in range(len(names)):
        scene = make(tmp_path / str(number))
        cut_off(scene, number)
        converged(scene, whole.hosts.placed)
        assert make is overlapping or not scene.hosts.world.overlap, names[number]


def test_death_during_recovery_is_mended_too(tmp_path: Path) -> None:
    chance = random.Random(7)
    for number in range(60):
        make = chance.choice(SCENES)
        whole = make(tmp_path / f"whole{number}")
        length = len(points_of(whole))
        scene = make(tmp_path / str(number))
        cut_off(scene, chance.randrange(length))
        with contextlib.suppress(pytest.fail.Exception):  # the recovery may have fewer points
            cut_off(scene, chance.randrange(length))
        converged(scene, whole.hosts.placed)


def _failing(scene: Scene) -> None:
    """From now on nothing gets ready anywhere."""
    scene.hosts["edge2"].faults["wait:slam"] = lambda _request: {"state": "failed", "exit_code": 3}
    scene.hosts["edge1"].faults["start:slam"] = RefusedError("disk is full")


def _releases(scene: Scene) -> int:
    return scene.hosts.world.events.count("check release robot1")


@pytest.mark.parametrize("killed", [False, True])
def test_a_robot_holds_until_an_instance_is_ready(killed: bool, tmp_path: Path) -> None:
    """Neither the new nor the old instance gets ready; the manager may die then, too. The apply that gets one ready releases the robot."""
    scene = moving(tmp_path / "state")
    said: list[str] = []
    scene.fleet = dataclasses.replace(scene.fleet, warn=said.append)
    _failing(scene)
    if killed:
        cut_off(scene, points_of(moving(tmp_path / "whole")).index("stop acknowledged") + 1)
    else:
        (failed,) = (
            result
            for result in plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE).results.actions
            if result.task == "slam"
        )  # type: ignore[union-attr]
        assert "robot1 STILL HOLDS" in failed.error
    assert _releases(scene) == 0
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert _releases(scene) == 0
    assert any("robot1 STILL HOLDS: no instance of slam is ready" in text for text in said)
    scene.hosts["edge1"].faults.clear()
    scene.hosts["edge2"].faults.clear()
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert _releases(scene) == 1
    assert "slam" in scene.hosts.placed
    converged(scene, {"slam": "", "navigation": ""})
    assert _releases(scene) == 1


def test_a_robot_that_steers_itself_ready_is_asked(tmp_path: Path) -> None:
    """The manager died between the start and the robot's yes: the check is asked again, the instance marked, the robot released."""
    ready = dataclasses.replace(SLAM, ready=Check(command="sees", on=CheckLocation.ROBOT, timeout=1.0))
    scene = _running(tmp_path / "state", dataclasses.replace(ready, spec_hash="changed"), NAVIGATION)
    names = points_of(
        _running(tmp_path / "whole", dataclasses.replace(ready, spec_hash="changed"), NAVIGATION)
    )
    cut_off(scene, len(names) - 1 - names[::-1].index("start acknowledged"))
    before = _releases(scene)
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert scene.hosts.world.events[-3:] == ["check sees robot1", "mark slam edge1", "check release robot1"]
    assert _releases(scene) == before + 1


def test_a_plan_shows_what_the_last_apply_deferred(tmp_path: Path) -> None:
    waiting = dataclasses.replace(HOOKS, safe_when=Check(command="safe", on=CheckLocation.ROBOT), timeout=0.0)
    task = dataclasses.replace(SLAM, hosts=dataclasses.replace(SLAM.hosts, never=("edge1",)), handoff=waiting)
    scene = _running(tmp_path / "state", task, NAVIGATION)
    scene.hosts["robot1"].checks["safe"] = 1
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    shown = make_plan(scene.ready, POLICY)
    assert (
        "slam: deferred by the last apply, unchanged: not safe to move slam within 0 s"
        in render_plan_notes(shown)
    )
    scene.hosts["robot1"].checks["safe"] = 0
    plan_and_apply(scene.ready, POLICY, options=ONE_BY_ONE)
    assert "put off" not in render_plan_notes(make_plan(scene.ready, POLICY))


@pytest.mark.parametrize("make", SCENES, ids=lambda make: make.__name__)
@pytest.mark.parametrize("late", [False, True], ids=["request lost", "answer lost"])
def test_a_link_cut_at_every_request_is_mended_by_one_apply(
    make: Callable[[Path], Scene], late: bool, tmp_path: Path
) -> None:
    """From the k-th request on the host it goes to is silent until the apply has ended; the request itself may have arrived."""
    whole = make(tmp_path / "whole")
    plan_and_apply(whole.ready, POLICY, options=ONE_BY_ONE)
    for number in range(30):
        scene = make(tmp_path / str(number))
        counted = [0]

        def cutting(host: str, scene: Scene = scene, counted: list[int] = counted, number: int = number):  # noqa: ANN202
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
        scene.hosts.down.clear()
        converged(scene, whole.hosts.placed)
        assert make is overlapping or not scene.hosts.world.overlap
