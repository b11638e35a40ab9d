# SPDX-License-Identifier: Apache-2.0
"""Pseudo-terminal for one edgectl: its output, and typed input."""

import os
import pty
import select
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from tests.forkserver import EDGECTL, ForkedProcess
from tests.pace import patience


class Terminal:
    """Runs ``edgectl WORDS``, or another program, with all three streams on a pseudo-terminal."""

    def __init__(
        self,
        words: Sequence[str],
        directory: Path,
        *,
        program: str = EDGECTL,
        env: Mapping[str, str] | None = None,
        limit_s: float = 120.0,
    ) -> None:
        self._ours, theirs = pty.openpty()
        self._end = time.monotonic() + patience(limit_s)
        self.seen = ""
        self.process = ForkedProcess(
            words, program=program, cwd=directory, env=env, stdin=theirs, stdout=theirs, stderr=theirs
        )
        os.close(theirs)

    def _read(self) -> bool:
        """Read available output; False at the end."""
        assert time.monotonic() < self._end, self.seen
        if not select.select([self._ours], [], [], 0.2)[0]:
            return True
        try:
            data = os.read(self._ours, 65536)
        except OSError:
            return False
        self.seen += data.decode("utf-8", "replace")
        return bool(data)

    def until(self, text: str) -> None:
        """Read until ``text`` has been shown."""
        while text not in self.seen:
            assert self._read(), self.seen

    def type(self, text: str) -> None:
        """Press keys."""
        os.write(self._ours, text.encode())

    def wait(self) -> int:
        """Read to the end; return the exit code."""
        while self._read():
            pass
        return self.process.wait(patience(30))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self._ours)
