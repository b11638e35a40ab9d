# SPDX-License-Identifier: Apache-2.0
"""Each "how to add" page of docs/contributing is followed: its patch applied to a copy of the tree, its tests and commands run."""

import sys
from pathlib import Path

import pytest

from edgectl.scaffold.write import write_scaffold
from tests.docs.worked_patch import ROOT, copy_with_patch, run_in, run_page_commands

PAGES = sorted((ROOT / "docs" / "contributing").glob("add-*.md"))
# A patch that touches more teaches that the tree is in the way.
MOST_FILES = 12


def test_every_page_has_a_patch() -> None:
    assert {page.stem for page in PAGES} >= {
        "add-a-command",
        "add-a-doctor-check",
        "add-a-file-key",
        "add-a-transport",
    }
    assert [page.name for page in PAGES if not page.with_suffix(".patch").exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_is_followed(page: Path, tmp_path: Path) -> None:
    tree = copy_with_patch(page.with_suffix(".patch"), tmp_path / "tree")
    env = tree.build_environment(tmp_path / "state")
    sources = [name for name in tree.changed if name.endswith(".py")]
    tests = [name for name in sources if Path(name).name.startswith("test_")]
    assert len(tree.changed) <= MOST_FILES
    assert tests, "a change is proven by a test"
    for path in tree.changed:
        assert path in page.read_text(), f"{page.name} does not mention {path}"
    run_in(tree.root, ["ruff", "check", "--no-cache", *sources], env)
    run_in(tree.root, ["ruff", "format", "--no-cache", "--check", *sources], env)
    run_in(tree.root, [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *tests], env)
    write_scaffold(tmp_path / "fleet")
    for command, shown, printed in run_page_commands(page, tmp_path / "fleet", env):
        assert printed == shown, f"{page.name}: {command}"
