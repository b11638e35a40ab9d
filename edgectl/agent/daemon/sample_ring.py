# SPDX-License-Identifier: Apache-2.0
"""Ring of the profiler's samples: an unnamed file of fixed size in memory, which no disk holds and which
never outlives the profiler.

It belongs to one process and ends with it; a process that may inspect that one reads it as /proc/PID/fd/N.
The first slot describes the profiler and its probe spec; the others hold the newest samples, each over the
oldest. A slot carries its number and a checksum, so that a partly written slot is not used.
"""

import os

from ..link.fast_json import Document
from ..supervise import records

SLOT_BYTES = 1 << 15
MAX_SAMPLES = 60
_NUMBER = 20


def create_ring(folder: str) -> int:
    """Create an empty ring in shared memory, else in ``folder``; its descriptor.

    OSError where neither can be written.
    """
    for place in ("/dev/shm", folder):  # noqa: S108 - a random name, removed at once
        path = os.path.join(place, ".edgectl-%d-%s" % (os.getpid(), os.urandom(8).hex()))
        try:
            fd = records.open_private_file(path, os.O_RDWR | os.O_CREAT | os.O_EXCL)
            os.unlink(path)
        except OSError as error:
            reason: OSError = error
            continue
        os.ftruncate(fd, SLOT_BYTES * (1 + MAX_SAMPLES))
        return fd
    raise reason


def write_description(fd: int, document: Document) -> None:
    """Write the first slot. ValueError where it is too long."""
    _write_slot(fd, 0, 1, document)


def write_sample(fd: int, number: int, document: Document) -> None:
    """Write sample ``number`` (from 1). ValueError where it is too long, OSError where memory is full."""
    _write_slot(fd, SLOT_BYTES * (1 + number % MAX_SAMPLES), number, document)


def _write_slot(fd: int, at: int, number: int, document: Document) -> None:
    os.pwrite(fd, records.encode_slot(number, document, SLOT_BYTES - 1) + b"\0", at)


def read_description(fd: int) -> Document:
    """Read the first slot; empty where it cannot be read."""
    return _read_slot(fd, 0)[1]


def read_newest(fd: int) -> "tuple[int, Document]":
    """Read (number, sample) of the newest whole sample; (0, {}) where there is none."""
    heads = (
        (os.pread(fd, _NUMBER, SLOT_BYTES * place), SLOT_BYTES * place) for place in range(1, 1 + MAX_SAMPLES)
    )
    for _, at in sorted(((head, at) for head, at in heads if head.isdigit()), reverse=True):
        found = _read_slot(fd, at)
        if found[0]:
            return found
    return 0, {}


def _read_slot(fd: int, at: int) -> "tuple[int, Document]":
    return records.decode_slot(os.pread(fd, SLOT_BYTES, at).partition(b"\0")[0])
