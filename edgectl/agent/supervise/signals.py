# SPDX-License-Identifier: Apache-2.0
"""Signals to processes identified by pid and start ticks, by pidfd where the kernel has it, and the order of
signals of a stop.
"""

import _signal as signal
import os

from ..link.fast_json import Document
from ..measure import proc
from . import shell

_DEFAULT_GRACE_S = 20.0
# roslaunch gives its nodes 15 s after INT and 2 s after TERM, each in a session of its own.
_ROS_STEPS = (("INT", "main", 20.0), ("TERM", "tree", 5.0))


def parse_signal(name: str) -> int:
    """Parse ``TERM`` or ``SIGTERM``."""
    return int(getattr(signal, "SIG" + str(name).upper().replace("SIG", "", 1)))


def send_signal(pid: int, ticks: int, number: int) -> bool:
    """Signal the process that was seen as (pid, ticks). False where it is gone or belongs to another user."""
    fd = _open_pidfd(pid)
    try:
        # An open descriptor pins the process: if it is the right one now, it stays the right one.
        found = proc.is_process_alive(pid, ticks)
        if found and fd >= 0:
            signal.pidfd_send_signal(fd, number)  # novm
        elif found:
            os.kill(pid, number)
    except OSError:
        found = False
    finally:
        if fd >= 0:
            os.close(fd)
    return found


def _open_pidfd(pid: int) -> int:
    """Open a descriptor of the process; -1 where Python (3.9) or the kernel (5.3) has none, or it is gone."""
    try:
        return os.pidfd_open(pid)  # novm
    except (AttributeError, OSError):
        return -1


def send_signals(
    targets: "list[tuple[int, int]]", number: int, sent: "set[tuple[int, int, int]]"
) -> "set[tuple[int, int, int]]":
    """Signal every (pid, ticks) that has not had this signal yet; KILL is repeated.

    Returns (pid, ticks, signal) of those done.
    """
    done: "set[tuple[int, int, int]]" = set()
    for pid, ticks in targets:
        if (pid, ticks, number) not in sent or number == signal.SIGKILL:
            send_signal(pid, ticks, number)
            done.add((pid, ticks, number))
            if number != signal.SIGKILL:
                send_signal(pid, ticks, signal.SIGCONT)
    return done


def list_stop_steps(settings: Document) -> "tuple[tuple[str, str, float], ...]":
    """List (signal, ``main`` or ``tree``, seconds of grace) in order, without the final KILL."""
    if settings.get("preset") == "ros":
        return _ROS_STEPS
    grace_s = settings.get("grace_s")
    return (
        (settings.get("signal") or "TERM", "tree", _DEFAULT_GRACE_S if grace_s is None else float(grace_s)),
    )


def find_main_process(pid: int, table: "dict[int, proc.Process]") -> int:
    """Find the command itself: the only child of the shell ``pid`` where that waits for it, since a shell
    keeps INT to itself.
    """
    below = proc.group_children(table)
    while (
        pid in table
        and proc.read_cmdline(pid)[:2] == shell.build_argv("", "")[:2]
        and len(below.get(pid, ())) == 1
    ):
        pid = below[pid][0]
    return pid
