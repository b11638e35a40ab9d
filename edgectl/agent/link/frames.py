# SPDX-License-Identifier: Apache-2.0
"""Frames of a conversation: many requests and their replies on one channel; what both sides run (ADR 162).

A frame is the line ``word number length`` and so many bytes. The number is that of a request.
"""

# From the manager: a request, that nobody waits for its output any more, and that the manager is still there.
ASK, DROP, PULSE = "ask", "drop", "pulse"
# From the host: a piece of the output of a request; its end, with the exit status of its process; and that it
# was not begun.
OUTPUT, END, REFUSED = "output", "end", "refused"
MANAGER_WORDS, HOST_WORDS = (ASK, DROP, PULSE), (OUTPUT, END, REFUSED)

# The manager says something at least so often, and the host ends the conversation once it has heard nothing
# for so long (s): two pulses may come late.
PULSE_S, SILENCE_S = 0.6, 1.8

# Of the bytes after the line, so that an agent stays small: longer requests have calls; the line itself.
MAX_FRAME_BYTES = 1 << 16
_FRAME_LINE_BYTES = 40
_HEAD_WORDS = 3


def build_frame(word: str, number: int = 0, data: bytes = b"") -> bytes:
    """Build one frame."""
    return ("%s %d %d\n" % (word, number, len(data))).encode("ascii") + data


class FrameReader:
    """Parser of one direction; ``words`` are those that may come."""

    def __init__(self, words: "tuple[str, ...]") -> None:
        self._words, self._buffer = words, bytearray()
        # Of the frame that has begun: word, number, length.
        self._begun: "tuple[str, int, int] | None" = None

    def feed(self, data: bytes) -> "list[tuple[str, int, bytes]]":
        """Parse the frames that ``data`` completes: word, number, bytes. ValueError for anything else."""
        self._buffer += data
        found: "list[tuple[str, int, bytes]]" = []
        while True:
            if self._begun is None:
                end = self._buffer.find(b"\n", 0, _FRAME_LINE_BYTES)
                if end < 0 and len(self._buffer) < _FRAME_LINE_BYTES:
                    return found
                self._begun = self._parse_head(bytes(self._buffer[: max(0, end)]))
                del self._buffer[: end + 1]
            word, number, length = self._begun
            if len(self._buffer) < length:
                return found
            found.append((word, number, bytes(self._buffer[:length])))
            del self._buffer[:length]
            self._begun = None

    def _parse_head(self, head: bytes) -> "tuple[str, int, int]":
        parts = head.split(b" ")
        word = parts[0].decode("ascii", "replace")
        if len(parts) != _HEAD_WORDS or word not in self._words:
            raise ValueError("not a frame")
        if not (parts[1].isdigit() and parts[2].isdigit()) or int(parts[2]) > MAX_FRAME_BYTES:
            raise ValueError("not the head of a frame")
        return word, int(parts[1]), int(parts[2])
