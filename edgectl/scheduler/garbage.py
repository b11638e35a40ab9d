# SPDX-License-Identifier: Apache-2.0
"""Python's garbage collector, paused while a plan is made (ADR 103)."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def pause_collection(*, large: bool = False) -> Iterator[None]:
    """Keep the cyclic collector from running until the end, if it was on. Not for what makes cycles.

    ``large``: so many objects are made that one look at them counts. They are old ones from the start, to be
    looked at when all objects are (ADR 59).
    """
    enabled = gc.isenabled()
    if enabled and large:
        gc.collect(1)  # young ones that others have made, who may make cycles
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            if large:
                _make_all_old()
            gc.enable()


def _make_all_old() -> None:
    """Make old objects of all young ones, without a look at them.

    That forgets how many looks at young ones there have been since the last one at all objects: they are made
    again, where nothing is left to look at, so that the next look at all comes when it would have come.
    """
    looks = min(gc.get_count()[2], gc.get_threshold()[2] + 1)
    gc.freeze()
    gc.unfreeze()
    for _ in range(looks):
        gc.collect(1)
