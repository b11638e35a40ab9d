# SPDX-License-Identifier: Apache-2.0
"""Worked patches of docs/contributing: a copy of the tree with a patch applied, and the commands of its page."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.docs.blocks import blocks

ROOT = Path(__file__).parents[2]
# What the copy needs to run edgectl, its tests and the linter.
_COPIED = (
    "edgectl",
    "tests",
    "docs",
    "inventories",
    "tasks",
    "README.md",
    "CONTRIBUTING.md",
    "pyproject.toml",
)
_CHANGED_FILE = re.compile(r"^\+\+\+ b/(\S+)$", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchedTree:
    """A copy of the tree at ``root`` in which the files ``changed`` (paths within it) are patched."""

    root: Path
    changed: tuple[str, ...]

    def build_environment(self, state: Path) -> dict[str, str]:
        """The environment in which ``edgectl`` and ``python`` are those of the copy."""
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
        return {
            **os.environ,
            "PATH": path,
            "PYTHONPATH": str(self.root),
            "EDGECTL_STATE_DIR": str(state),
            "COLUMNS": "100",
        }


def copy_with_patch(patch: Path, folder: Path) -> PatchedTree:
    """The tree in ``folder``, patched. Compiled code is copied too: only what changed is compiled again."""
    for name in _COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, symlinks=True)
        else:
            shutil.copy2(source, folder / name)
    run_in(
        folder, ["git", "apply", str(patch)], {**os.environ, "GIT_CEILING_DIRECTORIES": str(folder.parent)}
    )
    return PatchedTree(root=folder, changed=tuple(_CHANGED_FILE.findall(patch.read_text())))


def run_in(folder: Path, command: Sequence[str], env: Mapping[str, str]) -> str:
    """The output of a command that must succeed."""
    done = subprocess.run(
        command,
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        check=False,
        timeout=240,
    )
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    return done.stdout


def run_page_commands(page: Path, folder: Path, env: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """(command, output shown, output printed) of each command of a page, run in order in ``folder``.

    Both outputs of a command count, and its exit code does not: pages also show errors.
    """
    found = []
    for block in blocks(page):
        for command, shown in block.commands:
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=folder,
                env=env,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                stdin=subprocess.DEVNULL,
                check=False,
                timeout=120,
            )
            found.append((command, shown, done.stdout))
    return found
