# SPDX-License-Identifier: Apache-2.0
"""Plan: the executor's diff of an assignment against the running tasks."""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Certificate, Decision, DemandSpread, ExpectedLoad, Overuse, Shortage
from edgectl.model.encoding import Instant, in_document
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.model.standby_plan import StandbyStep


class Action(StrEnum):
    """Action on one task."""

    START = "start"
    STOP = "stop"
    MOVE = "move"
    KEEP = "keep"
    RESTART = "restart"
    ADOPT = "adopt"
    HOLD = "hold"
    COMPLETE = "complete"
    UNPLACED = "unplaced"
    DEFER = "defer"
    NONE = "none"

    @property
    def symbol(self) -> str:
        """One column, readable without colour."""
        return _SYMBOLS[self]

    @property
    def changes(self) -> bool:
        """Whether the action touches a host."""
        return self not in (Action.KEEP, Action.HOLD, Action.UNPLACED, Action.DEFER, Action.NONE)


_SYMBOLS = {
    Action.START: "+", Action.STOP: "-", Action.MOVE: "~", Action.KEEP: "=", Action.RESTART: "^",
    Action.ADOPT: "&",
    Action.HOLD: "?", Action.COMPLETE: "*", Action.UNPLACED: "!", Action.DEFER: ">", Action.NONE: ".",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One line of a plan: the decision and the action that follows from what runs.

    ``instances`` are the running instances that a stop, move, restart or complete concerns, by host. A task
    may run where it should not even while it is kept elsewhere: ``stop`` lists those hosts. ``changed`` names
    the fields of the spec that differ (restart), where known. ``standbys``: what becomes of its inactive
    copies, those that stop first.
    """

    decision: Decision = field(metadata=in_document(inline=True))
    action: Action
    instances: Mapping[str, str] = field(default_factory=dict)
    stop: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    standbys: tuple[StandbyStep, ...] = ()

    @property
    def changes(self) -> bool:
        """Whether the step touches any host."""
        return self.action.changes or bool(self.stop) or any(each.action.changes for each in self.standbys)

    @property
    def task(self) -> str:
        """Name of the task."""
        return self.decision.task


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A value that can be printed, saved, compared and refused; holds no command and no secret.

    ``created_at`` (s since 1970) is the snapshot's ``taken_at``. ``summary`` counts steps by action.
    ``tasks_left_alone``: running tasks of task files that were not given, by name with their file ("" where
    it is not known). ``overuses``: tasks that use more than they declare. ``shortages``: what the fleet
    lacks, whatever the placement. ``certificate``: how far the plan may be from the best one, where that was
    asked for. ``fleet``: its name; "" in a plan that an edgectl before the key has saved.
    """

    created_at: Instant
    fleet: str = field(default="", metadata=in_document(always=True))
    policy: Policy = field(metadata=in_document(inline=True))
    inventory_digest: str
    tasks_digest: str
    settled: bool
    steps: tuple[Step, ...] = field(metadata=in_document("decisions"))
    expected: Mapping[str, ExpectedLoad]
    frozen: bool = field(default=False, metadata=in_document(always=True))
    unseen: tuple[str, ...] = field(default=(), metadata=in_document(always=True))
    demand_spreads: tuple[DemandSpread, ...] = field(default=(), metadata=in_document(always=True))
    overuses: tuple[Overuse, ...] = field(default=(), metadata=in_document(always=True))
    shortages: tuple[Shortage, ...] = field(default=(), metadata=in_document(always=True))
    certificate: Certificate | None = None
    tasks_left_alone: Mapping[str, str] = field(default_factory=dict, metadata=in_document(always=True))
    snapshot: Snapshot

    @property
    def summary(self) -> dict[Action, int]:
        """Count of steps by action, in the order of the enum."""
        counts = dict.fromkeys(Action, 0)
        for step in self.steps:
            counts[step.action] += 1
        return {action: count for action, count in counts.items() if count}

    @property
    def changes(self) -> bool:
        """Whether applying the plan would touch any host."""
        return any(step.changes for step in self.steps)
