# SPDX-License-Identifier: Apache-2.0
"""edgectl that is killed, or stopped for a while, at a given failpoint, as a command line.

``python -P -c PROGRAM NUMBER SIGNAL LOG WORDS...``: appends each failpoint that is hit (`edgectl.state.failpoints`)
to LOG, and sends its own process SIGNAL at the NUMBER-th one: SIGKILL ends it; SIGSTOP holds it there, so that
something else can be broken at this very point. No option or variable of edgectl can do this;
the program imports edgectl and installs a hook.
"""

import signal
import sys
from pathlib import Path

PROGRAM = """
import os, sys
from edgectl.cli.main import main
from edgectl.state import failpoints

strike_at, number, log = int(sys.argv[1]), int(sys.argv[2]), open(sys.argv[3], "a", buffering=1)
hit = []

def hook(point):
    hit.append(point)
    log.write(point + chr(10))
    if len(hit) == strike_at:
        os.kill(os.getpid(), number)

failpoints.install_hook(hook)
sys.exit(main(sys.argv[4:]))
"""


def build_command(log: Path, strike_at: int, number: signal.Signals) -> list[str]:
    """Build the command line that replaces ``edgectl``; 0: it gets the signal at no failpoint."""
    return [sys.executable, "-P", "-c", PROGRAM, str(strike_at), str(int(number)), str(log)]


def read_failpoints(log: Path) -> list[str]:
    """Read the failpoints that were hit, in order."""
    return log.read_text().splitlines() if log.exists() else []
