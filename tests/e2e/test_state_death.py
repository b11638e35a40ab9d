# SPDX-License-Identifier: Apache-2.0
"""Warm moves among three hosts whose manager, a process of its own, ends at once: no handler of it runs."""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.model.result import Outcome
from edgectl.state import failpoints
from tests.builders import an_edge, an_inventory
from tests.e2e.bench import a_local, open_bench
from tests.e2e.test_handoff import exclude_host
from tests.e2e.test_state import SECRET, Scene, a_warm

NAMES = ("zinc", "mint", "alder")


@pytest.fixture
def scene(tmp_path: Path, isolated: Path) -> Iterator[Scene]:
    edges = [a_local(an_edge(name), f"127.0.0.{number}") for number, name in enumerate(NAMES, 54)]
    with (
        tempfile.TemporaryDirectory(prefix="edgectl-state-") as short,
        open_bench(an_inventory(*edges), tmp_path / "manager", isolated) as bench,
    ):
        yield Scene(bench, Path(short), isolated)


def test_of_two_copies_and_the_old_instance_only_one_serves_and_has_the_memory(scene: Scene) -> None:
    warm = a_warm(scene)
    assert warm.standby is not None
    task = replace(warm, standby=replace(warm.standby, hosts=2))
    old = scene.running(task)
    manager = os.fork()
    if manager == 0:
        failpoints.install_hook(lambda reached: os._exit(9) if reached == "deactivate acknowledged" else None)
        scene.move(task, old)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(manager, 0)[1]) == 9, "it dies at the point"
    assert not list(scene.folder.glob("active-*"))
    result = scene.apply(exclude_host(task, old))
    assert result is not None
    assert result.outcome is Outcome.DONE, result
    new = str(result.located)
    assert new != old
    assert scene.talk(new, "save") == f"{SECRET}\n"
    assert [path.name for path in scene.folder.glob("active-*")] == [f"active-{new}"]
    assert not scene.spools()
