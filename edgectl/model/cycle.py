# SPDX-License-Identifier: Apache-2.0
"""One cycle of a watch: measurements, decision and results."""

from edgectl.dataclass import dataclass
from edgectl.model.event import Event
from edgectl.model.plan import Plan
from edgectl.model.result import Results
from edgectl.model.snapshot import Snapshot


@dataclass(frozen=True, slots=True, kw_only=True)
class Cycle:
    """``number`` counts from 1; ``at`` (s since 1970) is when it began, ``seconds`` how long it took.

    ``next_in``: seconds until the next one, None after the last. ``snapshot``: as measured; that of ``plan``
    is smoothed. ``plan`` is None while paused, ``results`` where nothing was carried out. ``events``: what
    was seen or done in this cycle. ``warnings``: what a user should know. ``busy``: who holds the lock, where
    that kept the plan from being carried out. ``error``: why the cycle was cut short. ``resting``: tasks that
    failed lately, with which nothing is tried for a while.
    """

    number: int
    at: float
    seconds: float = 0.0
    next_in: float | None = None
    paused: bool = False
    snapshot: Snapshot | None = None
    plan: Plan | None = None
    results: Results | None = None
    events: tuple[Event, ...] = ()
    warnings: tuple[str, ...] = ()
    resting: tuple[str, ...] = ()
    busy: str = ""
    error: str = ""
