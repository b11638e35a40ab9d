# SPDX-License-Identifier: Apache-2.0
"""Python's garbage collector, paused while a plan is made (ADR 103)."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def pause_collection() -> Iterator[None]:
    """Keep the cyclic collector from running until the end, if it was on. Not for what makes cycles."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
