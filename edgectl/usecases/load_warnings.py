# SPDX-License-Identifier: Apache-2.0
"""Warnings of a watch about load: tasks that use more than they declare, and what the fleet lacks."""

from collections.abc import Collection

from edgectl.model.event import Event, EventKind
from edgectl.model.plan import Plan
from edgectl.model.resource import Resource


class LoadWarnings:
    """Each is given once: a shortage until it ends, an overuse for each host of its task. Their figures
    differ from reading to reading.
    """

    def __init__(self) -> None:
        self._short: tuple[Resource, ...] = ()
        self._overused: set[tuple[str, str | None]] = set()

    def list_new(self, plan: Plan, events: Collection[Event]) -> list[str]:
        """The new ones of ``plan``.

        ``events``: those that the watch shows with it; an overuse that lasts since before the watch has none.
        """
        lacking = [found.describe() for found in plan.shortages if found.resource not in self._short]
        self._short = tuple(found.resource for found in plan.shortages)
        shown = [each for each in events if each.kind is EventKind.TASK_OVERUSE]
        self._overused |= {(each.task or "", each.host) for each in shown}
        above = [found for found in plan.overuses if (found.task, found.host) not in self._overused]
        self._overused |= {(found.task, found.host) for found in above}
        return [*lacking, *(found.describe_run() for found in above)]
