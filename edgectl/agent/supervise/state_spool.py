# SPDX-License-Identifier: Apache-2.0
"""Spool file of a task's state on its way to another host, and the pieces in which it travels.

It is private (0600), in the directory of the task, and named after nothing that is in it. A stop and a start
of the task remove it, unless they are part of the move that it belongs to.
"""

import os
import sys
import zlib

from ..link import protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from . import records, state_dir, status, task_dirs

TYPE_CHECKING = False
if TYPE_CHECKING:
    from ..link.boot import Channel

# A piece is sent compressed where that saves a tenth of it; where it did not, so many later one is tried.
_PAYS, _RETRY_PIECES = 0.9, 8


def open_new_spool(folder: str) -> int:
    """Open an empty spool in the directory of a task, in place of any other."""
    return records.open_private_file(
        os.path.join(folder, state_dir.SPOOL_FILE_NAME), os.O_RDWR | os.O_CREAT | os.O_TRUNC
    )


def open_spool(host: str, task: str, flags: int = os.O_RDONLY) -> int:
    """Open the spool of a task.

    Raises:
        RefusalError: there is none.
    """
    for folder in state_dir.find_task_dirs(host, task):
        try:
            return records.open_private_file(os.path.join(folder, state_dir.SPOOL_FILE_NAME), flags)
        except FileNotFoundError:
            continue
    raise RefusalError("no-state", "no state of %s is kept here" % task, "apply again")


def stream_state(request: Document, channel: "Channel") -> None:
    """Operation ``read-state``: a frame, then the pieces from ``offset``, each as ``length newline kind
    bytes``, and ``end``.
    """
    fd = open_spool(state_dir.check_name(request["host"]), state_dir.check_name(request["task"]))
    channel.reply(b'{"stream": true}')
    offset, number, pays = int(request["offset"]), 0, True
    while True:
        data = os.pread(fd, protocol.STATE_PIECE_BYTES, offset)
        if not data:
            return channel.write(b"end\n")
        offset += len(data)
        chunk = _pack_piece(data) if pays or number % _RETRY_PIECES == 0 else protocol.STATE_PLAIN + data
        pays, number = chunk[:1] == protocol.STATE_PACKED, number + 1
        channel.write(b"%d\n" % len(chunk))
        channel.write(chunk)


def _pack_piece(data: bytes) -> bytes:
    packed = zlib.compress(data, 1)
    if len(packed) < _PAYS * len(data):
        return protocol.STATE_PACKED + packed
    return protocol.STATE_PLAIN + data


def write_state(request: Document) -> Document:
    """Operation ``write-state``: take room for ``total`` bytes, or write the piece of ``size`` bytes at
    ``offset``, whose ``bytes`` (fewer, where they are ``packed``) follow the request.

    The same piece twice is the same piece. Pieces may come at once and in any order.

    Raises:
        RefusalError: a piece does not fit, or there is no room yet.
        OSError: the disk is full.
    """
    host, task = state_dir.check_name(request["host"]), state_dir.check_name(request["task"])
    status.check_generation(host, task, int(request["generation"]))
    total = int(request.get("total") or 0)
    fd = open_new_spool(task_dirs.make_task_dir(host, task)) if total else open_spool(host, task, os.O_RDWR)
    try:
        if total:
            os.posix_fallocate(fd, 0, total)
        else:
            _write_piece(fd, request)
    except OSError:
        task_dirs.drop_spools(host, task)
        raise
    finally:
        os.close(fd)
    return {"state": "written"}


def _write_piece(fd: int, request: Document) -> None:
    count, size, offset = int(request["bytes"]), int(request["size"]), int(request["offset"])
    if not 0 < size <= protocol.STATE_PIECE_BYTES or not 0 < count <= protocol.STATE_PIECE_BYTES:
        raise RefusalError("bad-piece", "a piece of the state has %d bytes in %d" % (size, count))
    if not 0 <= offset <= os.fstat(fd).st_size - size:
        raise RefusalError("bad-piece", "a piece of the state does not fit")
    data = sys.stdin.buffer.read(count)
    if request.get("packed"):
        try:
            data = zlib.decompressobj().decompress(data, size + 1)
        except zlib.error:
            data = b""
    if len(data) != size:
        raise RefusalError("bad-piece", "a piece of the state did not arrive as it was sent", "apply again")
    os.pwrite(fd, data, offset)


def drop_state(request: Document) -> Document:
    """Operation ``drop-state``: remove the spool; nothing happens where there is none."""
    host, task = state_dir.check_name(request["host"]), state_dir.check_name(request["task"])
    status.check_generation(host, task, int(request["generation"]))
    return {"state": "dropped" if task_dirs.drop_spools(host, task) else "none"}
