# SPDX-License-Identifier: Apache-2.0
"""Failure of a handoff: where the task stands now, and whether anything steers its robot."""

from edgectl.errors import HostError


class HandoffError(Exception):
    """A failed handoff; ``located``: the host of the task now, ``steers``: a ready instance is there."""

    def __init__(
        self, error: HostError, located: str | None, *, steers: bool, downtime_s: float | None = None
    ) -> None:
        super().__init__(error.message)
        self.error = error
        self.located = located
        self.steers = steers
        self.downtime_s = downtime_s
