# SPDX-License-Identifier: Apache-2.0
"""Start of a task on a fleet of very many pairs, where eq. (4) alone decides (ADR 147). Pure.

Nearly every task of a large plan starts and is bound by no rule between tasks. Then the totals of the scan,
and the tie rule where they are equal, say who wins, and the numbers of two hosts are all that is computed
besides. Wherever anything else may decide, the answer is None, and ``single_pass`` weighs the task in full:
both ways make the same decision to the last bit.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.demand import ZERO
from edgectl.model.resource import AFFINITY, LATENCY, NETWORK, RESOURCES_BY_NAME
from edgectl.model.task import Task
from edgectl.scheduler.array_leaders import (
    LEAST_TERM,
    StartTotals,
    build_start_totals,
    fill_totals,
    find_leaders,
    rate_places,
)
from edgectl.scheduler.array_scan import ArrayTotals
from edgectl.scheduler.candidates import AssignmentContext, get_edge_rejections
from edgectl.scheduler.latency import NO_LATENCY_TERM, has_prediction
from edgectl.scheduler.lazy_ranking import LazyCounts, LazyDemands, LazyRanking, LoadHistory, RankingRequest
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.scan import EXCLUDED_TOTAL, list_uncounted_demands
from edgectl.scheduler.task_usage import TaskUsage
from edgectl.scheduler.utility import EPSILON, compute_affinity, resource_utility

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
    gamma, by place; ``names`` of them all. ``idle``: a load of nothing. ``history``: of the pass, where
    decisions are asked for.
    """

    start: StartTotals
    context: AssignmentContext
    ledger: Ledger
    history: LoadHistory | None
    rows: Sequence[tuple[str, float, Sequence[float], Sequence[float], Sequence[float]]]
    names: frozenset[str]
    idle: Mapping[str, float]


def build_starter(
    context: AssignmentContext, ledger: Ledger, history: LoadHistory | None, placed: Mapping[int, int]
) -> Starter | None:
    """Starts tasks in a pass with ``ledger``; None where totals alone never decide. ``placed``: how many the
    pass has put on each place so far.

    The tasks run nowhere, and no rule between tasks concerns them. None of a task: the full way must decide.
    """
    policy, fleet = context.policy, context.fleet
    start = build_start_totals(context, ledger, placed)
    if start is None:
        return None
    names = [name for name in RESOURCES_BY_NAME if name == NETWORK.name or name in fleet.counted]
    table = StartTable(
        start=start,
        context=context,
        ledger=ledger,
        history=history,
        rows=[
            (
                name,
                policy.weights[name],
                fleet.raw.get(name, ()),
                fleet.usable.get(name, ()),
                ledger.used.get(name, ()),
            )
            for name in names
        ],
        names=frozenset(names),
        idle=dict.fromkeys((name for name in RESOURCES_BY_NAME if name in ledger.used), 0.0),
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
    utilities = rate_places(table.start, located, near, far=len(denied) + len(near) < fleet.edges)
    fill_totals(table.start, task, near, located, utilities)
    if denied:
        table.start.totals.exclude(denied)
    leaders = find_leaders(table.start, task, located)
    if leaders is None:
        return None

    def score(place: int) -> Score | None:
        return _score_edge(table, task, place, utilities[compute_affinity(located, place)])

    first = score(leaders.first)
    second = None if leaders.second is None else score(leaders.second)
    if first is None or (second is None) is not (leaders.second is None):
        return None
    if task.hosts.pin is not None:
        return _Outcome(first, second, Reason.PINNED)
    if second is None:
        return _Outcome(first, None, Reason.ONLY_FEASIBLE)
    if first.place not in near:
        return _Outcome(first, second, Reason.BEST)
    return _compare_without_affinity(predecessors, table.start.totals, near, (first, second), score)


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


def _list_rivals(
    totals: ArrayTotals,
    near: Collection[int],
    first: Score,
    second: Score,
    score: Callable[[int], Score | None],
) -> list[Score | None]:
    """The other places that might have won without predecessors: beside one, and the best of the rest.

    Nothing asks for the totals afterwards.
    """
    for place in near:
        totals[place] = EXCLUDED_TOTAL
    top = totals.find_top()
    rest = [] if top is None else [second if top == second.place else score(top)]
    return [*rest, *(score(place) for place in near if place != first.place)]


def _score_edge(table: StartTable, task: Task, place: int, utility: float) -> Score | None:
    """The reference computation at one edge (``feasibility``), without its terms; None where it lacks
    something, or nearly.

    ``utility``: UT_task there.
    """
    ledger, weights = table.ledger, table.context.policy.weights
    fleet = ledger.fleet
    known, stated = fleet.demands.get(task.name), task.demand
    measured = _NONE_MEASURED if known is None else known.get_measured(fleet.classes[place])
    if known is not None and not table.names.issubset(measured):
        stated = known.at(fleet.classes[place])
    worst, links = 1.0, {}
    for robot in task.robots:
        row = fleet.links.get(robot)
        now, best = (None, None) if row is None else (row[place], fleet.nominal_links[robot][place])
        if not now or best is None:
            return None
        rate = measured.get(NETWORK.name)
        if rate is None:
            rate = (stated[NETWORK.name] or ZERO).of(best)
        links[robot] = rate
        worst = min(worst, resource_utility(now, ledger.links[robot][place], rate))
    used = dict(table.idle)
    total = 0.0
    for name, weight, raw, usable, loads in table.rows:
        term = worst
        if name != NETWORK.name:
            amount = measured.get(name)
            if amount is None:
                amount = (stated[name] or ZERO).of(raw[place])
            used[name] = amount
            capacity = usable[place]
            term = resource_utility(capacity, loads[place], amount) if capacity > 0 else -1.0
        if term < LEAST_TERM:
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
