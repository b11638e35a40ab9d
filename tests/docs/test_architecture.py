# SPDX-License-Identifier: Apache-2.0
"""Pages for maintainers against the tree: rooms, functions of the walks, make targets."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.docs.worked_patch import ROOT
from tests.test_rooms import ALLOWED, PURE

ARCHITECTURE = ROOT / "docs" / "architecture.md"
PAGES = [
    ROOT / "CONTRIBUTING.md",
    ARCHITECTURE,
    ROOT / "docs" / "glossary.md",
    *sorted((ROOT / "docs" / "contributing").glob("*.md")),
]
WALKS = ("Snapshot to table", "Command to exec", "Demand to term", "/proc to ledger", "YAML fault to message")
_REFERENCE = re.compile(r"`((?:[a-z_]+/)*[a-z_]+\.py):([\w.]+)`")
_FILE = re.compile(r"`((?:edgectl|tests|docs)/[\w/.-]+)`")


@cache
def list_definitions(path: Path) -> frozenset[str]:
    """Names defined at the top of a module, and ``Class.method``."""
    names: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.ClassDef):
            names |= {
                node.name,
                *(f"{node.name}.{each.name}" for each in node.body if isinstance(each, ast.FunctionDef)),
            }
        elif isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
    return frozenset(names)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_functions_that_a_page_names_exist(page: Path) -> None:
    missing = [
        f"{path}:{name}"
        for path, name in _REFERENCE.findall(page.read_text())
        if not (ROOT / "edgectl" / path).is_file() or name not in list_definitions(ROOT / "edgectl" / path)
    ]
    assert missing == []


def test_files_that_the_pages_name_exist() -> None:
    created = {
        path
        for patch in (ROOT / "docs" / "contributing").glob("*.patch")
        for path in re.findall(r"^--- /dev/null\n\+\+\+ b/(\S+)$", patch.read_text(), re.MULTILINE)
    }
    missing = [
        f"{page.name}: {path}"
        for page in PAGES
        for path in _FILE.findall(page.read_text())
        if path not in created and not (ROOT / path).exists()
    ]
    assert missing == []


def test_modules_of_the_glossary_exist() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text()
    modules = re.findall(r"`((?:[a-z_]+/)+[a-z_]+\.py)`", text)
    assert [path for path in modules if not (ROOT / "edgectl" / path).exists()] == []


def test_the_table_of_rooms_is_the_enforced_one() -> None:
    rows = re.findall(r"^\| `(\w+)` \| .*? \| (.+) \|$", ARCHITECTURE.read_text(), re.MULTILINE)
    stated = {
        room: {*re.findall(r"`(\w+)`", imports), *(PURE if "basics" in imports else ())}
        for room, imports in rows
    }
    assert stated == ALLOWED


def test_every_walk_has_its_steps() -> None:
    text = ARCHITECTURE.read_text()
    for walk in WALKS:
        section = text.split(f"### {walk}\n", 1)[1].split("\n#", 1)[0]
        steps = re.findall(r"^\d+\. (.*)$", section, re.MULTILINE)
        assert len(steps) >= 9, walk
        assert all(_REFERENCE.search(step) for step in steps), walk


def test_every_make_target_is_described() -> None:
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    described = re.findall(r"^\| `make ([a-z-]+)` \|", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE)
    assert set(described) == targets
