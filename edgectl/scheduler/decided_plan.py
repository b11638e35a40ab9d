# SPDX-License-Identifier: Apache-2.0
"""A plan as its passes have decided it: its repair, its rebalancing and its optimum start from here."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Reason, Verdict
from edgectl.model.task import Task
from edgectl.scheduler.candidates import AssignmentContext
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.initial_state import InitialState
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.sequence import is_need_met
from edgectl.scheduler.task_usage import TaskUsage

if TYPE_CHECKING:  # of a search, which most plans do without
    from edgectl.scheduler.packing import Packing


@dataclass(frozen=True, slots=True, kw_only=True)
class DecidedPlan:
    """What the passes of a plan have decided, as far as a change of it needs that.

    ``placed``: place and demand of each task that has one. ``ledger``: gamma afterwards. ``moves_left``:
    moves of running tasks that are still allowed; None: any number.
    """

    context: AssignmentContext
    order: Sequence[Task]
    initial: InitialState
    choices: Mapping[str, Choice]
    placed: Mapping[str, tuple[int, TaskUsage]]
    ledger: Ledger
    moves_left: int | None = None


def list_wanted(plan: DecidedPlan) -> list[Task]:
    """Tasks without room, and those that only wait for them, in sequence order."""
    reach = find_located(plan)
    wanted = []
    for task in plan.order:
        choice = plan.choices.get(task.name)
        if choice is None or choice.verdict is not Verdict.UNPLACED:
            continue
        if choice.reason is Reason.NO_FEASIBLE_HOST or (
            choice.reason is Reason.PREDECESSOR_MISSING
            and all(is_need_met(need, reach, plan.initial.completed) for need in task.needs)
        ):
            reach.add(task.name)
            wanted.append(task)
    return wanted


def find_located(plan: DecidedPlan) -> set[str]:
    """Tasks that count as predecessors; one that ran and lost its place does not."""
    homeless = {name for name, choice in plan.choices.items() if choice.place is None}
    return (set(plan.initial.located) - homeless) | plan.placed.keys()


def choose_places(plan: DecidedPlan, places: Mapping[str, int]) -> dict[str, Choice]:
    """The choices that give each task its place of ``places``, or none, where they differ from ``plan``."""
    changed = {
        name: Choice(
            verdict=Verdict.PLACED, reason=Reason.OPTIMAL, place=place, voluntary=name in plan.initial.running
        )
        for name, place in places.items()
        if name not in plan.placed or plan.placed[name][0] != place
    }
    gone = plan.placed.keys() - places.keys()
    return changed | {
        name: Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_FEASIBLE_HOST) for name in sorted(gone)
    }


def build_choices(plan: DecidedPlan, packing: "Packing", causes: Mapping[str, str]) -> dict[str, Choice]:
    """The choices of ``packing`` where they differ from those of ``plan``. ``causes``: by item, the task that
    it was moved for.
    """
    items = {task: item.name for item in packing.items.values() for task in item.tasks}
    changed = {
        name: Choice(verdict=Verdict.UNPLACED, reason=Reason.PREEMPTED, subject=causes.get(items[name]))
        for name in plan.placed
        if items[name] not in packing.at
    }
    for item, place in packing.at.items():
        for name in packing.items[item].tasks:
            choice = _build_choice(plan, name, place, causes.get(item))
            if choice is not None:
                changed[name] = choice
    return changed


def build_place_choices(
    plan: DecidedPlan, places: Mapping[str, int], causes: Mapping[str, str]
) -> dict[str, Choice]:
    """The choices that give tasks their ``places``, where they differ from ``plan``. ``causes``: by task, the
    one that it was moved for.
    """
    found = {name: _build_choice(plan, name, place, causes.get(name)) for name, place in places.items()}
    return {name: choice for name, choice in found.items() if choice is not None}


def _build_choice(plan: DecidedPlan, name: str, place: int, cause: str | None) -> Choice | None:
    """The choice of ``place`` for task ``name``; None where it has it already."""
    if name not in plan.placed:
        return Choice(verdict=Verdict.PLACED, reason=Reason.ROOM_MADE, place=place)
    if plan.placed[name][0] == place:
        return None
    return Choice(
        verdict=Verdict.PLACED,
        reason=Reason.MADE_ROOM,
        place=place,
        subject=cause,
        voluntary=name in plan.initial.running,
    )
