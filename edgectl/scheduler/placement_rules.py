# SPDX-License-Identifier: Apache-2.0
"""Rules between tasks (ADR 73): ``apart``, ``together``, ``spread`` and ``group``. Pure."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field
from math import ceil

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Rejection, RejectionRule, Verdict
from edgectl.model.task import OnboardRule, Task, join_units
from edgectl.names import natural_key
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.feasibility import find_rule_against
from edgectl.scheduler.initial_state import InitialState

# Value of ``spread`` that is no label.
EVERY_HOST = "host"


@dataclass(frozen=True, slots=True, kw_only=True)
class OccupancyLimit:
    """At most ``most`` of ``others`` (a task itself does not count) in the domain of a task's place.

    ``domains``: the domain of each place: the place itself, or the value of a label.
    """

    rule: RejectionRule
    others: frozenset[str]
    most: int
    domains: Sequence[object]

    def find_excess(self, name: str, place: int, located: Mapping[str, int]) -> tuple[int, list[str]]:
        """How many too many there are for ``name`` in the domain of ``place``, and who is there."""
        domain = self.domains[place]
        there = [
            other
            for other in self.others
            if other != name and other in located and self.domains[located[other]] == domain
        ]
        return len(there) - self.most, there


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementRules:
    """The rules of all tasks.

    ``limits`` by task; ``units``: the tasks that share a host, by each of them, in sequence order;
    ``groups``: the members by the name of the group.
    """

    limits: Mapping[str, tuple[OccupancyLimit, ...]] = field(default_factory=dict)
    units: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def concern(self, name: str) -> bool:
        """Whether a rule concerns the place of task ``name``."""
        return name in self.limits or name in self.units


NO_RULES = PlacementRules()


def build_placement_rules(order: Sequence[Task], fleet: Capacities, state: InitialState) -> PlacementRules:
    """The rules between the tasks ``order``."""
    if not any(task.apart or task.together or task.spread or task.group for task in order):
        return NO_RULES
    limits: dict[str, list[OccupancyLimit]] = {}
    for name, others in join_apart(order).items():
        limits.setdefault(name, []).append(
            OccupancyLimit(rule=RejectionRule.APART, others=others, most=0, domains=range(len(fleet.places)))
        )
    for siblings in _list_spread_siblings(order):
        limit = _build_spread_limit(siblings, fleet, state)
        for task in siblings:
            limits.setdefault(task.name, []).append(limit)
    groups: dict[str, list[str]] = {}
    for task in order:
        if task.group is not None:
            groups.setdefault(task.group, []).append(task.name)
    return PlacementRules(
        limits={name: tuple(found) for name, found in limits.items()},
        units=join_units({task.name: task for task in order}),
        groups={group: tuple(members) for group, members in groups.items()},
    )


def join_apart(order: Sequence[Task]) -> dict[str, frozenset[str]]:
    """The tasks from which each one is apart: it counts for both who names whom."""
    apart: dict[str, set[str]] = {}
    for task in order:
        for other in task.apart:
            apart.setdefault(task.name, set()).add(other)
            apart.setdefault(other, set()).add(task.name)
    return {name: frozenset(others) for name, others in apart.items()}


def _list_spread_siblings(order: Sequence[Task]) -> Iterator[list[Task]]:
    entries: dict[tuple[str, str], list[Task]] = {}
    for task in order:
        if task.spread is not None:
            entries.setdefault((task.file, task.template), []).append(task)
    yield from entries.values()


def _build_spread_limit(siblings: Sequence[Task], fleet: Capacities, state: InitialState) -> OccupancyLimit:
    """No domain gets more than its part, where the tasks are dealt out evenly over those that are open."""
    label = siblings[0].spread or EVERY_HOST
    domains = [
        place if label == EVERY_HOST else host.labels.get(label, place)
        for place, host in enumerate(fleet.places)
    ]
    opened = {
        domains[edge]
        for edge in range(fleet.edges)
        if edge not in fleet.closed
        and any(
            task.onboard is not OnboardRule.ONLY
            and find_rule_against(fleet.places[edge], task, robot=False) is None
            for task in siblings
        )
    }
    fixed = (state.fixed.get(task.name) for task in siblings)
    absent = sum(each is not None and each.verdict in (Verdict.UNPLACED, Verdict.COMPLETED) for each in fixed)
    part = ceil((len(siblings) - absent) / max(1, len(opened)))
    return OccupancyLimit(
        rule=RejectionRule.SPREAD,
        others=frozenset(task.name for task in siblings),
        most=max(1, part) - 1,
        domains=domains,
    )


def list_breaches(rules: PlacementRules, located: Mapping[str, int]) -> set[tuple[str, int]]:
    """The tasks that break a rule at their places ``located``, with these places."""
    found = {
        (name, located[name])
        for name, limits in rules.limits.items()
        if name in located
        for limit in limits
        if limit.find_excess(name, located[name], located)[0] > 0
    }
    for unit in set(rules.units.values()):
        there = {(name, located[name]) for name in unit if name in located}
        if len({place for _, place in there}) > 1:
            found |= there
    return found


def bar_by_limits(
    limits: Sequence[OccupancyLimit],
    name: str,
    located: Mapping[str, int],
    incumbent: int | None = None,
    comes_later: Callable[[str], bool] = lambda _: False,
) -> dict[int, Rejection]:
    """The places that the tasks ``located`` bar for task ``name``.

    At its ``incumbent`` those do not count that come later in the sequence: they are the ones to leave.
    """
    barred: dict[int, Rejection] = {}
    for limit in limits:
        found = _list_occupied_domains(limit, name, located)
        full = {domain: there for domain, there in found.items() if len(there) > limit.most}
        for place, domain in enumerate(limit.domains if full else ()):
            there = full.get(domain, [])
            if place == incumbent:
                there = [other for other in there if not comes_later(other)]
            if len(there) > limit.most:
                barred.setdefault(place, Rejection(rule=limit.rule, task=min(there, key=natural_key)))
    return barred


def _list_occupied_domains(
    limit: OccupancyLimit, name: str, located: Mapping[str, int]
) -> dict[object, list[str]]:
    found: dict[object, list[str]] = {}
    for other in limit.others:
        if other != name and other in located:
            found.setdefault(limit.domains[located[other]], []).append(other)
    return found
