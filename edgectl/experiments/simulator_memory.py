# SPDX-License-Identifier: Apache-2.0
"""States that runs of one mission under one policy have in common (ADR 167).

A run passes through some twenty of them, most of which are those of a run before: the same tasks run on the
same hosts, only earlier or later. What hosts and links give is the same then, and so is what a plan is
decided from.
"""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from edgectl.experiments.model.scenario import Scenario
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Step
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.known_plan import KnownPlan
from edgectl.scheduler.stay_limits import StayLimits

# States of a kind, some 10 kB each, before a memory begins anew.
_MAX_STATES = 5000


class HostUse(NamedTuple):
    """What is in use on one host: cores, bytes, bytes/s; ``rated``: speed, and frames/s at full speed, of
    each of its tasks that has some.
    """

    cpu: float
    memory: float
    network: float
    rated: tuple[tuple[float, float], ...]


class KnownShares(NamedTuple):
    """Shares and speeds of all tasks, as `SimState` has them, and what is in use by host. Never changed."""

    cores: dict[str, float]
    rates: dict[str, dict[str, float]]
    speeds: dict[str, float]
    used: Mapping[str, HostUse]


@dataclass(slots=True, kw_only=True)
class KnownCycle:
    """What a plan was decided from, the snapshot of it, and the steps by what was decided.

    ``standing``: the steps, where no reading counts for them. ``kept``: those of the plan as long as the
    readings stay within ``limits``.
    """

    plan: KnownPlan
    snapshot: Snapshot
    limits: StayLimits | None
    steps: dict[Hashable, tuple[Step, ...]] = field(default_factory=dict)
    standing: tuple[Step, ...] | None = None
    kept: tuple[Step, ...] | None = None


@dataclass(slots=True, kw_only=True)
class SimMemory:
    """Known states of this mission under this policy, whatever its seed."""

    inventory: Inventory
    tasks: Tasks
    scenario: Scenario
    policy: Policy
    shares: dict[Hashable, KnownShares] = field(default_factory=dict)
    cycles: dict[Hashable, KnownCycle] = field(default_factory=dict)

    def is_of(self, inventory: Inventory, tasks: Tasks, scenario: Scenario, policy: Policy) -> bool:
        """Whether these are the mission and the policy of which the states are known."""
        same = self.inventory is inventory and self.tasks is tasks and self.scenario is scenario
        return same and self.policy == replace(policy, seed=self.policy.seed)

    def add_shares(self, key: Hashable, known: KnownShares) -> None:
        """Keep what is in use in one state."""
        if len(self.shares) >= _MAX_STATES:
            self.shares.clear()
        self.shares[key] = known

    def add_cycle(self, key: Hashable, known: KnownCycle) -> None:
        """Keep what a plan is decided from in one state."""
        if len(self.cycles) >= _MAX_STATES:
            self.cycles.clear()
        self.cycles[key] = known
