# SPDX-License-Identifier: Apache-2.0
"""Processes that were started in a directory of a test, and their end."""

import os
import signal
from contextlib import suppress
from pathlib import Path

_FORKED = b"\0tests.forkserver\0"


def list_started_in(places: list[Path]) -> list[int]:
    """List the processes with one of these directories in their environment or command line, without this one.

    A forked process has the environment and command line of the server; it is known by its working directory.
    """
    marks = [str(place).encode() for place in places]
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            known = (process / "environ").read_bytes() + b"\0" + (process / "cmdline").read_bytes() + b"\0"
            if _FORKED in known:
                known = (process / "cwd").readlink().as_posix().encode() + b"\0"
            if any(mark + end in known for mark in marks for end in (b"\0", b"/")):
                found.append(int(process.name))
    return [pid for pid in found if pid != os.getpid()]


def end_started_in(places: list[Path]) -> list[int]:
    """Kill every process that was started in one of these directories; return the pids."""
    ended = []
    for pid in list_started_in(places):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
            ended.append(pid)
    return ended
