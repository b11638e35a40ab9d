# SPDX-License-Identifier: Apache-2.0
"""Options and record of a run of a plan."""

import threading
from collections.abc import Mapping
from dataclasses import field

from edgectl.dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """How a plan is carried out.

    ``max_parallel``: actions at once. ``stop_requested``: set it, and no further action begins.
    ``fail_fast``: nor after a failure; ``deadline`` (monotonic clock, None for none): nor after it.
    ``connect_s``, ``call_s``: deadlines of a connection and of a short request.
    ``poll_s``: pause before a condition is asked again.
    """

    max_parallel: int = 16
    fail_fast: bool = False
    deadline: float | None = None
    stop_requested: threading.Event = field(default_factory=threading.Event)
    connect_s: float = 15.0
    call_s: float = 15.0
    poll_s: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RunIdentity:
    """The record of one run: ``plan_id`` and ``revision`` name it, ``verb`` and ``user`` go into the journal.

    ``generations``: the generation to start each task with.
    """

    plan_id: str
    revision: int
    generations: Mapping[str, int] = field(default_factory=dict)
    verb: str = "apply"
    user: str = ""
