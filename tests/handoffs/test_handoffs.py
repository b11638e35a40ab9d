# SPDX-License-Identifier: Apache-2.0
"""Warm moves of a real task: what its subscriber hears, step by step and fault by fault."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.model.result import Outcome, Phase
from tests.builders import an_edge, an_inventory
from tests.e2e.bench import a_local, open_bench
from tests.handoffs.scene import Scene, a_node_task
from tests.handoffs.subscriber import count_overlaps, list_gaps_ms, listen

ADDRESSES = {"edge1": "127.0.0.191", "edge2": "127.0.0.192"}


@pytest.fixture
def scene(tmp_path: Path, isolated: Path) -> Iterator[Scene]:
    inventory = an_inventory(*(a_local(an_edge(name), address) for name, address in ADDRESSES.items()))
    with (
        listen("127.0.0.193") as subscriber,
        open_bench(inventory, tmp_path / "manager", isolated) as bench,
    ):
        yield Scene(
            bench,
            tuple(ADDRESSES),
            a_node_task(tmp_path / "node", subscriber.address, subscriber.port),
            subscriber,
        )


def test_a_task_moves_by_activation_and_never_two_are_active(scene: Scene) -> None:
    scene.start()
    for _ in range(4):
        results = scene.move()
        (action,) = results.actions
        assert [phase.phase for phase in action.phases] == [Phase.DEACTIVATE, Phase.ACTIVATE, Phase.READY]
        assert action.outcome is Outcome.DONE
    messages = scene.subscriber.take()
    assert len(list_gaps_ms(messages)) == 4
    assert count_overlaps(messages, moves=4) == 0
