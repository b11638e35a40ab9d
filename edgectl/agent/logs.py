"""A task's log on the host: written within bounds, read back, followed."""

import os
import select
import time

from . import record, state, status

LONGEST_LINE = 16384
_CLIPPED = b" [clipped]"
_BLOCK = 65536
_MOST_TEXT = 1 << 19
_SIGN_OF_LIFE_S = 3.0
_POLL_S = 0.2


class Log:
    """Files log.0 (newest) to log.N-1, each at most ``max_bytes``. Trouble with the disk is counted, never passed on to the task."""

    def __init__(self, folder: str, max_bytes: int, files: int) -> None:
        self.folder, self.max_bytes, self.files = folder, max(4096, max_bytes), max(1, files)
        self.dropped = 0
        self._column = 0
        self._fd, self._size = -1, 0
        self._open(os.O_APPEND)

    def _open(self, how: int) -> None:
        try:
            self._fd = record.open_private(_path(self.folder, 0), os.O_WRONLY | os.O_CREAT | how)
            self._size = os.fstat(self._fd).st_size
        except OSError:
            self._fd, self._size = -1, 0

    def write(self, data: bytes) -> None:
        """Append ``data``, long lines clipped."""
        data = self._clipped(data)
        while data:
            if self._size >= self.max_bytes:
                self._rotate()
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
                if os.path.exists(_path(self.folder, number - 1)):
                    os.rename(_path(self.folder, number - 1), _path(self.folder, number))
        except OSError:
            pass
        self._open(os.O_TRUNC)

    def _fits(self, data: bytes) -> bool:
        """Whether no line is too long, found in hops of a longest line each."""
        start = -self._column
        while len(data) - start > LONGEST_LINE:
            newline = data.rfind(b"\n", max(0, start), max(0, start + LONGEST_LINE + 1))
            if newline < 0:
                return False
            start = newline + 1
        return True

    def _clipped(self, data: bytes) -> bytes:
        if self._fits(data):
            newline = data.rfind(b"\n")
            self._column = len(data) - newline - 1 if newline >= 0 else self._column + len(data)
            return data
        lines = data.split(b"\n")
        kept = []
        for line in lines:
            room = max(0, LONGEST_LINE - self._column)
            over = len(line) > room and self._column <= LONGEST_LINE
            kept.append(line[:room] + (_CLIPPED if over else b""))
            # One past the limit means: this line has been clipped and marked already.
            self._column = LONGEST_LINE + 1 if len(line) > room else self._column + len(line)
            if len(kept) < len(lines):
                self._column = 0
        return b"\n".join(kept)


def _path(folder: str, number: int) -> str:
    return os.path.join(folder, "log.%d" % number)


def tail(folder: str, lines: int, most: int = _MOST_TEXT) -> bytes:
    """The last ``lines`` lines over all files, at most ``most`` bytes."""
    text, number = b"", 0
    while number < 1000 and text.count(b"\n") <= lines and len(text) < most:
        try:
            fd = record.open_private(_path(folder, number), os.O_RDONLY)
        except OSError:
            break
        size = os.fstat(fd).st_size
        text = os.pread(fd, most, max(0, size - most)) + text
        os.close(fd)
        number += 1
    kept = text[-most:].splitlines(True)
    return b"".join(kept[-lines:]) if lines > 0 else b""


def _folder(request: dict) -> str:
    trace, _ = status.current(request["host"], request["task"])
    return trace.folder if trace is not None else ""


def logs(request: dict) -> dict:
    """Operation ``logs``: the end of the log as text."""
    text = tail(_folder(request), int(request.get("tail", 100))).decode("utf-8", "replace")
    # Escaped, a character may take six bytes; the reply must stay below 1 MiB.
    while (
        len(text) > _MOST_TEXT // 4
        and sum(6 if ord(letter) > 126 or ord(letter) < 32 else 1 for letter in text) > 900000
    ):
        text = text[len(text) // 2 :]
    return {"v": 1, "op": "logs", "host": request["host"], "task": request["task"], "text": text}


class _Reader:
    """Reads log.0 on and on, over rotations."""

    def __init__(self, folder: str) -> None:
        self.folder, self.fd = folder, -1
        self._reopen(at_end=True)

    def _reopen(self, at_end: bool) -> None:
        if self.fd >= 0:
            os.close(self.fd)
        try:
            self.fd = record.open_private(_path(self.folder, 0), os.O_RDONLY)
            if at_end:
                os.lseek(self.fd, 0, os.SEEK_END)
        except OSError:
            self.fd = -1

    def read(self) -> bytes:
        """What has come since; empty where nothing did."""
        data = os.read(self.fd, _BLOCK) if self.fd >= 0 else b""
        if not data and self._rotated():
            self._reopen(at_end=False)
            data = os.read(self.fd, _BLOCK) if self.fd >= 0 else b""
        return data

    def _rotated(self) -> bool:
        try:
            return self.fd < 0 or os.stat(_path(self.folder, 0)).st_ino != os.fstat(self.fd).st_ino
        except OSError:
            return False


def follow(request: dict, channel) -> None:
    """Operation ``follow``: a frame, then chunks ``length newline bytes``, ``0`` as a sign of life, ``end`` when the task has ended."""
    state.checked_name(request["task"])
    folder = _folder(request)
    channel.reply(b'{"stream": true}')
    start = tail(folder, int(request.get("tail", 10)))
    reader = _Reader(folder)
    if start:
        channel.write(b"%d\n%s" % (len(start), start))
    gone = select.poll()
    gone.register(channel.fd, 0)
    last, ended = time.monotonic(), False
    while not gone.poll(0):
        data = reader.read()
        now = time.monotonic()
        if data or now - last >= _SIGN_OF_LIFE_S:
            channel.write(b"%d\n%s" % (len(data), data))
            last = now
        elif ended:
            return channel.write(b"end\n")
        if not data:
            ended = not status.current(request["host"], request["task"])[1]
            time.sleep(_POLL_S)
    return None
