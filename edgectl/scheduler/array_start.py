# SPDX-License-Identifier: Apache-2.0
"""Start of a task on a fleet of very many pairs, where eq. (4) alone decides (ADR 147). Pure.

Nearly every task of a large plan starts, is bound by no rule between tasks, and has one host that is better
than all others. Then the totals of the scan say who wins, and the numbers of two hosts are all that is
computed besides. Wherever anything else may decide, the answer is None, and ``single_pass`` weighs the task
in full: both ways make the same decision to the last bit.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.demand import ZERO
from edgectl.model.policy import Preference
from edgectl.model.resource import AFFINITY, LATENCY, NETWORK, RATING, RESOURCES_BY_NAME
from edgectl.model.task import Task
from edgectl.scheduler.array_scan import Array, ArrayScan, ArrayTotals, FreeArrays, fill_link_terms
from edgectl.scheduler.candidates import AssignmentContext, get_edge_rejections
from edgectl.scheduler.demand import demand_at
from edgectl.scheduler.latency import NO_LATENCY_TERM, has_prediction
from edgectl.scheduler.lazy_ranking import LazyCounts, LazyDemands, LazyRanking, LoadHistory, RankingRequest
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.scan import EXCLUDED_TOTAL, list_uncounted_demands
from edgectl.scheduler.task_usage import TaskUsage
from edgectl.scheduler.utility import EPSILON, compute_affinity, resource_utility

# A term of this or more fits by the scan as well as by the reference, however they round.
_LEAST_TERM = -EPSILON / 2
_NONE_MEASURED: Mapping[str, float] = MappingProxyType({})
Starter = Callable[[Task, Mapping[str, int]], "Start | None"]


class Score(NamedTuple):
    """Eq. (4) at one place in the reference form: total, its part for predecessors, and the load there."""

    place: int
    total: float
    affinity: float
    used: dict[str, float]
    links: dict[str, float]


class Start(NamedTuple):
    """The place of a task that starts, its load there, and the decision, where one is asked for."""

    place: int
    use: TaskUsage
    decision: Decision | None


class _Outcome(NamedTuple):
    """The place of a task, the feasible one that comes second, and why the first won."""

    first: Score
    second: Score | None
    reason: Reason
    subject: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StartTable:
    """Whatever is the same for all starts of one pass.

    ``rows`` by resource that counts: name and weight; of hosts also capacity before and after limits, and
    gamma, by place. ``idle``: a load of nothing. ``history``: of the pass, where decisions are asked for.
    ``totals`` by place, and ``links``, UT_net by edge, are of the last task, as is ``scratch``.
    ``utilities``: UT_task by reward, by the number of predecessors and the rewards.
    """

    context: AssignmentContext
    ledger: Ledger
    arrays: ArrayScan
    free: FreeArrays
    history: LoadHistory | None
    totals: ArrayTotals
    links: Array
    scratch: Array
    rows: Sequence[tuple[str, float, Sequence[float], Sequence[float], Sequence[float]]]
    idle: Mapping[str, float]
    utilities: dict[tuple[int, ...], Mapping[int, float]] = field(default_factory=dict)


def build_starter(context: AssignmentContext, ledger: Ledger, history: LoadHistory | None) -> Starter | None:
    """Starts tasks in a pass with ``ledger``; None where totals alone never decide.

    The tasks run nowhere, and no rule between tasks concerns them. None of a task: the full way must decide.
    """
    policy, fleet = context.policy, context.fleet
    plain = policy.prefer is not Preference.PACK and context.rules.edges
    others = (LATENCY, RATING, *(name for name in ledger.used if name not in fleet.counted))
    plain = plain and not any(policy.weights[name] for name in others)
    if context.arrays is None or ledger.mirror is None or not plain:
        return None
    table = StartTable(
        context=context,
        ledger=ledger,
        arrays=context.arrays,
        free=ledger.mirror,
        rows=[
            (
                name,
                policy.weights[name],
                fleet.raw.get(name, ()),
                fleet.usable.get(name, ()),
                ledger.used.get(name, ()),
            )
            for name in RESOURCES_BY_NAME
            if name == NETWORK.name or name in fleet.counted
        ],
        idle=dict.fromkeys((name for name in RESOURCES_BY_NAME if name in ledger.used), 0.0),
        history=history,
        totals=ArrayTotals(np.full(len(fleet.places), EXCLUDED_TOTAL)),
        links=np.empty(fleet.edges),
        scratch=np.empty(fleet.edges),
    )
    return partial(_start_task, table)


def _start_task(table: StartTable, task: Task, predecessors: Mapping[str, int]) -> Start | None:
    outcome = _find_outcome(table, task, predecessors)
    if outcome is None:
        return None
    first = outcome.first
    return Start(
        place=first.place,
        use=TaskUsage(used=first.used, links=first.links),
        decision=_build_start_decision(table, table.history, outcome, task, predecessors)
        if table.history is not None
        else None,
    )


def _find_outcome(table: StartTable, task: Task, predecessors: Mapping[str, int]) -> _Outcome | None:
    context = table.context
    fleet = context.fleet
    if task.standby is not None or has_prediction(task) or task.name in fleet.floors:
        return None
    if context.rules.robot_of(fleet, task) is not None or list_uncounted_demands(fleet, task):
        return None
    located = tuple(predecessors.values())
    denied = get_edge_rejections(context, task)
    near = {place for place in located if place < fleet.edges and place not in denied}
    utilities = _rate_places(table, located, near, far=len(denied) + len(near) < fleet.edges)
    _compute_totals(table, task, near, located, utilities)
    if denied:
        table.totals.exclude(denied)
    leaders = table.totals.find_leaders()
    if leaders is None:
        return None

    def score(place: int) -> Score | None:
        return _score_edge(table, task, place, utilities[compute_affinity(located, place)])

    first = score(leaders[0])
    second = None if leaders[1] is None else score(leaders[1])
    if first is None or (second is None) is not (leaders[1] is None):
        return None
    if task.hosts.pin is not None:
        return _Outcome(first, second, Reason.PINNED)
    if second is None:
        return _Outcome(first, None, Reason.ONLY_FEASIBLE)
    if first.place not in near:
        return _Outcome(first, second, Reason.BEST)
    return _compare_without_affinity(predecessors, table.totals, near, (first, second), score)


def _compare_without_affinity(
    predecessors: Mapping[str, int],
    totals: ArrayTotals,
    near: Collection[int],
    leaders: tuple[Score, Score],
    score: Callable[[int], Score | None],
) -> _Outcome | None:
    """The outcome of a task that goes beside a predecessor: for its sake, if another place has more room."""
    first, second = leaders
    rivals = [first, *_list_rivals(totals, near, first, second, score)]
    if None in rivals:
        return None
    best = max(rival.total - rival.affinity for rival in rivals if rival is not None)
    if not first.total - first.affinity < best - EPSILON:
        return _Outcome(first, second, Reason.BEST)
    there = next(name for name, place in predecessors.items() if place == first.place)
    return _Outcome(first, second, Reason.WITH_PREDECESSOR, there)


def _rate_places(
    table: StartTable, located: tuple[int, ...], near: Collection[int], *, far: bool
) -> Mapping[int, float]:
    """UT_task by reward: of the places ``near`` predecessors, and of others if there are any (``far``)."""
    rewards = {compute_affinity(located, place) for place in near}
    if far:
        rewards.add(-len(located))
    key = len(located), *rewards
    found = table.utilities.get(key)
    if found is None:
        found = table.utilities[key] = table.context.rules.rate_affinity(rewards, len(located))
    return found


def _compute_totals(
    table: StartTable,
    task: Task,
    near: Collection[int],
    located: tuple[int, ...],
    utilities: Mapping[int, float],
) -> None:
    """Eq. (4) at every edge, whether the task fits there or not: see `ArrayScan.compute_totals`."""
    weights, shares, free = table.context.policy.weights, table.arrays.shares, table.free
    weight, far = weights[AFFINITY], utilities.get(-len(located), 0.0)
    row = table.totals.row
    totals = np.add(free.weighted, weight * far, out=row[: len(free.weighted)])
    totals -= shares.weigh_hosts(task, table.arrays.weights)
    fill_link_terms(table.links, free, shares, task)
    totals += np.multiply(table.links, weights[NETWORK.name], out=table.scratch)
    for place in near:
        row[place] += weight * (utilities[compute_affinity(located, place)] - far)


def _list_rivals(
    totals: ArrayTotals,
    near: Collection[int],
    first: Score,
    second: Score,
    score: Callable[[int], Score | None],
) -> list[Score | None]:
    """The other places that might have won without predecessors: beside one, and the best of the rest."""
    rest: Score | None = second
    places = [place for place in near if place != first.place]
    if second.place in near:
        others = totals.copy()
        others.exclude(near)
        top = others.find_top()
        if top is None:
            return [score(place) for place in places]
        rest = score(top)
    return [rest, *(score(place) for place in places)]


def _score_edge(table: StartTable, task: Task, place: int, utility: float) -> Score | None:
    """The reference computation at one edge (``feasibility``), without its terms; None where it lacks
    something, or nearly.

    ``utility``: UT_task there.
    """
    ledger, weights = table.ledger, table.context.policy.weights
    fleet = ledger.fleet
    known = fleet.demands.get(task.name)
    measured = _NONE_MEASURED if known is None else known.get_measured(fleet.classes[place])
    worst, links = 1.0, {}
    for robot in task.robots:
        row = fleet.links.get(robot)
        now, best = (None, None) if row is None else (row[place], fleet.nominal_links[robot][place])
        if not now or best is None:
            return None
        rate = measured.get(NETWORK.name)
        if rate is None:
            rate = (demand_at(fleet, task, place)[NETWORK.name] or ZERO).of(best)
        links[robot] = rate
        worst = min(worst, resource_utility(now, ledger.links[robot][place], rate))
    used = dict(table.idle)
    total = 0.0
    for name, weight, raw, usable, loads in table.rows:
        term = worst
        if name != NETWORK.name:
            amount = measured.get(name)
            if amount is None:
                amount = (demand_at(fleet, task, place)[name] or ZERO).of(raw[place])
            used[name] = amount
            capacity = usable[place]
            term = resource_utility(capacity, loads[place], amount) if capacity > 0 else -1.0
        if term < _LEAST_TERM:
            return None
        total += weight * term
    affinity = weights[AFFINITY] * utility
    total += affinity
    total += weights[LATENCY] * NO_LATENCY_TERM
    return Score(place, total, affinity, used, links)


def _build_start_decision(
    table: StartTable,
    history: LoadHistory,
    outcome: _Outcome,
    task: Task,
    predecessors: Mapping[str, int],
) -> Decision:
    """The decision that ``decisions.build_decision`` makes of the same task."""
    places = table.context.fleet.places
    first, second = outcome.first, outcome.second
    ranking = RankingRequest(
        context=table.context,
        history=history,
        step=len(history.changes),
        task=task,
        incumbent=None,
        predecessors=predecessors,
        stays=False,
        chosen=first.place,
    )
    return Decision(
        task=task.name,
        verdict=Verdict.PLACED,
        reason=outcome.reason,
        host=places[first.place].name,
        total=first.total,
        lead=None if second is None else first.total - second.total,
        challenger=None if second is None else places[second.place].name,
        subject=outcome.subject,
        ranking=LazyRanking(ranking),
        rejection_counts=LazyCounts(ranking),
        demand=LazyDemands(ranking, first.place),
    )
