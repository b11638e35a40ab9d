# SPDX-License-Identifier: Apache-2.0
"""A log written where no file may grow beyond 5000 bytes, as on a full disk."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.pace import patience

_PROGRAM = """
import resource, signal, sys
from edgectl.agent.supervise.logfile import LogWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
log = LogWriter(sys.argv[1], int(sys.argv[2]), 2)
log.begin_run()
for line in sys.stdin.buffer: log.write(line)
print(log.dropped)
"""


def write_with_little_room(folder: Path, lines: Sequence[bytes], *, max_bytes: int) -> int:
    """Write ``lines`` one by one into a log of two files of at most ``max_bytes``; the bytes that were lost."""
    # -B: Python would leave the first 5000 bytes of what it compiles as the whole, for every other test.
    done = subprocess.run(
        [sys.executable, "-B", "-c", _PROGRAM, str(folder), str(max_bytes)],
        input=b"".join(lines),
        capture_output=True,
        check=True,
        timeout=patience(20),
    )
    return int(done.stdout)
