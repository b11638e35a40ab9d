# SPDX-License-Identifier: Apache-2.0
"""States that runs of one mission under one policy have in common (ADR 167).

A run passes through some twenty of them, most of which are those of a run before: the same tasks run on the
same hosts, only earlier or later. What hosts and links give is the same then, and so is what a plan is
decided from.
"""

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from edgectl.experiments.model.scenario import Scenario
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Step
from edgectl.model.policy import Policy
from edgectl.model.snapshot import LinkSample, Snapshot, TaskSample
from edgectl.model.task import Tasks
from edgectl.scheduler.assign import PreparedPlan
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
    """Shares and speeds of all tasks, or of those on one host, as `SimState` has them, and what is in use by
    host. Never changed.
    """

    cores: dict[str, float]
    rates: dict[str, dict[str, float]]
    speeds: dict[str, float]
    used: dict[str, HostUse]


def join_shares(parts: Iterable[KnownShares]) -> KnownShares:
    """The shares of all hosts, from those of each."""
    joined = KnownShares({}, {}, {}, {})
    for part in parts:
        joined.cores.update(part.cores)
        joined.rates.update(part.rates)
        joined.speeds.update(part.speeds)
        joined.used.update(part.used)
    return joined


class SimSample(NamedTuple):
    """What a probe of one host shows: cores and bytes in use, and samples of links and tasks."""

    cpu: float
    memory: float
    links: Mapping[str, LinkSample]
    tasks: Mapping[str, TaskSample]


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
    """Known states of this mission under this policy, whatever its seed.

    ``shares``: of states of the whole fleet; ``hosts`` and ``samples``: of single hosts, which many such
    states have in common. ``first_plan``: of any state, for what the plans of all states are decided from.
    """

    inventory: Inventory
    tasks: Tasks
    scenario: Scenario
    policy: Policy
    shares: dict[Hashable, KnownShares] = field(default_factory=dict)
    hosts: dict[Hashable, KnownShares] = field(default_factory=dict)
    samples: dict[Hashable, SimSample] = field(default_factory=dict)
    cycles: dict[Hashable, KnownCycle] = field(default_factory=dict)
    first_plan: PreparedPlan | None = None

    def is_of(self, inventory: Inventory, tasks: Tasks, scenario: Scenario, policy: Policy) -> bool:
        """Whether these are the mission and the policy of which the states are known."""
        same = self.inventory is inventory and self.tasks is tasks and self.scenario is scenario
        return same and self.policy == replace(policy, seed=self.policy.seed)

    def add_shares(self, key: Hashable, known: KnownShares) -> None:
        """Keep what is in use in one state."""
        if len(self.shares) >= _MAX_STATES:
            self.shares.clear()
        self.shares[key] = known

    def add_host(self, key: Hashable, known: KnownShares) -> None:
        """Keep what is in use on one host in one state of it."""
        if len(self.hosts) >= _MAX_STATES:
            self.hosts.clear()
        self.hosts[key] = known

    def add_sample(self, key: Hashable, known: SimSample) -> None:
        """Keep what a probe shows of one host in one state of it."""
        if len(self.samples) >= _MAX_STATES:
            self.samples.clear()
        self.samples[key] = known

    def add_cycle(self, key: Hashable, known: KnownCycle) -> None:
        """Keep what a plan is decided from in one state."""
        if len(self.cycles) >= _MAX_STATES:
            self.cycles.clear()
        self.cycles[key] = known
