# SPDX-License-Identifier: Apache-2.0
"""Hold a prepared request until the manager lets it go on."""

import os
import select
import sys
import time

from . import protocol

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from .boot import Channel

_MOST_BYTES = 64


class Hold:
    """The manager's end of a request that may wait; ``seconds`` 0: it does not."""

    def __init__(self, channel: "Channel", seconds: float) -> None:
        self._channel, self.seconds = channel, seconds

    def await_go(self) -> bool:
        """Say that everything is prepared, and wait. False without the word: at the end of the input, after
        another line, or when the time is over.
        """
        self._channel.write(("\n%s %s\n" % (protocol.HELD_WORD, self._channel.marker)).encode("ascii"))
        deadline = time.monotonic() + self.seconds
        os.set_blocking(0, False)
        # What came with the request is in Python's own buffer.
        stdin: "Any" = sys.stdin.buffer
        said = bytes(stdin.peek()[:_MOST_BYTES])
        while b"\n" not in said and len(said) < _MOST_BYTES:
            if not select.select([0], [], [], max(0.0, deadline - time.monotonic()))[0]:
                return False
            part = os.read(0, _MOST_BYTES)
            if not part:
                return False
            said += part
        return said.startswith(protocol.GO_LINE)
