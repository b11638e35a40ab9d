"""drain and rollback die at every named point; the same command again, or a plain apply, ends with exactly one instance of each task."""

from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.state import failpoints
from edgectl.state.journal_reader import read_journal
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.drain import drain_hosts
from edgectl.usecases.history import roll_back_fleet
from edgectl.usecases.plan import make_plan
from tests.usecases.test_recovery import ONE_BY_ONE, POLICY, Died, Scene, _running

Verb = Callable[[Scene], object]


def drained(scene: Scene) -> object:
    return drain_hosts(
        scene.fleet, POLICY, ["edge1"], options=ONE_BY_ONE, timeout=5.0, pause=lambda _seconds: None
    )


def rolled_back(scene: Scene) -> object:
    return roll_back_fleet(scene.fleet, POLICY, 1, options=ONE_BY_ONE)


def on_edge1(state: Path) -> Scene:
    return _running(state)


def moved_away(state: Path) -> Scene:
    scene = _running(state)
    operator_marks.cordon_hosts(scene.fleet, ["edge1"], drain=True)
    plan_and_apply(scene.fleet, POLICY, options=ONE_BY_ONE)
    operator_marks.uncordon_hosts(scene.fleet, ["edge1"])
    return scene


def reached(scene: Scene, verb: Verb, die_at: int | None) -> list[str]:
    """The points that the verb comes to; it dies at one of them."""
    seen: list[str] = []

    def note(point: str) -> None:
        seen.append(point)
        if die_at is not None and len(seen) > die_at:
            raise Died

    remove = failpoints.install_hook(note)
    try:
        verb(scene)
    except Died:
        pass
    finally:
        remove()
    return seen


@pytest.mark.parametrize(
    ("make", "verb"), [(on_edge1, drained), (moved_away, rolled_back)], ids=["drain", "rollback"]
)
def test_death_at_every_point(make: Callable[[Path], Scene], verb: Verb, tmp_path: Path) -> None:
    whole = make(tmp_path / "whole")
    names = reached(whole, verb, None)
    assert len(names) > 20
    for number, name in enumerate(names):
        scene = make(tmp_path / str(number))
        reached(scene, verb, number)
        verb(scene)
        assert scene.hosts.placed == whole.hosts.placed, name
        assert not scene.hosts.world.overlap, name
        applied = plan_and_apply(scene.fleet, POLICY, options=ONE_BY_ONE)
        assert applied.results is None or applied.results.done
        counts = [task for host in scene.hosts.hosts.values() for task in host.tasks]
        assert sorted(counts) == sorted(set(counts)) == sorted(whole.hosts.placed), name
        assert not make_plan(scene.fleet, POLICY).changes, name
        log = read_journal(scene.fleet.state / "journal.jsonl")
        assert (log.broken, log.unfinished) == (0, ())
