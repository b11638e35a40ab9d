# SPDX-License-Identifier: Apache-2.0
"""The documentation site: every page is in its navigation, and no link between pages is dead."""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.views.fixtures import ROOT

SITE = yaml.safe_load((ROOT / ".mkdocs.yml").read_text())
DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))
# What begins a link to another place than a page or a heading.
ELSEWHERE = ("http://", "https://", "mailto:")


def list_nav(entries: list[Any]) -> list[str]:
    found: list[str] = []
    for entry in entries:
        value = next(iter(entry.values())) if isinstance(entry, dict) else entry
        found += list_nav(value) if isinstance(value, list) else [value]
    return found


def list_anchors(page: Path) -> set[str]:
    """The anchors of the headings, as the table of contents makes them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    anchors: set[str] = set()
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        slug = re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", plain).strip().lower())
        number = 0
        while (anchor := slug if not number else f"{slug}_{number}") in anchors:
            number += 1
        anchors.add(anchor)
    return anchors


def test_every_page_is_in_the_navigation_once() -> None:
    listed = list_nav(SITE["nav"])
    assert len(listed) == len(set(listed))
    records = [page for page in PAGES if page.startswith("adr/") and page != "adr/README.md"]
    assert set(listed) == set(PAGES) - set(records)
    index = (DOCS / "adr" / "README.md").read_text()
    assert [page for page in records if f"({page.removeprefix('adr/')})" not in index] == []


def test_the_start_page_leads_to_every_page_of_the_four_parts() -> None:
    start = (DOCS / "index.md").read_text()
    inside = [
        page for page in list_nav(SITE["nav"][1:]) if not page.startswith(("contributing/add", "index"))
    ]
    assert [page for page in inside if f"({page})" not in start] == []


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", *(f"docs/{page}" for page in PAGES)])
def test_no_link_is_dead(name: str) -> None:
    page = ROOT / name
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    dead = []
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`", "", text)):
        if target.startswith(ELSEWHERE):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in list_anchors(file)):
            dead.append(target)
        elif name.startswith("docs/") and not file.resolve().is_relative_to(DOCS):
            dead.append(f"{target} (outside of the site)")
    assert dead == []


def test_the_site_is_built_where_its_program_is(tmp_path: Path) -> None:
    """make docs, strictly; in a copy, because it writes into the folder of its configuration."""
    program = Path(sys.executable).parent / "zensical"
    assert program.exists(), "run: make setup"
    shutil.copy(ROOT / ".mkdocs.yml", tmp_path / ".mkdocs.yml")
    shutil.copytree(DOCS, tmp_path / "docs")
    done = subprocess.run(
        [program, "build", "--strict", "-f", ".mkdocs.yml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    built = tmp_path / ".site"
    assert (built / "tutorial" / "index.html").exists()
    assert any(built.rglob("search*")), "there is a search"
