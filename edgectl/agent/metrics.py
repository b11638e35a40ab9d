"""What an application says of itself: lines ``name value`` that a task appends to the file in $EDGECTL_METRICS.

A task may write there what it likes, as fast as it likes: only whole lines near the end are read, what is no metric is passed over,
and the supervisor keeps the file small. Nothing depends on it.
"""

import os
import stat

from . import record, state

# Of one task, and of all tasks of a host together: a reply has room for so much.
MOST, MOST_OF_HOST = 32, 2048
LONGEST_NAME = 63
# What is read of a file, so that no task can make a probe slow.
TAIL, LINES = 64 << 10, 4096
# On the disk, and how long it may grow unseen (s), the second while it is too large each time.
CAP = 1 << 20
_LOOK_S, _FULL_S = 2.0, 0.5
_FIRST = frozenset(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_")
_LETTERS = _FIRST | frozenset(b"0123456789.:/-")


def file(folder: str) -> str:
    """Where the task of ``folder`` writes."""
    return os.path.join(folder, "metrics")


def begin(folder: str) -> None:
    """An empty file for a process that is about to start. Where there can be none, there are no metrics."""
    try:
        os.unlink(file(folder))
    except OSError:
        pass
    try:
        os.close(record.open_private(file(folder), os.O_WRONLY | os.O_CREAT | os.O_EXCL))
    except OSError:
        pass


def of_tasks(host: str, tasks: dict) -> dict:
    """Task -> metrics of those of ``tasks`` (entries of a reply) that have any; where tasks are very many, fewer of each."""
    own = {name: entry["instance"] for name, entry in tasks.items() if entry["managed"]}
    share = max(1, min(MOST, MOST_OF_HOST // max(1, len(own))))
    found = {name: _of_task(host, name, instance, share) for name, instance in own.items()}
    return {name: values for name, values in found.items() if values}


def _of_task(host: str, name: str, instance: str, most: int) -> dict:
    folders = state.task_dirs(host, name)
    if len(folders) > 1:
        folders = [
            folder
            for folder in folders
            if record.read(os.path.join(folder, "instance")).get("instance") == instance
        ]
    return read(folders[0], most) if folders else {}


def read(folder: str, most: int = MOST) -> dict:
    """Metrics by name, at most ``most``; none where there is no file, or none that can be read."""
    try:
        fd = record.open_private(file(folder), os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return {}
    try:
        return parsed(_tail(fd), most)
    except OSError:
        return {}
    finally:
        os.close(fd)


def _tail(fd: int) -> bytes:
    """The end of the file from the start of a line; nothing of what is no regular file."""
    # Once more where the supervisor made it smaller just now.
    for _ in range(2):
        info = os.fstat(fd)
        if not stat.S_ISREG(info.st_mode) or not info.st_size:
            return b""
        start = max(0, info.st_size - TAIL)
        data = os.pread(fd, TAIL, start)
        if len(data) >= info.st_size - start:
            break
    return data.partition(b"\n")[2] if start else data


def parsed(data: bytes, most: int = MOST) -> dict:
    """The last value of each name in the whole lines of ``data``; of more than ``most`` names those written last."""
    found = {}
    for line in reversed((b"\n" + data).rsplit(b"\n", LINES + 1)[1:-1]):
        words = line.split()
        if len(words) == 2 and words[0] not in found and _is_name(words[0]):
            value = _value(words[1])
            if value is not None:
                found[words[0]] = value
                if len(found) == most:
                    break
    return {name.decode("ascii"): value for name, value in sorted(found.items())}


def _is_name(word: bytes) -> bool:
    return word[0] in _FIRST and len(word) <= LONGEST_NAME and _LETTERS.issuperset(word)


def _value(word: bytes):
    """A finite number, or None."""
    try:
        value = float(word)
    except ValueError:
        return None
    # Python reads 1_000 as a number, and nobody else does.
    return value if value - value == 0.0 and b"_" not in word else None


def bounded(folder: str) -> float:
    """Make the file small again where it is too large, to the values that count; seconds until it is to be looked at again."""
    try:
        info = os.lstat(file(folder))
        if info.st_blocks * 512 <= CAP or not stat.S_ISREG(info.st_mode):
            return _LOOK_S
        fd = record.open_private(file(folder), os.O_RDWR | os.O_NONBLOCK)
    except OSError:
        return _LOOK_S
    try:
        _compact(fd)
    except OSError:
        pass
    finally:
        os.close(fd)
    return _FULL_S


def _compact(fd: int) -> None:
    """In place, and the head before the cut: whatever the task appends from here on comes after it and counts more."""
    lines = b"".join(
        b"%s %s\n" % (name.encode(), repr(value).encode()) for name, value in parsed(_tail(fd)).items()
    )
    try:
        os.pwrite(fd, lines, 0)
    except OSError:
        lines = b""
    os.ftruncate(fd, len(lines))
