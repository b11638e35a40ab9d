"""The readings of a profiler: a file of fixed size in memory that has no name, so that no disk wears, fills up or outlives it.

It belongs to one process and ends with it; whoever may look into that process reads it as /proc/PID/fd/N. The first slot says who
the profiler is and what it was asked; the others hold the newest samples, each over the oldest. A slot carries its number and a
checksum: one that is being written is not believed.
"""

import os

from . import record

SLOT = 1 << 15
SAMPLES = 60
_NUMBER = 20


def create(folder: str) -> int:
    """A descriptor of an empty ring: in shared memory, else in ``folder``. OSError where neither can be written."""
    for place in ("/dev/shm", folder):  # noqa: S108 - a name that nobody can guess, and gone at once
        path = os.path.join(place, ".edgectl-%d-%s" % (os.getpid(), os.urandom(8).hex()))
        try:
            fd = record.open_private(path, os.O_RDWR | os.O_CREAT | os.O_EXCL)
            os.unlink(path)
        except OSError as error:
            reason = error
            continue
        os.ftruncate(fd, SLOT * (1 + SAMPLES))
        return fd
    raise reason


def describe(fd: int, document: dict) -> None:
    """Write the first slot. ValueError where it is too long."""
    _put(fd, 0, 1, document)


def add(fd: int, number: int, document: dict) -> None:
    """Write sample ``number`` (from 1). ValueError where it is too long, OSError where memory is full."""
    _put(fd, SLOT * (1 + number % SAMPLES), number, document)


def _put(fd: int, at: int, number: int, document: dict) -> None:
    os.pwrite(fd, record.sealed(number, document, SLOT - 1) + b"\0", at)


def description(fd: int) -> dict:
    """What stands in the first slot; empty where it cannot be read."""
    return _opened(fd, 0)[1]


def newest(fd: int) -> tuple:
    """(number, sample) of the newest whole sample; (0, {}) where there is none."""
    heads = ((os.pread(fd, _NUMBER, SLOT * place), SLOT * place) for place in range(1, 1 + SAMPLES))
    for _, at in sorted(((head, at) for head, at in heads if head.isdigit()), reverse=True):
        found = _opened(fd, at)
        if found[0]:
            return found
    return 0, {}


def _opened(fd: int, at: int) -> tuple:
    return record.opened(os.pread(fd, SLOT, at).partition(b"\0")[0])
