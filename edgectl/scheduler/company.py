# SPDX-License-Identifier: Apache-2.0
"""One task among those that it must, or must not, share a host with (ADR 73)."""

from collections.abc import Callable, Iterator, Mapping

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Rejection, RejectionRule, Verdict
from edgectl.model.task import Task
from edgectl.scheduler.candidates import AssignmentContext, CandidateSet, list_allowed_places
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.initial_state import RunningTask
from edgectl.scheduler.ledger import Ledger, compute_demand_usage
from edgectl.scheduler.placement_rules import bar_by_limits
from edgectl.scheduler.reservation import can_hold
from edgectl.scheduler.scan import is_feasible_total
from edgectl.scheduler.task_usage import TaskUsage, add_usage

Bars = Mapping[int, Rejection]


@dataclass(frozen=True, slots=True, kw_only=True)
class Company:
    """The other tasks at the moment when one comes up.

    ``open``: tasks that the pass decides, by name. ``running``: those of them that have a place at its begin.
    ``decided``: choices that it has made. ``located``: places of all tasks that have one.
    """

    context: AssignmentContext
    ledger: Ledger
    open: Mapping[str, Task]
    running: Mapping[str, RunningTask]
    decided: Mapping[str, Choice]
    located: Mapping[str, int]

    def list_mates(self, name: str) -> list[str]:
        """The tasks that share the host of ``name`` and have a place, or may still get one."""
        return [
            mate
            for mate in self.context.placement_rules.units.get(name, ())
            if mate != name and (mate in self.located or self.is_undecided(mate))
        ]

    def is_undecided(self, name: str) -> bool:
        """Whether the pass comes to ``name`` later."""
        return name in self.open and name not in self.decided

    def bar_by_limits(self, name: str, incumbent: int | None) -> dict[int, Rejection]:
        """The places that the limits of ``name`` bar."""
        limits = self.context.placement_rules.limits.get(name, ())
        return bar_by_limits(limits, name, self.located, incumbent, self.is_undecided) if limits else {}


def weigh_in_company(
    company: Company, task: Task, incumbent: int | None, weigh: Callable[..., CandidateSet]
) -> tuple[CandidateSet, Bars]:
    """The candidates of ``task`` without the places that rules between tasks bar, and these.

    The first of a unit that comes up takes it to a place where all of it has room; the others follow. A unit
    that runs leaves its host only if it must.
    """
    bars = company.bar_by_limits(task.name, incumbent)
    mates = company.list_mates(task.name)
    anchor = _find_anchor(company, mates, incumbent)
    if anchor is not None:
        bars = _bar_all_but(company, company.located[anchor], anchor) | bars
    elif mates and incumbent is not None:
        candidates = weigh(barred=_bar_all_but(company, incumbent, mates[0]) | bars)
        if is_feasible_total(candidates.totals[incumbent]):
            return candidates, bars
    if mates and anchor is None:
        bars = dict(_bar_without_room(company, task, incumbent, mates)) | bars
    return weigh(barred=bars), bars


def _find_anchor(company: Company, mates: list[str], incumbent: int | None) -> str | None:
    """The mate whose place decides: one that has been decided, or is none of the pass; for a task that does
    not run, also one that runs.
    """
    settled = [mate for mate in mates if mate in company.located and not company.is_undecided(mate)]
    if settled:
        return settled[0]
    runs = [mate for mate in mates if mate in company.located]
    return runs[0] if runs and incumbent is None else None


def _bar_all_but(company: Company, place: int, mate: str) -> dict[int, Rejection]:
    rejection = Rejection(rule=RejectionRule.TOGETHER, task=mate)
    return {each: rejection for each in range(len(company.context.fleet.places)) if each != place}


def _bar_without_room(
    company: Company, task: Task, incumbent: int | None, mates: list[str]
) -> Iterator[tuple[int, Rejection]]:
    """Places that cannot take ``task`` with all its ``mates``; the one where it runs is none of them.

    Under best effort a unit that starts needs no room; one that runs does not move to where it has none.
    """
    context = company.context
    joining = [company.open[mate] for mate in mates]
    allowed = [
        (
            mate.name,
            set(list_allowed_places(context, mate, company.located.get(mate.name)))
            - company.bar_by_limits(mate.name, None).keys(),
        )
        for mate in joining
    ]
    for place in list_allowed_places(context, task, incumbent):
        if place == incumbent:
            continue
        lacking = next((name for name, places in allowed if place not in places), None)
        if lacking is None and not (context.policy.best_effort and incumbent is None):
            use = compute_demand_usage(context.fleet, task, place)
            for mate in joining:
                if company.located.get(mate.name) != place:
                    use = add_usage(use, compute_demand_usage(context.fleet, mate, place))
            lacking = None if can_hold(company.ledger, place, use) else mates[0]
        if lacking is not None:
            yield place, Rejection(rule=RejectionRule.TOGETHER, task=lacking)


def follows_unit(company: Company, name: str) -> bool:
    """Whether the unit of ``name`` leaves the host where it runs in this pass."""
    mates = company.context.placement_rules.units.get(name, ())
    return any(
        mate in company.running and company.decided[mate].verdict is Verdict.PLACED
        for mate in mates
        if mate in company.decided
    )


def list_reservations(company: Company, name: str, place: int) -> Iterator[tuple[str, TaskUsage]]:
    """What the mates of ``name`` that come later will need at ``place``, as far as there is room."""
    for mate in company.list_mates(name):
        if company.is_undecided(mate) and company.located.get(mate) != place:
            use = compute_demand_usage(company.context.fleet, company.open[mate], place)
            if can_hold(company.ledger, place, use):
                yield mate, use
