"""Signals to the right process: its start ticks are compared immediately before, by pidfd where the kernel has it."""

import os
import signal

from . import proc


def number(name: str) -> int:
    """The signal called ``TERM`` or ``SIGTERM``."""
    return int(getattr(signal, "SIG" + str(name).upper().replace("SIG", "", 1)))


def send(pid: int, ticks: int, number_: int) -> bool:
    """Signal the process that was seen as (pid, ticks). False where it is gone, or refuses (another user's)."""
    fd = _pidfd(pid)
    try:
        # The descriptor holds the process; if it is the right one now, it stays the right one.
        found = proc.is_alive(pid, ticks)
        if found and fd >= 0:
            signal.pidfd_send_signal(fd, number_)  # novm
        elif found:
            os.kill(pid, number_)
    except OSError:
        found = False
    finally:
        if fd >= 0:
            os.close(fd)
    return found


def _pidfd(pid: int) -> int:
    """A descriptor of the process, or -1 where Python (3.9) or the kernel (5.3) has none, or it is gone."""
    try:
        return os.pidfd_open(pid)  # novm
    except (AttributeError, OSError):
        return -1


def send_each(targets: list, number_: int, sent: set) -> set:
    """Signal every (pid, ticks) that has not had this signal yet; KILL is repeated. Returns (pid, ticks, signal) of those done."""
    done = set()
    for pid, ticks in targets:
        if (pid, ticks, number_) not in sent or number_ == signal.SIGKILL:
            send(pid, ticks, number_)
            done.add((pid, ticks, number_))
            if number_ != signal.SIGKILL:
                send(pid, ticks, signal.SIGCONT)
    return done
