# SPDX-License-Identifier: Apache-2.0
"""Order of the actions of a plan: needs first, then room. Pure."""

from collections.abc import Iterable, Mapping

from edgectl.dataclass import dataclass
from edgectl.model.check import Check, CheckLocation
from edgectl.model.plan import Action, Step
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.task import Need, NeedCondition, Task, Tasks

STARTING_ACTIONS = (Action.START, Action.MOVE, Action.RESTART)
STOPPING_ACTIONS = (Action.STOP, Action.COMPLETE)


@dataclass(frozen=True, slots=True, kw_only=True)
class StepDependencies:
    """Conditions of one starting action.

    ``needs``: predecessors that this plan starts too; they must go well.
    ``others``: predecessors that this plan leaves alone.
    ``leaving``: moves that make room on the host; they must only have ended.
    """

    needs: tuple[Need, ...] = ()
    others: tuple[Need, ...] = ()
    leaving: tuple[str, ...] = ()

    @property
    def tasks(self) -> frozenset[str]:
        """Every action that must have ended before."""
        return frozenset(need.task for need in self.needs) | frozenset(self.leaving)


def is_replacement(step: Step) -> bool:
    """Whether the step starts a task whose instance on an unreachable host was given up."""
    return step.action is Action.START and step.decision.previous_host is not None


def find_replacement_hold(task: Task) -> Check | None:
    """The hold of a replacement: one ``on: host`` would run on the unreachable host."""
    hold = task.handoff.hold
    return hold if hold is not None and hold.on is CheckLocation.ROBOT else None


def list_stop_hosts(step: Step) -> tuple[str, ...]:
    """Hosts on which the step stops something before anything starts.

    The host of the task itself (stop, complete), and those of its duplicates.
    """
    own = tuple(step.instances) if step.action in STOPPING_ACTIONS else ()
    return tuple(dict.fromkeys((*own, *step.stop)))


def build_step_dependencies(steps: tuple[Step, ...], tasks: Tasks) -> dict[str, StepDependencies]:
    """The conditions of each starting step, in the order of the plan.

    A start waits for moves that leave its host, as far as that closes no circle with ``needs``.
    """
    starting = {step.task: step for step in steps if step.action in STARTING_ACTIONS}
    edges = {
        name: {need.task for need in _get_needs(name, tasks) if need.task in starting} for name in starting
    }
    leaving: dict[str, list[str]] = {name: [] for name in starting}
    movers = _group_movers_by_host(starting.values())
    for name, step in starting.items():
        for mover in movers.get(step.decision.host, ()):
            if mover != name and not _has_path(edges, mover, name):
                edges[name].add(mover)
                leaving[name].append(mover)
    return {
        name: _classify_needs(_get_needs(name, tasks), starting, tuple(leaving[name])) for name in starting
    }


def add_dependent_starts(steps: Iterable[Step], tasks: Tasks, names: Iterable[str]) -> set[str]:
    """``names``, and the tasks whose start in ``steps`` (in the order of ``needs``) waits for one of them."""
    found, starting = set(names), {step.task: step for step in steps if step.action is Action.START}
    for name in starting:
        if any(need.task in found and need.task in starting for need in _get_needs(name, tasks)):
            found.add(name)
    return found


def order_by_dependencies(after: Mapping[str, frozenset[str]]) -> list[str]:
    """The names so that each comes after those in ``after[name]``; otherwise in their own order."""
    waiting, ordered = dict(after), list[str]()
    while waiting:
        name = next((name for name, others in waiting.items() if not others & waiting.keys()), None)
        if name is None:
            raise ValueError(f"circular dependencies: {', '.join(waiting)}")
        del waiting[name]
        ordered.append(name)
    return ordered


def is_need_satisfied(need: Need, result: ActionResult | None) -> bool:
    """Whether a predecessor that this plan started (or moved) went well enough for its successor to start."""
    if result is None:
        return False
    if result.outcome is Outcome.DONE:
        return True
    still_there = result.outcome is Outcome.DEFERRED and result.located is not None
    return still_there or (need.until is NeedCondition.RUNNING and result.located is not None)


def _get_needs(name: str, tasks: Tasks) -> tuple[Need, ...]:
    task = tasks.tasks.get(name)
    return task.needs if task else ()


def _classify_needs(
    needs: tuple[Need, ...], starting: Mapping[str, Step], leaving: tuple[str, ...]
) -> StepDependencies:
    return StepDependencies(
        needs=tuple(need for need in needs if need.task in starting),
        others=tuple(need for need in needs if need.task not in starting),
        leaving=leaving,
    )


def _group_movers_by_host(steps: Iterable[Step]) -> dict[str | None, list[str]]:
    """The tasks that move, by the host that they leave."""
    movers: dict[str | None, list[str]] = {}
    for step in steps:
        if step.action is Action.MOVE:
            movers.setdefault(step.decision.previous_host, []).append(step.task)
    return movers


def _has_path(edges: Mapping[str, set[str]], start: str, goal: str) -> bool:
    """Whether ``start`` waits, through others, for ``goal``."""
    seen, waiting = set[str](), [start]
    while waiting:
        name = waiting.pop()
        if name == goal:
            return True
        if name not in seen:
            seen.add(name)
            waiting += edges[name]
    return False
