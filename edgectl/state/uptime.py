# SPDX-License-Identifier: Apache-2.0
"""Uptime of this machine: a clock that cannot be set."""

import time
from dataclasses import field
from functools import cache
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.model.encoding import in_document

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True, kw_only=True)
class Uptime:
    """``seconds`` since the start of the machine, time asleep included where the kernel counts it.

    ``boot`` names the start.
    """

    boot: str
    seconds: float = field(metadata=in_document("uptime_s"))


def read_uptime() -> Uptime:
    """Now."""
    clock = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
    return Uptime(boot=_read_boot_id(), seconds=time.clock_gettime(clock))


@cache
def _read_boot_id() -> str:
    """Empty where it cannot be read. Read once, for each request needs it and it takes 50 us."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""


def compute_elapsed_s(since: Uptime, now: Uptime) -> float:
    """Seconds from ``since`` to ``now``.

    Across a restart of the machine at least those since the restart: never too many.
    """
    same = since.boot == now.boot and since.seconds <= now.seconds
    return now.seconds - since.seconds if same else now.seconds
