# SPDX-License-Identifier: Apache-2.0
"""Readings of CPU up to which every running task of a known plan stays where it is (ADR 123). Pure.

The totals of eq. (4) differ between two plans of one state by the CPU in use alone. So what another edge
lacks to take a task from its own is a number, computed once, and a plan of which all tasks stay below theirs
needs no pass: nothing leaves its place in it, and gamma is the same for each of them.
"""

from collections.abc import Iterator, Sequence

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Assignment, Decision, Reason, Verdict
from edgectl.model.policy import Preference
from edgectl.model.resource import AFFINITY, CPU, LATENCY, NETWORK, RATING
from edgectl.model.task import Task
from edgectl.scheduler.assign import PreparedPlan
from edgectl.scheduler.candidates import CandidateSet, gather_candidates
from edgectl.scheduler.choice import Choice, choose_by_utility
from edgectl.scheduler.decisions import build_plain_decision
from edgectl.scheduler.placement_rules import NO_RULES
from edgectl.scheduler.scan import compute_unlimited_totals
from edgectl.scheduler.utility import compute_affinity


@dataclass(frozen=True, slots=True, kw_only=True)
class StayLimits:
    """``leads``: how much more of its CPU, as a share, may be free at the second place than at the first.
    ``floors``: the least free share of CPU at a place; below 0 by the slack (ADR 61).
    """

    leads: tuple[tuple[int, int, float], ...]
    floors: tuple[tuple[int, float], ...]

    def hold(self, free: Sequence[float]) -> bool:
        """Whether a plan with these ``free`` shares of CPU, by place, leaves all tasks where they run."""
        for place, least in self.floors:
            if free[place] < least:
                return False
        return all(free[other] - free[here] <= lead for here, other, lead in self.leads)


def find_stay_limits(prepared: PreparedPlan) -> StayLimits | None:
    """The limits of the tasks of a plan; None where more than CPU decides, or a task runs nowhere.

    Under a policy that moves nothing every reading is within them.
    """
    how, state = prepared.how, prepared.how.initial
    tasks = [task for task in how.order if task.name not in state.fixed]
    if not all(_is_plain(task) for task in tasks):
        return None
    if not how.rules.moves:
        return StayLimits(leads=(), floors=()) if all(task.name in state.running for task in tasks) else None
    if not _is_decided_by_totals(prepared):
        return None
    leads: dict[tuple[int, int], float] = {}
    for task in tasks:
        found = _list_leads(prepared, task)
        if found is None:
            return None
        for here, other, lead in found:
            leads[here, other] = min(lead, leads.get((here, other), lead))
    tolerant, fleet = how.rules.candidates.tolerant, how.context.fleet
    return StayLimits(
        leads=tuple((here, other, lead) for (here, other), lead in leads.items()),
        floors=tuple(
            (place, -fleet.get_slack(CPU, place) if tolerant else 0.0)
            for place in sorted({there.place for there in state.running.values()})
        ),
    )


def keep_running_tasks(prepared: PreparedPlan) -> Assignment:
    """The plan of readings within the limits, without numbers: every running task stays where it is.

    Where `decide_plan` says below the margin, or dwell, this says still best.
    """
    state, fleet = prepared.how.initial, prepared.how.context.fleet
    reason = Reason.STILL_BEST if prepared.how.rules.moves else Reason.NEVER_MOVED
    decisions = list[Decision]()
    for task in prepared.how.order:
        fixed = state.fixed.get(task.name)
        if fixed is None:
            place = state.running[task.name].place
            stays = Choice(verdict=Verdict.KEPT, reason=reason, place=place)
            fixed = build_plain_decision(fleet, task, stays, place)
        decisions.append(fixed)
    return Assignment(
        policy=prepared.policy,
        decisions=tuple(decisions),
        expected={},
        frozen=state.frozen,
        unseen=state.unseen,
    )


def _is_decided_by_totals(prepared: PreparedPlan) -> bool:
    how, policy = prepared.how, prepared.how.context.policy
    return (
        how.rules.choose is choose_by_utility
        and how.context.placement_rules is NO_RULES
        and policy.prefer is not Preference.PACK
        and policy.weights[CPU.name] >= 0.0
        and policy.weights[LATENCY] == policy.weights[RATING] == 0.0
        and not policy.rebalance
        and not prepared.pins
    )


def _is_plain(task: Task) -> bool:
    return task.standby is None and not task.hard_deadline


def _list_leads(prepared: PreparedPlan, task: Task) -> list[tuple[int, int, float]] | None:
    """(its place, another edge, the lead of that edge up to which it stays); None: it may leave anyway."""
    context, state = prepared.how.context, prepared.how.initial
    running = state.running.get(task.name)
    if running is None or running.place >= context.fleet.edges:
        return None
    here, weight = running.place, context.policy.weights[CPU.name]
    candidates = gather_candidates(
        context,
        state.ledger,
        task,
        incumbent=here,
        predecessors={
            need.task: state.located[need.task] for need in task.needs if need.task in state.located
        },
        placed={},
    )
    present = _compute_present_total(candidates, here)
    if present is None or any(place not in candidates.denied for place in candidates.robots):
        return None
    free, found = state.ledger.free[CPU.name], list[tuple[int, int, float]]()
    for other, total in _list_other_totals(candidates, here):
        missing = context.policy.move_margin - (total - present)
        if weight > 0.0:
            found.append((here, other, free[other] - free[here] + missing / weight))
        elif missing < 0.0:
            return None
    return found


def _compute_present_total(candidates: CandidateSet, here: int) -> float | None:
    """Eq. (4) at ``here``, whose gamma has the task; None where it may not stay, or lacks more than CPU."""
    ledger, weights = candidates.ledger, candidates.context.policy.weights
    rows = [ledger.free_links.get(robot) for robot in candidates.task.robots]
    if here in candidates.denied or None in rows:
        return None
    link = min([row[here] for row in rows if row is not None], default=1.0)
    others = [row[here] for name, row in ledger.free.items() if name != CPU.name]
    if min([link, *others]) < 0.0:
        return None
    utility = candidates.utilities[compute_affinity(candidates.located, here)]
    return ledger.weigh_free(weights)[here] + weights[NETWORK.name] * link + weights[AFFINITY] * utility


def _list_other_totals(candidates: CandidateSet, here: int) -> Iterator[tuple[int, float]]:
    """Eq. (4) at each other edge that may take the task, as if there were room."""
    context, weights = candidates.context, candidates.context.policy.weights
    totals = compute_unlimited_totals(candidates.ledger, context.shares, candidates.task, weights)
    for place, total in enumerate(totals):
        if place != here and place not in candidates.denied:
            utility = candidates.utilities[compute_affinity(candidates.located, place)]
            yield place, total + weights[AFFINITY] * utility
