# SPDX-License-Identifier: Apache-2.0
"""Ids of task files: relative to the inventory, the same in every clone and from every working directory."""

from pathlib import Path

import pytest

from edgectl.config.load import identify_path, load_inventory_and_tasks

INVENTORY = "version: 1\nedges: {edge1: {host: a}}\n"
TASKS = "version: 1\ntasks: {NAME: {command: x}}\n"


def write_clone(root: Path) -> Path:
    for folder in ("inventories", "tasks"):
        (root / folder).mkdir(parents=True)
    (root / "inventories" / "lab.yaml").write_text(INVENTORY)
    for name in ("slam", "nav"):
        (root / "tasks" / f"{name}.yaml").write_text(TASKS.replace("NAME", name))
    return root


@pytest.mark.parametrize("clone", ["one", "other"])
def test_files_are_identified_relative_to_the_inventory(
    tmp_path: Path, clone: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write_clone(tmp_path / clone)
    monkeypatch.chdir(root / "tasks")
    _, tasks, _ = load_inventory_and_tasks("../inventories/lab.yaml", ["nav.yaml"])
    assert tasks.tasks["nav"].file == "../tasks/nav.yaml"
    assert tasks.files == {"../tasks/nav.yaml"}
    assert not tasks.folders


def test_a_directory_is_given_whole(tmp_path: Path) -> None:
    root = write_clone(tmp_path)
    _, tasks, _ = load_inventory_and_tasks(root / "inventories" / "lab.yaml", [root / "tasks"])
    assert tasks.folders == {"../tasks"}
    assert tasks.is_given("../tasks/deleted.yaml")
    assert not tasks.is_given("")


def test_the_digest_does_not_depend_on_the_file(tmp_path: Path) -> None:
    root = write_clone(tmp_path)
    lab, nav, moved = root / "inventories" / "lab.yaml", root / "tasks" / "nav.yaml", root / "moved.yaml"
    before = load_inventory_and_tasks(lab, [nav])[1].digest
    nav.rename(moved)
    assert load_inventory_and_tasks(lab, [moved])[1].digest == before


def test_a_path_too_long_for_a_record_is_known_by_its_digest(tmp_path: Path) -> None:
    assert identify_path(tmp_path / ("x" * 250), tmp_path).startswith("sha256:")
    assert identify_path(tmp_path / "é.yaml", tmp_path) == "é.yaml"
