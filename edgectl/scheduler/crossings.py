"""Changes of an explanation, planned again: what the whole plan does when one number changes (ADR 65).

``explain`` finds the smallest change that reverses a decision while all other tasks stay. In the whole plan
another task may move before that and change what is left.
"""

from collections.abc import Callable, Iterator, Mapping
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
# Halvings that find where the plan changes first, to less than STEP.
MAX_HALVINGS = 24
# Pairs of task and host that may be weighed for one explanation: some 2 s; at least so many plans.
MAX_PAIRS, MIN_PLANS = 400_000, 60

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
        if left < 2 * MAX_HALVINGS:
            break
        checked += _check_flip(flip, task, base, partial(plan_after, flip))
    return tuple(sorted(checked, key=lambda flip: flip.size))


def _check_flip(flip: Flip, task: str, base: Places, plan_after: Callable[[float], Places]) -> Iterator[Flip]:
    before, after = plan_after(max(0.0, flip.size - STEP)), plan_after(flip.size + STEP)
    if before == base and after.get(task) == flip.winner != base.get(task):
        yield flip
        return
    if before == base == after:
        return
    end = flip.size + STEP if after != base else max(0.0, flip.size - STEP)
    start = _find_change(end, lambda size: plan_after(size) != base)
    moved = plan_after(start)
    if moved.get(task) != base.get(task):
        yield resize_flip(flip, start, winner=moved.get(task))
        return
    name = next(name for name, place in moved.items() if place != base.get(name))
    first = FirstMove(task=name, host=moved[name], amount=resize_flip(flip, start).amount)
    if after.get(task) == base.get(task):
        yield replace(flip, winner=base.get(task), first=first)
        return
    own = _find_change(flip.size + STEP, lambda size: plan_after(size).get(task) != base.get(task), start)
    yield replace(resize_flip(flip, own, winner=plan_after(own).get(task)), first=first)


def _find_change(end: float, changed: Callable[[float], bool], start: float = 0.0) -> float:
    """A size up to ``end`` at which ``changed`` holds, and just below which it does not; it holds at
    ``end``.
    """
    low, high = start, end
    for _ in range(MAX_HALVINGS):
        middle = (low + high) / 2
        if high - low <= STEP / 2:
            break
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
