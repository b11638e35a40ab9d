# SPDX-License-Identifier: Apache-2.0
"""Part of a log by its time or by its run, found by the records of ``log_times``."""

import os

from ..link.errors import RefusalError
from ..measure import proc
from . import log_times, logfile, records
from .log_times import NEW_RUN, UNKNOWN_BEFORE, Span

# A file that was written so much later than its last record says has bytes without one.
_SLACK_S = 5.0
EARLY_NOTE = "older lines are left out: when they were written is not known"
LATE_NOTE = "the times of the newest lines are not known: all of them are printed"


class LogBytes:
    """The files of a log, opened at one time, as one row of bytes; to be closed."""

    def __init__(self, folder: str) -> None:
        # Newest first: a rotation in between shows a file twice, never hides one.
        found: "list[tuple[int, os.stat_result]]" = []
        inodes: "set[int]" = set()
        for number in range(1000):
            try:
                fd = records.open_private_file(logfile.get_log_path(folder, number), os.O_RDONLY)
            except OSError:
                break
            info = os.fstat(fd)
            if info.st_ino in inodes:
                os.close(fd)
                continue
            inodes.add(info.st_ino)
            found.append((fd, info))
        self.files = found[::-1]
        self.size = sum(info.st_size for _, info in self.files)
        self.written_at = self.files[-1][1].st_mtime if self.files else 0.0

    def get_base(self, inode: int) -> int:
        """Get the position of the first byte of a file; -1 where it is gone."""
        base = 0
        for _, info in self.files:
            if info.st_ino == inode:
                return base
            base += info.st_size
        return -1

    def read(self, start: int, end: int) -> bytes:
        """Read the bytes between two positions."""
        parts, base = [], 0
        for fd, info in self.files:
            low, high = max(start - base, 0), min(end - base, info.st_size)
            if low < high:
                parts.append(os.pread(fd, high - low, low))
            base += info.st_size
        return b"".join(parts)

    def close(self) -> None:
        """Close the files."""
        for fd, _ in self.files:
            os.close(fd)


def read_selected(
    folder: str, since_s: "float | None", *, previous: bool, lines: "int | None"
) -> "tuple[bytes, str]":
    """Read the last ``lines`` lines (None: all that a reply takes) of those written in the last ``since_s``
    seconds, or of the run before the present one; and a note on what is not known.

    Raises:
        RefusalError: no time, or no earlier run, is known.
    """
    # The records first: a file that begins in between has none yet, and one that has records is there.
    found = _read_spans(folder)
    log = LogBytes(folder)
    try:
        spans = _place_spans(found, log)
        start, end, note = 0, log.size, ""
        if previous:
            start, end = _find_previous_run(spans)
        if since_s is not None:
            first, note = _find_since(spans, log, since_s)
            start = min(end, max(start, first))
        text = log.read(max(start, end - logfile.MAX_TEXT_BYTES), end)
    finally:
        log.close()
    kept = text.splitlines(True)
    if len(text) < end - start:
        kept = kept[1:]
        if lines is None or len(kept) < lines:
            note = (note and note + "; ") + "only the last lines fit into a reply"
    return b"".join(kept if lines is None else kept[-lines:] if lines else []), note


def _read_spans(folder: str) -> "list[Span]":
    try:
        fd = records.open_private_file(os.path.join(folder, log_times.TIMES_FILE), os.O_RDONLY)
    except OSError:
        return []
    size = log_times.TIME_BYTES * log_times.MAX_TIMES
    data, again = os.pread(fd, size, 0), os.pread(fd, size, 0)
    # Twice the same: not read while it was written anew. A record that is being added changes the end only.
    for _ in range(3):
        if data == again:
            break
        data, again = again, os.pread(fd, size, 0)
    os.close(fd)
    return log_times.decode_spans(again)


def _place_spans(spans: "list[Span]", log: LogBytes) -> "list[tuple[int, Span]]":
    """Find the position of each record whose bytes are still there, oldest first.

    The number of a file may be used again, and a file may be cut in place: then the newest records count.
    """
    placed: "list[tuple[int, Span]]" = []
    for span in reversed(spans):
        base = log.get_base(span.inode)
        position = base + span.offset
        if base < 0 or position > log.size or (placed and position > placed[-1][0]):
            break
        placed.append((position, span))
    return placed[::-1]


def _find_since(spans: "list[tuple[int, Span]]", log: LogBytes, since_s: float) -> "tuple[int, str]":
    """Find the first byte that may have been written in the last ``since_s`` seconds, at the beginning of its
    line; with a note.
    """
    if not log.size:
        return 0, ""
    if not spans:
        raise RefusalError(
            "times-unknown",
            "no times of this log are known: an earlier release of edgectl wrote it, or the disk had no room",
            "omit --since; edgectl restart notes them from then on",
        )
    boot, uptime_s = log_times.read_boot(), proc.read_uptime_s()
    newest = spans[-1][1]
    noted_at = newest.wall_s + (newest.last_ms - newest.first_ms) / 1000.0
    late = log.written_at - noted_at > _SLACK_S
    for number, (position, span) in enumerate(spans):
        last = number + 1 == len(spans)
        until, at_ms = span, span.last_ms
        if not last and spans[number + 1][1].mark == UNKNOWN_BEFORE:
            until = spans[number + 1][1]
            at_ms = until.first_ms
        if until.compute_age_s(at_ms, boot, uptime_s) <= since_s or (last and late):
            note = LATE_NOTE if late else EARLY_NOTE if number == 0 and position > 0 else ""
            run = max([at for at, each in spans[: number + 1] if each.mark == NEW_RUN], default=0)
            return max(_find_line(log, position), run), note
    return log.size, ""


def _find_line(log: LogBytes, position: int) -> int:
    """Find the beginning of the line of ``position``."""
    start = max(0, position - logfile.MAX_LINE_BYTES)
    return start + log.read(start, position).rfind(b"\n") + 1


def _find_previous_run(spans: "list[tuple[int, Span]]") -> "tuple[int, int]":
    """Find where the run before the last one begins and ends."""
    starts = [number for number, (_, span) in enumerate(spans) if span.mark == NEW_RUN]
    # After some bytes without a record: a run may have begun there.
    lost = any(span.mark == UNKNOWN_BEFORE for _, span in spans[starts[-1] :]) if starts else True
    if lost or starts[-1] == 0:
        raise RefusalError(
            "no-previous-run",
            "no run before the present one is known: there was none, its lines were rotated away, or an"
            " earlier release of edgectl wrote them",
            "omit --previous",
        )
    # Without the beginning of the run before, which was rotated away: what is left of it.
    first = starts[-2] if len(starts) > 1 else 0
    return spans[first][0], spans[starts[-1]][0]
