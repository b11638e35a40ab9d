# SPDX-License-Identifier: Apache-2.0
"""Random numbers of runs and of their events, each stream out of a seed of its own."""

import random
from collections.abc import Callable


def build_uniform_draw(seed: str) -> Callable[[str], float]:
    """Draws from 0 to 1 from a stream for each name: none depends on how often another is used."""
    streams: dict[str, random.Random] = {}

    def draw(name: str) -> float:
        if name not in streams:
            streams[name] = create_stream(f"{seed}/event/{name}")
        return streams[name].random()

    return draw


def create_stream(seed: str) -> random.Random:
    """A generator that depends on ``seed`` alone."""
    return random.Random(seed)  # noqa: S311 - not for security
