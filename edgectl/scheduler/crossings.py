# SPDX-License-Identifier: Apache-2.0
"""Changes of an explanation, planned again: what the whole plan does when one number changes (ADR 65).

``explain`` finds the smallest change that reverses a decision while all other tasks stay. In the whole plan
another task may move before that and change what is left.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial

from edgectl.model.explanation import ChangeKind, FirstMove, Flip
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy, Weights
from edgectl.model.resource import RESOURCES_BY_NAME
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.assign import assign

# Beside a crossing, as a share of the capacity or of the whole weight: totals differ by more than EPSILON.
STEP = 1e-6
# Halvings that find where the plan changes, to some STEP.
MAX_HALVINGS = 24
# Parts of the way to a crossing after each of which the fleet is planned: up to the first move, and from
# there on, when tasks may move to and fro.
PARTS_BEFORE, PARTS_AFTER = 4, 16
# Where it is planned beyond a crossing at which the task stays: shares of the capacity, or of the weight.
FURTHER = (0.02, 0.05, 0.1, 0.25, 0.5, 1.0)
# Pairs of task and host that may be weighed for one explanation: some 2 s; at least so many plans. The
# last change is looked into whatever it takes.
MAX_PAIRS, MIN_PLANS = 400_000, 40

Places = Mapping[str, str | None]


def check_flips(
    inventory: Inventory, tasks: Tasks, snapshot: Snapshot, policy: Policy, task: str, flips: tuple[Flip, ...]
) -> tuple[Flip, ...]:
    """The changes as they are in the whole plan.

    A change before which another task moves names that move. A change after which ``task`` stays, because
    others make way for it, has its own host as the winner; one that changes nothing at all is left out, and
    so are those for which no plan is left within the bounds.
    """
    manager = snapshot.manager or ManagerState()
    left = max(MIN_PLANS, MAX_PAIRS // max(1, len(tasks.tasks) * len(inventory.hosts)))

    def plan_after(flip: Flip, size: float) -> Places:
        nonlocal left
        left -= 1
        changed, how = apply_change(snapshot, policy, flip, size)
        found = assign(inventory, tasks, changed, manager, how, snapshot.taken_at)
        return {decision.task: decision.host for decision in found.decisions}

    base = plan_after(flips[0], 0.0) if flips else {}
    checked: list[Flip] = []
    for flip in flips:
        if left <= 0:
            break
        checked += _check_flip(flip, task, base, partial(plan_after, flip))
    return tuple(sorted(checked, key=lambda flip: flip.size))


def _check_flip(flip: Flip, task: str, base: Places, plan_after: Callable[[float], Places]) -> Iterator[Flip]:
    def moves(size: float) -> bool:
        return plan_after(size).get(task) != base.get(task)

    here = (max(0.0, flip.size - STEP), flip.size + STEP)
    start = _find_change((*_divide(0.0, here[0], PARTS_BEFORE), *here), lambda size: plan_after(size) != base)
    if start is None:
        return
    moved = plan_after(start)
    if moved.get(task) != base.get(task):
        alone = start == here[1] and moved.get(task) == flip.winner
        yield flip if alone else resize_flip(flip, start, winner=moved.get(task))
        return
    name = next(name for name, place in moved.items() if place != base.get(name))
    first = FirstMove(task=name, host=moved[name], amount=resize_flip(flip, start).amount)
    further = (flip.size + more for more in FURTHER)
    own = _find_change((*_divide(start, here[1], PARTS_AFTER), here[1], *further), moves, start)
    if own is None:
        yield replace(flip, winner=base.get(task), first=first)
    else:
        yield replace(resize_flip(flip, own, winner=plan_after(own).get(task)), first=first)


def _divide(start: float, end: float, parts: int) -> list[float]:
    """The points between ``start`` and ``end`` that divide the way into equal parts."""
    return [start + (end - start) * number / parts for number in range(1, parts)]


def _find_change(
    points: Iterable[float], changed: Callable[[float], bool], start: float = 0.0
) -> float | None:
    """A size up to the first of ``points`` at which ``changed`` holds, and just below which it does not.

    None: it holds at none of them. It does not hold at ``start``.
    """
    low = start
    for point in points:
        if changed(point):
            return _halve(low, point, changed)
        low = point
    return None


def _halve(low: float, high: float, changed: Callable[[float], bool]) -> float:
    for _ in range(MAX_HALVINGS):
        if high - low <= 2.0 * STEP:
            break
        middle = (low + high) / 2
        low, high = (low, middle) if changed(middle) else (middle, high)
    return high


def resize_flip(flip: Flip, size: float, *, winner: str | None = None) -> Flip:
    """``flip`` with another size of the same change. Its capacity is amount / size."""
    if flip.host is None:
        sign = 1.0 if flip.change is ChangeKind.WEIGHT_RISES else -1.0
        amount = flip.amount + sign * (size - flip.size)
    else:
        amount = flip.unit * size
    return replace(flip, size=size, amount=max(0.0, amount), winner=winner)


def apply_change(snapshot: Snapshot, policy: Policy, flip: Flip, size: float) -> tuple[Snapshot, Policy]:
    """Snapshot and policy after a change of the kind of ``flip``, ``size`` large; a load is at least 0."""
    if flip.host is None:
        return snapshot, _change_weight(policy, flip, size)
    sample = snapshot.hosts[flip.host]
    sign = 1.0 if flip.change is ChangeKind.LOAD_RISES else -1.0
    changed = _change_load(sample, flip, sign * size * flip.unit)
    return replace(snapshot, hosts={**snapshot.hosts, flip.host: changed}), policy


def _change_load(sample: HostSample, flip: Flip, amount: float) -> HostSample:
    if RESOURCES_BY_NAME[flip.term].per_link:
        link = sample.links[flip.robot or ""]
        used = max(0.0, link.used_bytes_per_s + amount)
        links = {**sample.links, flip.robot or "": replace(link, used_bytes_per_s=used)}
        return replace(sample, links=links)
    usage = sample.usage[flip.term]
    changed = replace(usage, used=max(0.0, usage.used + amount))
    return replace(sample, usage={**sample.usage, flip.term: changed})


def _change_weight(policy: Policy, flip: Flip, size: float) -> Policy:
    """One weight changed, the others sharing the rest as they do now."""
    old = policy.weights.normalised()
    sign = 1.0 if flip.change is ChangeKind.WEIGHT_RISES else -1.0
    weight = min(1.0, max(0.0, old[flip.term] + sign * size))
    rest = (1.0 - weight) / (1.0 - old[flip.term])
    return replace(
        policy,
        weights=Weights({term: weight if term == flip.term else value * rest for term, value in old.items()}),
    )
