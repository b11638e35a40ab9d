# SPDX-License-Identifier: Apache-2.0
"""Application metrics: lines ``name value`` that a task appends to the file in $EDGECTL_METRICS.

A task may write anything, at any rate: only whole lines near the end are read, lines that are no metric are
skipped, and the supervisor limits the size of the file. No other function of the agent depends on it.
"""

import os
import stat

from ..link import protocol
from ..link.fast_json import Document
from ..supervise import records, state_dir

# The part of a file that is read, so that no task can make a probe slow.
MAX_READ_BYTES, MAX_LINES = 64 << 10, 4096
# Size on disk, and the interval of checks (s); the second while the file was too large.
MAX_FILE_BYTES = 1 << 20
_CHECK_S, _CHECK_FULL_S = 2.0, 0.5


def get_metrics_path(folder: str) -> str:
    """Path of the metrics file of the task in ``folder``."""
    return os.path.join(folder, "metrics")


def reset_metrics_file(folder: str) -> None:
    """Create an empty file before a process is started. Where that fails, the task has no metrics."""
    try:
        os.unlink(get_metrics_path(folder))
    except OSError:
        pass
    try:
        os.close(records.open_private_file(get_metrics_path(folder), os.O_WRONLY | os.O_CREAT | os.O_EXCL))
    except OSError:
        pass


def read_tasks_metrics(host: str, tasks: "dict[str, Document]") -> "dict[str, dict[str, float]]":
    """Read task -> metrics of those of ``tasks`` (entries of a reply) that have any.

    Where tasks are many, fewer of each.
    """
    own = {name: entry["instance"] for name, entry in tasks.items() if entry["managed"]}
    share = max(1, min(protocol.MAX_TASK_METRICS, protocol.MAX_HOST_METRICS // max(1, len(own))))
    found = {name: _read_task_metrics(host, name, instance, share) for name, instance in own.items()}
    return {name: values for name, values in found.items() if values}


def _read_task_metrics(host: str, name: str, instance: str, most: int) -> "dict[str, float]":
    folders = state_dir.find_task_dirs(host, name)
    if len(folders) > 1:
        folders = [
            folder
            for folder in folders
            if records.read_record(os.path.join(folder, "instance")).get("instance") == instance
        ]
    return read_metrics(folders[0], most) if folders else {}


def read_metrics(folder: str, most: int = protocol.MAX_TASK_METRICS) -> "dict[str, float]":
    """Read metrics by name, at most ``most``; none where no file can be read."""
    try:
        fd = records.open_private_file(get_metrics_path(folder), os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return {}
    try:
        return parse_metrics(_read_end(fd), most)
    except OSError:
        return {}
    finally:
        os.close(fd)


def _read_end(fd: int) -> bytes:
    """Read the end of the file from the start of a line; nothing where it is not a regular file."""
    # A second time where the supervisor cut the file in between.
    for _ in range(2):
        info = os.fstat(fd)
        if not stat.S_ISREG(info.st_mode) or not info.st_size:
            return b""
        start = max(0, info.st_size - MAX_READ_BYTES)
        data = os.pread(fd, MAX_READ_BYTES, start)
        if len(data) >= info.st_size - start:
            break
    return data.partition(b"\n")[2] if start else data


def parse_metrics(data: bytes, most: int = protocol.MAX_TASK_METRICS) -> "dict[str, float]":
    """Parse the last value of each name in the whole lines of ``data``.

    Of more than ``most`` names, those written last.
    """
    found: "dict[bytes, float]" = {}
    for line in reversed((b"\n" + data).rsplit(b"\n", MAX_LINES + 1)[1:-1]):
        words = line.split()
        if len(words) != 2 or words[0] in found:
            continue
        value = parse_value(words[1]) if protocol.is_metric_name(words[0].decode("latin-1")) else None
        if value is not None:
            found[words[0]] = value
            if len(found) == most:
                break
    return {name.decode("ascii"): value for name, value in sorted(found.items())}


def parse_value(word: bytes) -> "float | None":
    """Parse a finite number; None for anything else."""
    try:
        value = float(word)
    except ValueError:
        return None
    # float accepts 1_000; other languages do not.
    return value if value - value == 0.0 and b"_" not in word else None


def limit_metrics_file(folder: str) -> "tuple[float, int | None]":
    """Cut a file that is too large to the values that count.

    Returns the seconds until the next check, and the size to which it was cut (None: it was not).
    """
    try:
        info = os.lstat(get_metrics_path(folder))
        if info.st_blocks * 512 <= MAX_FILE_BYTES or not stat.S_ISREG(info.st_mode):
            return _CHECK_S, None
        fd = records.open_private_file(get_metrics_path(folder), os.O_RDWR | os.O_NONBLOCK)
    except OSError:
        return _CHECK_S, None
    try:
        return _CHECK_FULL_S, _compact_file(fd)
    except OSError:
        return _CHECK_FULL_S, None
    finally:
        os.close(fd)


def _compact_file(fd: int) -> int:
    """Rewrite in place, the head before the cut: lines that the task appends meanwhile come after it and
    count more. Returns the size of the head.
    """
    lines = b"".join(
        b"%s %s\n" % (name.encode(), repr(value).encode())
        for name, value in parse_metrics(_read_end(fd)).items()
    )
    try:
        os.pwrite(fd, lines, 0)
    except OSError:
        lines = b""
    os.ftruncate(fd, len(lines))
    return len(lines)
