# SPDX-License-Identifier: Apache-2.0
"""Log files of a task: bounded writer, reader across rotations, tail."""

import os

from ..measure import proc
from . import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable

MAX_LINE_BYTES = 16384
_CLIPPED = b" [clipped]"
_BLOCK_BYTES = 65536
MAX_TEXT_BYTES = 1 << 19


class LogWriter:
    """Files log.0 (newest) to log.N-1, each at most ``max_bytes``.

    Disk errors are counted in ``dropped`` and never disturb the task.
    """

    def __init__(
        self,
        folder: str,
        max_bytes: int,
        files: int,
        read_uptime_s: "Callable[[], float]" = proc.read_uptime_s,
    ) -> None:
        # Imported on demand: requests that read a log load this module, too.
        from .log_times import LogTimes

        self.folder, self.max_bytes, self.files = folder, max(4096, max_bytes), max(1, files)
        self.dropped = 0
        self._column = 0
        self._fd, self._size, self._inode = -1, 0, 0
        self._times = LogTimes(folder, read_uptime_s)
        self._open(os.O_APPEND)

    def begin_run(self) -> None:
        """Record that the command starts: what follows is the output of another run."""
        self._note_time(new_run=True)

    def _note_time(self, *, new_run: bool = False) -> None:
        if self._fd >= 0:
            self._times.note(self._inode, self._size, self._list_inodes, new_run=new_run)

    def _list_inodes(self) -> "list[int]":
        found = []
        for number in range(self.files):
            try:
                found.append(os.stat(get_log_path(self.folder, number)).st_ino)
            except OSError:
                break
        return found

    def _open(self, how: int) -> None:
        try:
            self._fd = records.open_private_file(get_log_path(self.folder, 0), os.O_WRONLY | os.O_CREAT | how)
            info = os.fstat(self._fd)
            self._size, self._inode = info.st_size, info.st_ino
        except OSError:
            self._fd, self._size = -1, 0

    def write(self, data: bytes) -> None:
        """Append ``data``, long lines clipped."""
        data = self._clip_lines(data)
        while data:
            if self._size >= self.max_bytes:
                self._rotate()
            self._note_time()
            part, data = data[: self.max_bytes - self._size], data[self.max_bytes - self._size :]
            try:
                written = os.write(self._fd, part)
            except OSError:
                written = 0
            self._size += written
            if written < len(part):
                self.dropped += len(part) - written + len(data)
                return

    def _rotate(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
        try:
            for number in range(self.files - 1, 0, -1):
                if os.path.exists(get_log_path(self.folder, number - 1)):
                    os.rename(get_log_path(self.folder, number - 1), get_log_path(self.folder, number))
        except OSError:
            pass
        self._open(os.O_TRUNC)

    def _fits(self, data: bytes) -> bool:
        """Whether no line is too long, searched in steps of the maximum line length."""
        start = -self._column
        while len(data) - start > MAX_LINE_BYTES:
            newline = data.rfind(b"\n", max(0, start), max(0, start + MAX_LINE_BYTES + 1))
            if newline < 0:
                return False
            start = newline + 1
        return True

    def _clip_lines(self, data: bytes) -> bytes:
        if self._fits(data):
            newline = data.rfind(b"\n")
            self._column = len(data) - newline - 1 if newline >= 0 else self._column + len(data)
            return data
        lines = data.split(b"\n")
        kept: "list[bytes]" = []
        for line in lines:
            room = max(0, MAX_LINE_BYTES - self._column)
            over = len(line) > room and self._column <= MAX_LINE_BYTES
            kept.append(line[:room] + (_CLIPPED if over else b""))
            # One past the limit: this line has been clipped and marked already.
            self._column = MAX_LINE_BYTES + 1 if len(line) > room else self._column + len(line)
            if len(kept) < len(lines):
                self._column = 0
        return b"\n".join(kept)


class LogReader:
    """Reader of log.0 from its present end, across rotations."""

    def __init__(self, folder: str) -> None:
        self.folder, self.fd = folder, -1
        self._reopen(at_end=True)

    def _reopen(self, at_end: bool) -> None:
        if self.fd >= 0:
            os.close(self.fd)
        try:
            self.fd = records.open_private_file(get_log_path(self.folder, 0), os.O_RDONLY)
            if at_end:
                os.lseek(self.fd, 0, os.SEEK_END)
        except OSError:
            self.fd = -1

    def read(self) -> bytes:
        """Read the bytes written since the last call."""
        data = os.read(self.fd, _BLOCK_BYTES) if self.fd >= 0 else b""
        if not data and self._is_rotated():
            self._reopen(at_end=False)
            data = os.read(self.fd, _BLOCK_BYTES) if self.fd >= 0 else b""
        return data

    def _is_rotated(self) -> bool:
        try:
            return self.fd < 0 or os.stat(get_log_path(self.folder, 0)).st_ino != os.fstat(self.fd).st_ino
        except OSError:
            return False


def get_log_path(folder: str, number: int) -> str:
    """Get the path of a file of the log; 0 is the newest."""
    return os.path.join(folder, "log.%d" % number)


def read_log_tail(folder: str, lines: int, most: int = MAX_TEXT_BYTES) -> bytes:
    """Read the last ``lines`` lines over all files, at most ``most`` bytes."""
    text, number = b"", 0
    while number < 1000 and text.count(b"\n") <= lines and len(text) < most:
        try:
            fd = records.open_private_file(get_log_path(folder, number), os.O_RDONLY)
        except OSError:
            break
        size = os.fstat(fd).st_size
        text = os.pread(fd, most, max(0, size - most)) + text
        os.close(fd)
        number += 1
    kept = text[-most:].splitlines(True)
    return b"".join(kept[-lines:]) if lines > 0 else b""
