# SPDX-License-Identifier: Apache-2.0
"""Frames of a conversation: cut anywhere they are the same, and nothing else is one."""

import pytest

from edgectl.agent.link import frames

SENT = [(frames.ASK, 1, b"a\nb"), (frames.PULSE, 0, b""), (frames.ASK, 17, bytes(range(256)) * 20)]


def build_all() -> bytes:
    return b"".join(frames.build_frame(*each) for each in SENT)


def feed_in_pieces(reader: frames.FrameReader, data: bytes, size: int) -> list[tuple[str, int, bytes]]:
    return [frame for at in range(0, len(data), size) for frame in reader.feed(data[at : at + size])]


@pytest.mark.parametrize("size", [1, 2, 7, 4096, 100_000])
def test_frames_are_the_same_wherever_they_are_cut(size: int) -> None:
    assert feed_in_pieces(frames.FrameReader(frames.MANAGER_WORDS), build_all(), size) == SENT


@pytest.mark.parametrize(
    "noise",
    [
        b"\n",
        b"hello\n",
        b"ask 1\n",
        b"ask 1 2 3\n",
        b"ask  1 2\n",
        b"ask x 2\n",
        b"ask 1 -1\n",
        b"ask 1 +1\n",
        b"ask 1 65537\n",
        b"output 1 1\nx",
        b"a" * 41,
        b"ask 1 " + b"0" * 40 + b"\n",
        b"\xff\xfe 1 1\n",
    ],
)
def test_nothing_else_is_a_frame(noise: bytes) -> None:
    for size in (1, len(noise)):
        reader = frames.FrameReader(frames.MANAGER_WORDS)
        assert reader.feed(build_all()) == SENT
        with pytest.raises(ValueError, match="frame"):
            feed_in_pieces(reader, noise, size)


def test_two_pulses_may_be_late_and_a_cut_line_is_noticed_within_two_seconds() -> None:
    assert 3 * frames.PULSE_S <= frames.SILENCE_S < 2.0
