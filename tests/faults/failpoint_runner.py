# SPDX-License-Identifier: Apache-2.0
"""edgectl that is killed at a given failpoint, as a command line.

``python -P -c PROGRAM NUMBER LOG WORDS...``: appends each failpoint that is hit (`edgectl.state.failpoints`)
to LOG, and ends the process with SIGKILL at the NUMBER-th one. No option or variable of edgectl can do this;
the program imports edgectl and installs a hook.
"""

import sys
from pathlib import Path

PROGRAM = """
import os, signal, sys
from edgectl.cli.main import main
from edgectl.state import failpoints

kill_at, log = int(sys.argv[1]), open(sys.argv[2], "a", buffering=1)
hit = []

def hook(point):
    hit.append(point)
    log.write(point + chr(10))
    if len(hit) == kill_at:
        os.kill(os.getpid(), signal.SIGKILL)

failpoints.install_hook(hook)
sys.exit(main(sys.argv[3:]))
"""


def build_command(log: Path, kill_at: int) -> list[str]:
    """Build the command line that replaces ``edgectl``; 0: no failpoint kills."""
    return [sys.executable, "-P", "-c", PROGRAM, str(kill_at), str(log)]


def read_failpoints(log: Path) -> list[str]:
    """Read the failpoints that were hit, in order."""
    return log.read_text().splitlines() if log.exists() else []
