# SPDX-License-Identifier: Apache-2.0
"""Recordings of programs on a terminal of a fixed size, and asciicast v2 files of them."""

import fcntl
import json
import os
import pty
import select
import struct
import subprocess
import termios
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.pace import patience


@dataclass(frozen=True, slots=True)
class Recording:
    """The output of a program: seconds since its start and text, in order."""

    width: int
    height: int
    code: int
    chunks: tuple[tuple[float, str], ...]

    @property
    def text(self) -> str:
        """The whole output, with lines that end as in a file."""
        return "".join(text for _, text in self.chunks).replace("\r\n", "\n")


def record_program(
    words: Sequence[str], *, cwd: Path, env: Mapping[str, str], width: int = 100, height: int = 30
) -> Recording:
    """Run a program on a terminal of its own until it ends."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", height, width, 0, 0))
    began = time.monotonic()
    with subprocess.Popen(
        words, cwd=cwd, env=env, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
    ) as process:
        os.close(theirs)
        try:
            chunks = tuple(_read_chunks(ours, began, began + patience(300)))
        finally:
            os.close(ours)
            if process.poll() is None:
                process.kill()
    return Recording(width, height, process.returncode, chunks)


def _read_chunks(terminal: int, began: float, end: float) -> list[tuple[float, str]]:
    chunks: list[tuple[float, str]] = []
    data = b""
    while select.select([terminal], [], [], max(0.0, end - time.monotonic()))[0]:
        try:
            more = os.read(terminal, 1 << 16)
        except OSError:  # the program has ended, and so has its side of the terminal
            break
        if not more:
            break
        data += more
        # A character may be cut in two.
        text = data.decode(errors="ignore")
        data = data[len(text.encode()) :]
        chunks.append((time.monotonic() - began, text))
    return chunks


def write_cast(recording: Recording, path: Path, *, title: str, idle_s: float) -> None:
    """Write an asciicast v2 file, whose pauses are shortened to ``idle_s``; without a date, so that it is the same in a year."""
    header = {"version": 2, "width": recording.width, "height": recording.height, "title": title}
    lines, before, now = [json.dumps(header)], 0.0, 0.0
    for at, text in recording.chunks:
        now += min(at - before, idle_s)
        before = at
        lines.append(json.dumps([round(now, 2), "o", text], ensure_ascii=False))
    path.write_text("\n".join(lines) + "\n")


def read_cast(path: Path) -> Recording:
    """The recording in an asciicast v2 file."""
    head, *lines = path.read_text().splitlines()
    header = json.loads(head)
    assert header["version"] == 2
    events = [json.loads(line) for line in lines]
    return Recording(
        header["width"], header["height"], 0, tuple((at, text) for at, kind, text in events if kind == "o")
    )
