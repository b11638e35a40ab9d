"""Which action waits for which. Pure."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from edgectl.model.plan import Action, Step
from edgectl.model.task import Check, CheckLocation, Need, Task, Tasks

STARTING_ACTIONS = (Action.START, Action.MOVE, Action.RESTART)
STOPPING_ACTIONS = (Action.STOP, Action.COMPLETE)


@dataclass(frozen=True, slots=True, kw_only=True)
class StepDependencies:
    """What one starting action waits for.

    ``needs``: predecessors that this plan starts too; they must go well. ``others``: predecessors that this plan leaves alone.
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
    """Whether the step starts a task whose instance on a silent host was given up."""
    return step.action is Action.START and step.decision.previous_host is not None


def find_replacement_hold(task: Task) -> Check | None:
    """The hold of a replacement: one ``on: host`` would run on the silent host."""
    hold = task.handoff.hold
    return hold if hold is not None and hold.on is CheckLocation.ROBOT else None


def list_stop_hosts(step: Step) -> tuple[str, ...]:
    """Hosts on which the step stops something before anything starts: the task's own (stop, complete) and its duplicates'."""
    own = tuple(step.instances) if step.action in STOPPING_ACTIONS else ()
    return tuple(dict.fromkeys((*own, *step.stop)))


def build_step_dependencies(steps: tuple[Step, ...], tasks: Tasks) -> dict[str, StepDependencies]:
    """For each starting step, in the order of the plan, what it waits for.

    A start waits for moves that leave its host, as far as that closes no circle with ``needs``: room first, then the newcomer.
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
