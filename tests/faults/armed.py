"""Runs in place of edgectl: the very same command, with the named points of its code (`edgectl.state.failpoints`) noted and one of them deadly.

``python -P -c PROGRAM NUMBER NOTES WORDS...``: at the NUMBER-th point that it reaches, the process is ended with SIGKILL. Nothing in the
product can be armed from outside; this is another program, which imports it.
"""

import sys
from pathlib import Path

PROGRAM = """
import os, signal, sys
from edgectl.cli.main import main
from edgectl.state import points

deadly, notes = int(sys.argv[1]), open(sys.argv[2], "a", buffering=1)
reached = []

def hook(point):
    reached.append(point)
    notes.write(point + chr(10))
    if len(reached) == deadly:
        os.kill(os.getpid(), signal.SIGKILL)

points.install(hook)
sys.exit(main(sys.argv[3:]))
"""


def line(notes: Path, deadly: int) -> list[str]:
    """What stands in place of the word ``edgectl`` on a command line; 0: no point is deadly."""
    return [sys.executable, "-P", "-c", PROGRAM, str(deadly), str(notes)]


def reached(notes: Path) -> list[str]:
    """The points that were reached, in order."""
    return notes.read_text().splitlines() if notes.exists() else []
