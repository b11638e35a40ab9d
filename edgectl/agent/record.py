"""Small documents in files of fixed size, rewritten in place: a full disk or a power cut never loses the last good one.

A file is two slots of 2 KiB; a slot is ``sequence crc32 json``, padded with blanks. Writers alternate, readers take the
valid slot with the highest sequence number.
"""

import os
import zlib

from . import light

SLOT = 2048
SIZE = 2 * SLOT


def open_private(path: str, flags: int) -> int:
    """Open a file of ours: never through a link, never inherited, created 0600."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)


def write(path: str, document: dict, *, durable: bool = False) -> None:
    """Replace the document in ``path``; ``durable``: come back once the disk has it. OSError where the file system refuses.

    What a boot makes worthless (a pid, a state that lives) need not be durable; what must outlive a power cut must.
    """
    fd = open_private(path, os.O_RDWR | os.O_CREAT)
    try:
        sequence = _newest(os.pread(fd, SIZE, 0))[0] + 1
        os.pwrite(fd, sealed(sequence, document, SLOT).ljust(SLOT), SLOT * (sequence % 2))
        if durable:
            os.fdatasync(fd)
    finally:
        os.close(fd)


def read(path: str) -> dict:
    """The newest valid document in ``path``; empty where there is none."""
    try:
        fd = open_private(path, os.O_RDONLY)
    except OSError:
        return {}
    try:
        return _newest(os.pread(fd, SIZE, 0))[1]
    finally:
        os.close(fd)


def _newest(data: bytes) -> tuple:
    return max((opened(data[:SLOT]), opened(data[SLOT:])), key=lambda found: found[0])


def sealed(sequence: int, document: dict, most: int) -> bytes:
    """What stands in a slot. ValueError where it is longer than ``most`` bytes."""
    body = light.dumps(document).encode("ascii")
    data = b"%020d %08x %s" % (sequence, zlib.crc32(b"%020d" % sequence + body), body)
    if len(data) > most:
        raise ValueError("a record of %d bytes is too long" % len(data))
    return data


def opened(data: bytes) -> tuple:
    """(sequence, document), or (0, {}) where the slot is empty or damaged."""
    try:
        sequence, crc, body = data.rstrip(b" \0").split(b" ", 2)
        if int(crc, 16) == zlib.crc32(sequence + body):
            return int(sequence), light.loads(body.decode("ascii"))
    except ValueError:
        pass
    return 0, {}
