"""What is recorded of a choice: every host's terms, losers and rejected ones included (DESIGN section 4)."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from edgectl.model.assignment import RankedHost, Rejection, Rule, Terms
from edgectl.scheduler.affinity import reward
from edgectl.scheduler.rho import demands_at
from edgectl.scheduler.scan import PENALTY
from edgectl.scheduler.utility import EPSILON
from edgectl.scheduler.view import View, terms_at

# Above this many hosts a ranking keeps the winner, the incumbent and the best SHORT.
LONG, SHORT = 64, 16
_NO_TERMS = Terms(cpu=None, memory=None, network=None, task=None)


class Weighed(NamedTuple):
    """One place as the reference computes it."""

    place: int
    total: float | None
    terms: Terms
    rejections: tuple[Rejection, ...]


def ranking(view: View, chosen: int | None) -> tuple[tuple[RankedHost, ...], dict[str, int]]:
    """The hosts of one task, best first, and how many rejected hosts were left out, by the rule that rejects them."""
    kept, left_out = _kept(view, chosen)
    weighed = [_weigh(view, place) for place in kept]
    feasible = _ordered(view, [host for host in weighed if not host.rejections])
    order = view.setting.fleet.order
    rest = sorted(
        (host for host in weighed if host.rejections), key=lambda host: (host.total is None, -(host.total or 0.0), order[host.place])
    )
    entries = [_entry(view, host, _rank(view, host, position)) for position, host in enumerate(feasible, start=1)]
    entries += [_entry(view, host, 0) for host in rest]
    return tuple(entries), left_out


def _kept(view: View, chosen: int | None) -> tuple[Sequence[int], dict[str, int]]:
    """The places that the ranking holds, and how many rejected ones it leaves out, by rule."""
    if len(view.listed) <= LONG or view.setting.policy.full:
        return view.listed, {}
    totals = view.totals
    best = sorted(view.listed, key=totals.__getitem__, reverse=True)
    kept = {*best[:SHORT], *(place for place in (chosen, view.incumbent) if place is not None)}
    fitting = bisect_left(best, PENALTY / 2, key=lambda place: -totals[place])
    rules = Counter(_rule(view, place) for place in best[fitting:] if place not in kept)
    return sorted(kept), dict(sorted(rules.items()))


def _weigh(view: View, place: int) -> Weighed:
    denied = view.denied.get(place)
    if denied is not None:
        return Weighed(place, None, _NO_TERMS, (denied,))
    terms, total, rejections = terms_at(view, place)
    waived = (view.waived,) if view.waived is not None and place == view.incumbent else ()
    return Weighed(place, total, terms, waived + rejections)


def _ordered(view: View, hosts: list[Weighed]) -> list[Weighed]:
    """Best total first; totals that are equal within EPSILON in the order of the tie rule, so that rank 1 is the argmax."""
    order = view.setting.fleet.order
    hosts.sort(key=lambda host: (-(host.total or 0.0), order[host.place]))
    groups: list[list[Weighed]] = []
    for host in hosts:
        if groups and (groups[-1][0].total or 0.0) - (host.total or 0.0) <= EPSILON:
            groups[-1].append(host)
        else:
            groups.append([host])
    for group in groups:
        group.sort(key=lambda host: (host.place != view.incumbent, view.placed.get(host.place, 0), order[host.place]))
    return [host for group in groups for host in group]


def _rank(view: View, host: Weighed, position: int) -> int:
    """The position; an incumbent kept below a shortened ranking gets the position that it has among all."""
    if position <= SHORT or len(view.listed) <= LONG or view.setting.policy.full:
        return position
    return max(position, 1 + sum(total > view.totals[host.place] + EPSILON for total in view.totals))


def _entry(view: View, host: Weighed, rank: int) -> RankedHost:
    fleet = view.setting.fleet
    return RankedHost(
        host=view.name(host.place),
        rank=rank,
        total=host.total,
        terms=host.terms,
        feasible=rank > 0,
        affinity=reward(view.located, host.place),
        rejections=host.rejections,
        demand=demands_at(fleet, view.task, host.place) if view.task.name in fleet.demands else (),
    )


def _rule(view: View, place: int) -> str:
    """Why a place was rejected, without the numbers."""
    denied = view.denied.get(place)
    if denied is not None:
        return denied.rule.value
    fleet = view.setting.fleet
    robots = view.task.robots if place < fleet.edges else ()
    links = [fleet.links[robot][place] if robot in fleet.links else None for robot in robots]
    if None in links:
        return Rule.NO_LINK.value
    return Rule.NO_CAPACITY.value if 0.0 in (fleet.cpu[place], fleet.memory[place], *links) else Rule.INSUFFICIENT.value
