# SPDX-License-Identifier: Apache-2.0
"""The order of a file changes neither values nor digests. Fields of execution change the spec hash, fields of
placement do not.
"""

import random
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.config.load import load_inventory_and_tasks
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from tests.config.broken_files import INVENTORY, TASKS


def shuffle_value(value: Any, chance: random.Random) -> Any:
    if isinstance(value, dict):
        keys = list(value)
        chance.shuffle(keys)
        return {key: shuffle_value(value[key], chance) for key in keys}
    return [shuffle_value(inner, chance) for inner in value] if isinstance(value, list) else value


def load_files(directory: Path, inventory: str, tasks: str) -> tuple[Inventory, Tasks]:
    (directory / "i.yaml").write_text(inventory)
    (directory / "t.yaml").write_text(tasks)
    return load_inventory_and_tasks(directory / "i.yaml", directory / "t.yaml")[:2]


@settings(max_examples=25)
@given(st.randoms(use_true_random=False))
def test_order_is_irrelevant(tmp_path: Path, chance: random.Random) -> None:
    expected = load_files(tmp_path, INVENTORY, TASKS)
    texts = [
        yaml.safe_dump(shuffle_value(yaml.safe_load(text), chance), sort_keys=False)
        for text in (INVENTORY, TASKS)
    ]
    got = load_files(tmp_path, *texts)
    assert got == expected
    assert list(got[0].hosts) == list(expected[0].hosts)
    assert list(got[1].tasks) == list(expected[1].tasks)


@pytest.mark.parametrize(
    ("old", "new", "inventory_changes", "tasks_change", "spec_changes"),
    [
        ("cpu: 500m", "cpu: 0.5", False, False, False),
        ("cpu: 500m", "cpu: 600m", False, True, False),
        ("priority: 1", "priority: 2", False, True, False),
        ("weights: all", "weights: cpu", False, True, False),
        ("nav.launch", "nav2.launch", False, True, True),
        ('env: {ROBOT: "{robot}"}', "env: {ROBOT: me}", False, True, True),
        ("stop: ros", "stop: {signal: INT, grace: 20s, preset: ros}", False, False, False),
        ("stop: ros", "stop: {grace: 5s}", False, True, True),
        ("# nothing", "# a comment", False, False, False),
        ("192.168.1.11", "192.168.1.12", True, False, False),
        ("throughput: 54Mbit/s", "throughput: 6.75MB/s", False, False, False),
    ],
)
def test_digests_follow_the_meaning(
    old: str, new: str, *, inventory_changes: bool, tasks_change: bool, spec_changes: bool, tmp_path: Path
) -> None:
    files = [INVENTORY, TASKS + "# nothing\n"]
    before = load_files(tmp_path, *files)
    after = load_files(tmp_path, *(text.replace(old, new, 1) for text in files))
    assert (before[0].digest != after[0].digest) is inventory_changes
    assert (before[1].digest != after[1].digest) is tasks_change
    name = "navigation-robot1"
    assert (before[1].tasks[name].spec_hash != after[1].tasks[name].spec_hash) is spec_changes
    assert before[0].digest.startswith("sha256:")
    assert len(before[1].tasks[name].spec_hash) == 16


def test_spec_hashes_differ_between_robots(tmp_path: Path) -> None:
    tasks = load_files(tmp_path, INVENTORY, TASKS)[1].tasks
    assert len({task.spec_hash for task in tasks.values()}) == len(tasks)
