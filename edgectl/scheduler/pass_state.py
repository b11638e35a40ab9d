# SPDX-License-Identifier: Apache-2.0
"""State of a pass over the sequence, its result, and the state that it leads to."""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import TYPE_CHECKING

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.task import Task
from edgectl.scheduler.candidates import AssignmentContext
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.initial_state import InitialState, RunningTask
from edgectl.scheduler.lazy_ranking import LoadChange, LoadHistory
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.peaks import LoadPeaks
from edgectl.scheduler.policies import SchedulingPolicy
from edgectl.scheduler.task_usage import TaskUsage

if TYPE_CHECKING:  # imported only for very large fleets
    from edgectl.scheduler.array_start import Starter


@dataclass(frozen=True, slots=True, kw_only=True)
class PassResult:
    """Result of one pass: the choice and place of each task that it decides, with its load (d), and gamma
    afterwards.
    """

    choices: Mapping[str, Choice]
    placed: Mapping[str, tuple[int, TaskUsage]]
    ledger: Ledger
    decisions: tuple[Decision, ...] = ()

    @property
    def places(self) -> dict[str, int | None]:
        """The place of each task, None where unplaced: what a repetition must not change."""
        return {name: choice.place for name, choice in self.choices.items()}


@dataclass(slots=True, kw_only=True)
class PassState:
    """State of a pass under way. ``history``: its changes of gamma, where rankings are asked for.

    ``open``: the tasks that it decides, where rules between tasks need them. ``reserved``: room kept for
    tasks that will share the host of another. ``start``: of tasks that arrays decide (ADR 147).
    """

    ledger: Ledger
    history: LoadHistory | None
    peaks: LoadPeaks = field(default_factory=LoadPeaks)
    located: dict[str, int]
    open: Mapping[str, Task]
    placed: dict[int, int] = field(default_factory=dict)
    uses: dict[str, tuple[int, TaskUsage]] = field(default_factory=dict)
    reserved: dict[str, tuple[int, TaskUsage]] = field(default_factory=dict)
    choices: dict[str, Choice] = field(default_factory=dict)
    decisions: list[Decision] = field(default_factory=list)
    moves_left: int | None = None
    start: "Starter | None" = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementPass:
    """One way over the sequence.

    ``initial``: the state before the plan, by which moves are counted and recorded. ``record``: keep the
    decisions; ``explain``: with their numbers and rankings.
    """

    context: AssignmentContext
    order: Sequence[Task]
    rules: SchedulingPolicy
    initial: InitialState
    voluntary: bool = True
    record: bool = False
    explain: bool = True


def state_from_pass(state: InitialState, outcome: PassResult, initial: InitialState) -> InitialState:
    """The expected outcome as a state: each placed task runs where it was put and uses its d."""
    running = {
        name: _build_running_task(name, outcome, initial)
        for name, choice in outcome.choices.items()
        if choice.place is not None
    }
    unplaced = {name for name, choice in outcome.choices.items() if choice.place is None}
    located = {name: place for name, place in state.located.items() if name not in unplaced}
    located |= {name: there.place for name, there in running.items()}
    return replace(state, ledger=outcome.ledger, running=running, located=located)


def _build_running_task(name: str, outcome: PassResult, initial: InitialState) -> RunningTask:
    place, use = outcome.placed[name]
    before = initial.running.get(name)
    return RunningTask(
        place=place, use=use, since=before.since if before is not None and before.place == place else None
    )


def collect_prior_moves(
    outcome: PassResult, prior_moves: Mapping[str, Choice], initial: InitialState
) -> dict[str, Choice]:
    """The choices that moved tasks away from their initial places, by task."""
    moves = {
        **prior_moves,
        **{
            name: choice
            for name, choice in outcome.choices.items()
            if choice.verdict is Verdict.PLACED or choice.reason is Reason.PREEMPTED
        },
    }
    return {
        name: choice for name, choice in moves.items() if choice.place != find_running_place(initial, name)
    }


def find_running_place(state: InitialState, name: str) -> int | None:
    """The place where task ``name`` runs in ``state``; None: it does not."""
    running = state.running.get(name)
    return running.place if running is not None else None


def count_moves_left(how: PlacementPass, prior_moves: Mapping[str, Choice]) -> int | None:
    """How many more voluntary moves the policy allows after ``prior_moves``; None for any number."""
    policy = how.context.policy
    if policy.attended or policy.max_moves is None:
        return None
    return policy.max_moves - sum(choice.counted for choice in prior_moves.values())


def find_predecessors(
    how: PlacementPass, state: InitialState, progress: PassState, task: Task
) -> dict[str, int]:
    """The places of those that ``task`` needs."""
    known = state.located if how.rules.strict_paper else progress.located
    return {need.task: known[need.task] for need in task.needs if need.task in known}


def change_reservation(progress: PassState, place: int, use: TaskUsage, *, is_charge: bool) -> None:
    """Keep room for a task that comes later, or give it back."""
    (progress.ledger.charge if is_charge else progress.ledger.release)(place, use)
    progress.peaks.valid = False
    if progress.history is not None:
        progress.history.changes.append(LoadChange(place, use, is_charge=is_charge, counts=False))


def charge_demand(progress: PassState, name: str, place: int, use: TaskUsage) -> None:
    """Put task ``name`` on ``place``, where it counts for ``use``."""
    progress.ledger.charge(place, use)
    if progress.history is not None:
        progress.history.changes.append(LoadChange(place, use, is_charge=True))
    progress.uses[name] = (place, use)
    progress.located[name] = place
    progress.placed[place] = progress.placed.get(place, 0) + 1
