# SPDX-License-Identifier: Apache-2.0
"""docs/cli.md, made from the command itself: ``python -m tests.docs.reference`` writes it."""

import os
from pathlib import Path

from edgectl.cli.app import COMMANDS
from tests.cli.inprocess import edgectl

PAGE = Path(__file__).parents[2] / "docs" / "cli.md"
HEAD = """# Command line

Made from the command itself; a test keeps it current. All commands take `-h`. Data goes to standard output, everything else to
standard error; piped output has no colour, no borders and is never cut.

| exit code | meaning |
|---:|---|
| 0 | done, or nothing to do |
| 1 | failed |
| 2 | changes are pending (only with `--detailed-exitcode`) |
| 3 | some task is unplaced (only with `--detailed-exitcode`; beats 2) |
| 4 | partly: a host that should answer did not, an action failed or was deferred, a mission of an experiment or a simulation did not end (beats 3) |
| 64 | the call or a file is wrong |
| 75 | another edgectl holds the fleet, its etcd or the ROS master does not answer, or the saved plan is stale: try again |
| 130 | interrupted |

"""


def page() -> str:
    """The page as it should stand."""
    return HEAD + "\n".join(_section(words) for words in ([], *(name.split() for name in COMMANDS)))


def help_of(words: list[str]) -> str:
    """What ``edgectl WORDS --help`` prints in a pipe, 80 columns wide."""
    said = edgectl([*words, "--help"], Path.cwd(), {**os.environ, "COLUMNS": "80"})
    assert said.code == 0, said.err
    return said.out


def _section(words: list[str]) -> str:
    return f"## {' '.join(['edgectl', *words])}\n\n```text\n{help_of(words)}```\n"


if __name__ == "__main__":
    PAGE.write_text(page())
