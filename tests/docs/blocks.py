# SPDX-License-Identifier: Apache-2.0
"""Fenced command blocks of a Markdown page, and how to run them in a scaffold.

``console`` blocks: the lines that begin with ``$ ``. ``sh`` blocks: every line. A block that cannot run stands right after
``<!-- not run: REASON -->``; one whose output is compared, after ``<!-- exact -->``.
"""

import contextlib
import os
import re
import shlex
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.cli.inprocess import edgectl
from tests.leftovers import end_started_in, list_started_in
from tests.pace import patience

# Characters with a meaning to the shell.
_SHELL = re.compile(r"[|&;<>$`\\*?{}~]")
_BLOCK = re.compile(
    r"(?:<!-- (?P<mark>[^>]*?) -->\n)?^```(?P<kind>console|sh)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)


@dataclass(frozen=True, slots=True)
class Block:
    """One block: its commands with the output shown below each, and the line on which it begins."""

    line: int
    commands: tuple[tuple[str, str], ...]
    exact: bool
    skipped: str

    @property
    def plain(self) -> list[list[str]]:
        """The words of each command, or nothing if any of them needs a shell."""
        words = [
            shlex.split(command, comments=True) for command, _ in self.commands if not _SHELL.search(command)
        ]
        return (
            words
            if len(words) == len(self.commands) and all(each[:1] == ["edgectl"] for each in words)
            else []
        )


def blocks(path: Path) -> list[Block]:
    """The command blocks of a page."""
    text = path.read_text()
    return [_block(match, text) for match in _BLOCK.finditer(text)]


def _block(match: re.Match[str], text: str) -> Block:
    mark = match["mark"] or ""
    commands = (
        _console(match["text"])
        if match["kind"] == "console"
        else [(line, "") for line in match["text"].splitlines() if line.strip()]
    )
    skipped = mark.removeprefix("not run: ") if mark.startswith("not run: ") else ""
    return Block(text.count("\n", 0, match.start()) + 1, tuple(commands), mark == "exact", skipped)


def _console(text: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for line in text.splitlines(keepends=True):
        if line.startswith("$ "):
            found.append((line[2:].rstrip("\n"), ""))
        elif found:
            found[-1] = (found[-1][0], found[-1][1] + line)
    return found


def environment(state: Path) -> dict[str, str]:
    """As a reader's shell, with edgectl on PATH and a state directory of its own."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    return {**os.environ, "PATH": path, "EDGECTL_STATE_DIR": str(state)}


def make_tasks_idle(site: Path) -> None:
    """Let the tasks of a scaffold use no CPU: what commands do with them is the same, and the suite is shorter."""
    file = site / "tasks" / "demo.yaml"
    text, count = re.subn(r"--cpu [0-9.]+", "--cpu 0", file.read_text())
    assert count >= 6, "every task states its CPU"
    file.write_text(text)


@contextlib.contextmanager
def stopped(env: Mapping[str, str], *sites: Path) -> Iterator[None]:
    """Finally stop everything that was started in ``sites`` and in the fleets that were made below them, and check
    that no process of it is left; one that is, is killed.

    Local hosts keep what they started in the state directory of the manager.
    """
    state = [Path(env["EDGECTL_STATE_DIR"])]
    try:
        yield
    finally:
        made = {folder.parent for site in sites for folder in site.rglob("inventories")}
        for words in (["stop", "--all", "--yes"], ["profilers", "stop"]):
            for site in (*sites, *sorted(made.difference(sites))):
                if list_started_in(state):
                    edgectl(words, site, env)
        deadline = time.monotonic() + patience(10)
        while list_started_in(state) and time.monotonic() < deadline:
            time.sleep(0.05)
        left = end_started_in(state)
        assert not left, f"were still running: {left}"
