# SPDX-License-Identifier: Apache-2.0
"""Operation ``fetch``: one piece of a file that a task wrote; the manager requests the pieces one by one."""

import os
import stat
from binascii import b2a_base64

from ..supervise import shell
from . import protocol
from .errors import RefusalError
from .fast_json import Document

# Base64 adds a third, and a reply must stay below protocol.MAX_REPLY_BYTES.
_PIECE_BYTES = 640 << 10


def read_file_piece(request: Document) -> Document:
    """Read the piece of ``file`` at ``offset``.

    ``mark`` changes with the file; ``size`` (bytes) is that of the whole file.

    Raises:
        RefusalError: the file is missing, unreadable, not a regular file, or larger than ``most`` bytes.
    """
    path = os.path.join(
        shell.resolve_workdir(request.get("workdir"), dict(os.environ)), os.path.expanduser(request["file"])
    )
    fd = _open_task_file(path)
    try:
        found = os.fstat(fd)
        if not stat.S_ISREG(found.st_mode):
            raise RefusalError(
                "not-a-file", path + " is not a regular file", "give the path of a regular file"
            )
        if found.st_size > request["most"]:
            message = "%s has %d bytes, the limit is %d" % (path, found.st_size, request["most"])
            raise RefusalError(
                "too-large", message, "reduce the output of the task, or copy the file by hand"
            )
        data = os.pread(fd, _PIECE_BYTES, request["offset"])
    except OSError as error:
        raise RefusalError(
            "unreadable", "%s: %s" % (path, error.strerror), "check the file on the host"
        ) from None
    finally:
        os.close(fd)
    mark = "%d-%d-%d" % (found.st_ino, found.st_mtime_ns, found.st_size)
    return {
        "op": protocol.OP_FETCH,
        "size": found.st_size,
        "mark": mark,
        "data": b2a_base64(data, newline=False).decode("ascii"),
    }


def _open_task_file(path: str) -> int:
    """Open ``path`` for reading, without following links and without waiting for the writer of a pipe."""
    try:
        return os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise RefusalError(
            "no-file", "no such file: " + path, "a relative path begins at the task's workdir"
        ) from None
    except OSError as error:
        linked = os.path.islink(path)
        reason, hint = (
            ("is a symbolic link", "give the path of its target")
            if linked
            else (error.strerror, "check the file on the host")
        )
        raise RefusalError("unreadable", "%s: %s" % (path, reason), hint) from None
    except ValueError:
        raise RefusalError("no-file", "not a path: %r" % path, "check the spelling of the path") from None
