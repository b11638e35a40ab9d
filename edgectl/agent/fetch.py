"""Operation ``fetch``: a piece of a file that a task made, as large as a reply can carry; the manager asks for one after the other."""

import os
import stat
from binascii import b2a_base64

from . import spawn
from .errors import RefusalError

# In base64 it takes a third more, and a reply stays below 1 MiB.
_PIECE = 640 << 10


def fetch(request: dict) -> dict:
    """The piece of ``file`` at ``offset``. ``mark`` changes with the file; ``size`` (bytes) is that of the whole.

    Raises:
        RefusalError: it is not there, cannot be read, is no regular file, or has more than ``most`` bytes.
    """
    path = os.path.join(
        spawn.working_dir(request.get("workdir"), os.environ), os.path.expanduser(request["file"])
    )
    fd = _open(path)
    try:
        found = os.fstat(fd)
        if not stat.S_ISREG(found.st_mode):
            raise RefusalError("not-a-file", path + " is not a regular file", "name the file itself")
        if found.st_size > request["most"]:
            words = "%s has %d bytes, at most %d are fetched" % (path, found.st_size, request["most"])
            raise RefusalError("too-large", words, "let the task write less, or copy it by hand")
        data = os.pread(fd, _PIECE, request["offset"])
    except OSError as error:
        raise RefusalError(
            "unreadable", "%s: %s" % (path, error.strerror), "look at it on the host"
        ) from None
    finally:
        os.close(fd)
    mark = "%d-%d-%d" % (found.st_ino, found.st_mtime_ns, found.st_size)
    return {
        "op": "fetch",
        "size": found.st_size,
        "mark": mark,
        "data": b2a_base64(data, newline=False).decode("ascii"),
    }


def _open(path: str) -> int:
    """A descriptor; never through a link, and never one that waits, as a pipe's would."""
    try:
        return os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise RefusalError(
            "no-file", "no such file: " + path, "a relative path begins at the task's workdir"
        ) from None
    except OSError as error:
        linked = os.path.islink(path)
        words, hint = (
            ("is a link", "name the file that it points to")
            if linked
            else (error.strerror, "look at it on the host")
        )
        raise RefusalError("unreadable", "%s: %s" % (path, words), hint) from None
    except ValueError:
        raise RefusalError("no-file", "not a path: %r" % path, "look at how it is spelled") from None
