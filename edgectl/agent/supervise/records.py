# SPDX-License-Identifier: Apache-2.0
"""Small documents in files of fixed size, rewritten in place: a full disk or a power cut never loses the last
valid one.

A file has two slots of 2 KiB; a slot is ``sequence crc32 json``, padded with blanks. Writers alternate,
readers take the valid slot with the highest sequence number.
"""

import os

from ..link import fast_json
from ..link.fast_json import Document

SLOT_BYTES = 2048
RECORD_BYTES = 2 * SLOT_BYTES


def open_private_file(path: str, flags: int) -> int:
    """Open a file: never through a link, never inherited, created with mode 0600."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)


def write_record(path: str, document: Document, *, durable: bool = False) -> None:
    """Replace the document in ``path``; ``durable``: return after the disk has it.

    OSError where the file system refuses. A value that a reboot makes obsolete (a pid, a living state) need
    not be durable.
    """
    fd = open_private_file(path, os.O_RDWR | os.O_CREAT)
    try:
        sequence = _select_newest(os.pread(fd, RECORD_BYTES, 0))[0] + 1
        os.pwrite(
            fd, encode_slot(sequence, document, SLOT_BYTES).ljust(SLOT_BYTES), SLOT_BYTES * (sequence % 2)
        )
        if durable:
            os.fdatasync(fd)
    finally:
        os.close(fd)


def read_record(path: str) -> Document:
    """Read the newest valid document in ``path``; empty where there is none."""
    try:
        fd = open_private_file(path, os.O_RDONLY)
    except OSError:
        return {}
    try:
        return _select_newest(os.pread(fd, RECORD_BYTES, 0))[1]
    finally:
        os.close(fd)


def _select_newest(data: bytes) -> "tuple[int, Document]":
    return max((decode_slot(data[:SLOT_BYTES]), decode_slot(data[SLOT_BYTES:])), key=lambda found: found[0])


def encode_slot(sequence: int, document: Document, most: int) -> bytes:
    """Encode the content of a slot. ValueError where it is longer than ``most`` bytes."""
    import zlib

    body = fast_json.dumps(document).encode("ascii")
    data = b"%020d %08x %s" % (sequence, zlib.crc32(b"%020d" % sequence + body), body)
    if len(data) > most:
        raise ValueError("a record of %d bytes is too long" % len(data))
    return data


def decode_slot(data: bytes) -> "tuple[int, Document]":
    """Decode (sequence, document); (0, {}) where the slot is empty or damaged."""
    # A library of its own in many builds of Python, and few hosts without tasks have records.
    import zlib

    try:
        sequence, crc, body = data.rstrip(b" \0").split(b" ", 2)
        if int(crc, 16) == zlib.crc32(sequence + body):
            return int(sequence), fast_json.loads(body.decode("ascii"))
    except ValueError:
        pass
    return 0, {}
