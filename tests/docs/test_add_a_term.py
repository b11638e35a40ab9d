"""The worked patch of docs/contributing/add-a-term.md: it applies to the tree as it is, stays small, and its own test passes."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PATCH = ROOT / "docs/contributing/add-a-term.patch"
PAGE = ROOT / "docs/contributing/add-a-term.md"
MOST_FILES = 12
COPIED = ("edgectl", "tests", "docs", "pyproject.toml")


def changed_files() -> list[str]:
    return re.findall(r"^diff --git a/\S+ b/(\S+)$", PATCH.read_text(), flags=re.M)


def test_a_resource_costs_few_files_and_the_page_names_each() -> None:
    assert len(changed_files()) <= MOST_FILES
    assert set(re.findall(r"`((?:edgectl|docs|tests)/[\w./]+)`", PAGE.read_text())) >= set(changed_files())


@pytest.mark.slow
def test_the_patch_applies_and_its_test_passes(tmp_path: Path) -> None:
    for name in COPIED:
        source, ignore = ROOT / name, shutil.ignore_patterns("__pycache__", "*.svg")
        if source.is_dir():
            shutil.copytree(source, tmp_path / name, ignore=ignore)
        else:
            shutil.copy(source, tmp_path / name)
    # A repository of its own, so that git does not take the copy for an ignored folder of ours.
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    subprocess.run(["git", "apply", str(PATCH)], cwd=tmp_path, check=True)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/model/test_power.py"]
    ended = subprocess.run(
        command, cwd=tmp_path, env={"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin:/bin"},
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-1000:]
    assert "4 passed" in ended.stdout or re.search(r"\.{4}", ended.stdout)
