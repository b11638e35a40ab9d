"""Relocations and swaps that raise the sum of utilities of a whole plan (ADR 66). Pure and deterministic."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from edgectl.model.policy import Weights
from edgectl.model.resource import AFFINITY, HOST_RESOURCES, NETWORK
from edgectl.scheduler.packing import Item, Packing, fits
from edgectl.scheduler.utility import EPSILON, compute_affinity, task_utilities

# Relocations and swaps that are tried: some 0.1 s.
MAX_TRIALS = 2_500


@dataclass(frozen=True, slots=True, kw_only=True)
class Objective:
    """Sum over all placed tasks of eq. (4) at the loads after the whole plan.

    ``links``: the columns of each task's links; ``needs`` and ``successors``: its predecessors, and the tasks
    that it is a predecessor of. ``elsewhere``: places of predecessors that the plan does not decide.
    """

    weights: Weights
    edges: int
    links: Mapping[str, Sequence[int]]
    needs: Mapping[str, Sequence[str]]
    successors: Mapping[str, Sequence[str]]
    elsewhere: Mapping[str, int]

    def rate(self, packing: Packing, names: Iterable[str]) -> float:
        """The sum over the tasks ``names``."""
        return sum(self._rate_task(packing, name) for name in names)

    def _rate_task(self, packing: Packing, name: str) -> float:
        place = packing.at[name]
        row = packing.free[place]
        total = 0.0
        for column, resource in enumerate(HOST_RESOURCES):
            total += self.weights[resource.name] * row[column]
        links = self.links[name] if place < self.edges else ()
        total += self.weights[NETWORK.name] * min([row[column] for column in links], default=1.0)
        return total + self.weights[AFFINITY] * self._rate_affinity(packing, name, place)

    def _rate_affinity(self, packing: Packing, name: str, place: int) -> float:
        known = (packing.at.get(need, self.elsewhere.get(need)) for need in self.needs[name])
        located = [there for there in known if there is not None]
        if not located:
            return 0.5
        rewards = {compute_affinity(located, each) for each in (*packing.items[name].places, place)}
        return task_utilities(rewards)[compute_affinity(located, place)]


def rebalance_packing(packing: Packing, objective: Objective, margin: float) -> None:
    """Relocate and swap items, the first gain at a time, until none is left or the trials are used up.

    Each running item that leaves its home must gain more than ``margin`` to the sum.
    """
    left = MAX_TRIALS
    names = [name for name in packing.at if packing.items[name].movable]
    improved = True
    while improved and left > 0:
        improved = False
        for index, name in enumerate(names):
            item = packing.items[name]
            for place in item.places:
                left -= 1
                if place != packing.at[name] and _try(packing, objective, margin, {name: place}):
                    improved = True
            for other in names[index + 1 :]:
                here, there = packing.at[name], packing.at[other]
                if here == there or left <= 0:
                    continue
                left -= 1
                if there in item.places and here in packing.items[other].places:
                    improved |= _try(packing, objective, margin, {name: there, other: here})


def _try(packing: Packing, objective: Objective, margin: float, goals: Mapping[str, int]) -> bool:
    """Put items to their ``goals`` if they fit there and the sum gains enough; else all is as it was."""
    items = [packing.items[name] for name in goals]
    if len(items) == 1 and not fits(packing, items[0], next(iter(goals.values()))):
        return False
    before = {name: packing.at[name] for name in goals}
    touched = {*before.values(), *goals.values()}
    names = {name for place in touched for name in packing.on[place]}
    names |= {each for name in goals for each in objective.successors[name] if each in packing.at}
    old = objective.rate(packing, sorted(names))
    needed = margin * sum(item.runs and before[item.name] == packing.home[item.name] for item in items)
    for item in items:
        packing.take(item)
    if _put_all(packing, items, goals):
        if objective.rate(packing, sorted(names)) > old + needed + EPSILON:
            return True
        for item in items:
            packing.take(item)
    for item in items:
        packing.put(item, before[item.name])
    return False


def _put_all(packing: Packing, items: Sequence[Item], goals: Mapping[str, int]) -> bool:
    """Put all ``items`` to their goals, or none."""
    done: list[Item] = []
    for item in items:
        if not fits(packing, item, goals[item.name]):
            for each in done:
                packing.take(each)
            return False
        packing.put(item, goals[item.name])
        done.append(item)
    return True
