# SPDX-License-Identifier: Apache-2.0
"""Times of a log: when which bytes of it were written, and where each run of the command begins (ADR 142).

File ``log-times`` beside the log, allocated once, records of 80 bytes. A record stands before the first bytes
of a second in which something was written, of a file of the log, and of a run. Once all are used, neighbours
become one, so that the times of old bytes are known less exactly than those of new ones.
"""

import os
import time

from ..measure import system_files
from . import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable

TIMES_FILE = "log-times"
TIME_BYTES, MAX_TIMES = 80, 1024
# Bytes are written at most so long after the time of their record.
_STEP_MS = 1000
# Neighbours become one where they are so many times older than long.
_AGE_PER_LENGTH = 32
_RETRY_MS = 60_000
# ``mark`` of a record: bytes of the same run; the first of a run; the first after some without a record.
SAME_RUN, NEW_RUN, UNKNOWN_BEFORE = "-", "+", "?"


class Span:
    """Bytes from ``offset`` of the file ``inode`` on, written from ``first_ms`` to ``last_ms`` after the boot
    ``boot``, which was at ``wall_s`` since 1970.
    """

    __slots__ = ("boot", "first_ms", "inode", "last_ms", "mark", "offset", "wall_s")

    def __init__(
        self, inode: int, offset: int, first_ms: int, last_ms: int, wall_s: int, boot: str, mark: str
    ) -> None:
        self.inode, self.offset, self.first_ms, self.last_ms = inode, offset, first_ms, last_ms
        self.wall_s, self.boot, self.mark = wall_s, boot, mark

    def encode(self) -> bytes:
        """Encode the record, of a fixed length."""
        text = "%20d %11d %11d %11d %11d %8s %s\n" % (
            self.inode,
            self.offset,
            self.first_ms,
            self.last_ms,
            self.wall_s,
            self.boot,
            self.mark,
        )
        return text.encode("ascii")

    def compute_age_s(self, at_ms: int, boot: str, uptime_s: float) -> float:
        """Compute the seconds since ``at_ms`` of its boot; by the wall clock where that is not ``boot``, the
        present one, which was ``uptime_s`` ago.
        """
        if self.boot == boot:
            return uptime_s - at_ms / 1000.0
        return time.time() - self.wall_s - (at_ms - self.first_ms) / 1000.0


def read_boot() -> str:
    """Read the beginning of the id of this boot."""
    return system_files.read_boot_id()[:8]


def decode_spans(data: bytes) -> "list[Span]":
    """Decode the records, oldest first; those that are damaged are left out."""
    found = []
    for start in range(0, len(data), TIME_BYTES):
        fields = data[start : start + TIME_BYTES].split()
        try:
            inode, offset, first, last, wall = (int(field) for field in fields[:5])
            boot, mark = (field.decode("ascii") for field in fields[5:])
        except ValueError:
            continue
        found.append(Span(inode, offset, first, last, wall, boot, mark))
    return found


class LogTimes:
    """Writer of the times of a log; a disk that refuses them never disturbs the log."""

    def __init__(self, folder: str, read_uptime_s: "Callable[[], float]") -> None:
        self._read_uptime_s = read_uptime_s
        self._path = os.path.join(folder, TIMES_FILE)
        self._boot = read_boot()
        self._fd, self._count, self._retry_ms = -1, 0, 0
        self._newest: "Span | None" = None
        self._lost = False
        self._open()

    def _open(self) -> None:
        """Open the file and take up all of its room: later a full disk cannot refuse a record."""
        size = TIME_BYTES * MAX_TIMES
        try:
            self._fd = records.open_private_file(self._path, os.O_RDWR | os.O_CREAT)
            data = os.pread(self._fd, size, 0)
            if len(data) < size:
                _overwrite(self._fd, data + b" " * (size - len(data)))
            self._count = (len(data.rstrip()) + TIME_BYTES - 1) // TIME_BYTES
        except OSError:
            self._close()

    def _read_now_ms(self) -> int:
        return int(self._read_uptime_s() * 1000)

    def _close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
        self._fd, self._lost = -1, True
        self._retry_ms = self._read_now_ms() + _RETRY_MS

    def note(
        self, inode: int, offset: int, list_inodes: "Callable[[], list[int]]", *, new_run: bool = False
    ) -> None:
        """Record that bytes are written to ``inode`` from ``offset`` on: at most once a second, except for a
        new file and a new run.
        """
        now_ms, last = self._read_now_ms(), self._newest
        same = last is not None and last.inode == inode and last.offset <= offset and not new_run
        if same and last is not None and now_ms < last.last_ms:
            return
        if self._fd < 0 and now_ms >= self._retry_ms:
            self._open()
        if self._fd < 0:
            return
        mark = NEW_RUN if new_run else UNKNOWN_BEFORE if self._lost else SAME_RUN
        span = Span(inode, offset, now_ms, now_ms + _STEP_MS, int(time.time()), self._boot, mark)
        try:
            if self._count >= MAX_TIMES:
                self._thin(list_inodes(), now_ms)
            os.pwrite(self._fd, span.encode(), TIME_BYTES * self._count)
        except OSError:
            self._close()
            return
        self._count, self._newest, self._lost = self._count + 1, span, False

    def _thin(self, inodes: "list[int]", now_ms: int) -> None:
        size = TIME_BYTES * MAX_TIMES
        kept = thin_spans(decode_spans(os.pread(self._fd, size, 0)), inodes, self._boot, now_ms)
        _overwrite(self._fd, b"".join(span.encode() for span in kept).ljust(size))
        self._count = len(kept)


def thin_spans(spans: "list[Span]", inodes: "list[int]", boot: str, now_ms: int) -> "list[Span]":
    """Leave out the records of files that are gone, and join neighbours that are old for their length; at
    most three quarters of MAX_TIMES, the newest.
    """
    kept: "list[Span]" = []
    for span in spans:
        if span.inode not in inodes:
            continue
        before = kept[-1] if kept else None
        if before is not None and _may_join(before, span, boot, now_ms):
            before.last_ms = span.last_ms
        else:
            kept.append(span)
    return kept[-MAX_TIMES * 3 // 4 :]


def _may_join(before: Span, span: Span, boot: str, now_ms: int) -> bool:
    if (before.inode, before.boot, span.mark) != (span.inode, span.boot, SAME_RUN):
        return False
    length_s = (span.last_ms - before.first_ms) / 1000.0
    old = length_s * _AGE_PER_LENGTH <= span.compute_age_s(span.last_ms, boot, now_ms / 1000.0)
    return old and before.offset <= span.offset


def _overwrite(fd: int, data: bytes) -> None:
    if os.pwrite(fd, data, 0) < len(data):
        raise OSError("no room")
