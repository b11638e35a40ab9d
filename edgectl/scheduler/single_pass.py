# SPDX-License-Identifier: Apache-2.0
"""One pass over the sequence: each task is weighed on all places and put on the best one."""

from collections.abc import Mapping
from functools import lru_cache, partial
from types import MappingProxyType

from edgectl.model.assignment import Reason, Rejection, Verdict
from edgectl.model.task import Task
from edgectl.scheduler.activation import prefer_standby
from edgectl.scheduler.candidates import (
    CandidateSet,
    gather_candidates,
    usage_at,
    weigh_candidates,
)
from edgectl.scheduler.choice import Choice, MoveConstraints, choose_by_utility
from edgectl.scheduler.company import Company, follows_unit, list_reservations, weigh_in_company
from edgectl.scheduler.decisions import (
    build_decision,
    build_plain_decision,
    explain_replacement,
    rebase_on_initial,
    unplaced_decision,
)
from edgectl.scheduler.initial_state import InitialState, RunningTask
from edgectl.scheduler.lazy_ranking import LoadChange, LoadHistory, RankingRequest
from edgectl.scheduler.pass_state import (
    PassResult,
    PassState,
    PlacementPass,
    change_reservation,
    charge_demand,
    count_moves_left,
    find_predecessors,
    find_running_place,
)
from edgectl.scheduler.peaks import stays_by_room, stays_in_place
from edgectl.scheduler.placement_rules import NO_RULES
from edgectl.scheduler.sequence import is_need_met

# Of a task that starts, and that no rule joins with others.
_NO_CONSTRAINTS, _NONE_BARRED = MoveConstraints(), MappingProxyType[int, Rejection]({})


def run_pass(how: PlacementPass, state: InitialState, prior_moves: Mapping[str, Choice]) -> PassResult:
    """Place every task of the sequence once.

    ``prior_moves``: moves that earlier passes of this plan have made.
    """
    progress = PassState(
        ledger=state.ledger.copy(),
        history=LoadHistory(start=state.ledger) if how.record and how.explain else None,
        located=dict(state.located),
        open={task.name: task for task in how.order if task.name not in state.fixed}
        if how.context.placement_rules is not NO_RULES
        else {},
        moves_left=count_moves_left(how, prior_moves),
    )
    if how.context.arrays is not None:
        how.context.arrays.mirror(progress.ledger)
        if how.rules.settles and how.rules.choose is choose_by_utility:
            from edgectl.scheduler.array_start import build_starter

            progress.start = build_starter(how.context, progress.ledger, progress.history, progress.placed)
    for task in how.order:
        fixed = state.fixed.get(task.name)
        if fixed is None:
            _decide_task(how, state, prior_moves, progress, task)
        else:
            progress.decisions.append(fixed)
    return PassResult(
        choices=progress.choices,
        placed=progress.uses,
        ledger=progress.ledger,
        decisions=tuple(progress.decisions),
    )


def repeats_at_a_glance(how: PlacementPass, state: InitialState, outcome: PassResult) -> bool:
    """Whether bounds alone show that a repetition leaves every task where ``outcome`` has it (ADR 147): then
    none is made. False says nothing.
    """
    places = {name: choice.place for name, choice in outcome.choices.items() if choice.place is not None}
    if len(places) < len(outcome.choices):
        return False
    progress = PassState(ledger=outcome.ledger, history=None, located={**state.located, **places}, open={})
    return all(
        _stays_at_a_glance(how, state, progress, task, places[task.name])
        for task in how.order
        if task.name in places
    )


def _decide_task(
    how: PlacementPass,
    state: InitialState,
    prior_moves: Mapping[str, Choice],
    progress: PassState,
    task: Task,
) -> None:
    """One task: its reservation leaves gamma, every place is weighed, and d is charged where it is put."""
    running = state.running.get(task.name)
    if running is not None and _stays_at_a_glance(how, state, progress, task, running.place):
        choice = _keep_at(running.place)
        progress.choices[task.name] = choice
        progress.uses[task.name] = running.place, running.use
        progress.placed[running.place] = progress.placed.get(running.place, 0) + 1
        _record_plainly(how, prior_moves, progress, task, choice)
        return
    if task.name in progress.reserved:
        change_reservation(progress, *progress.reserved.pop(task.name), is_charge=False)
    if running is not None and not how.rules.strict_paper:
        progress.ledger.release(running.place, running.use)
        if progress.history is not None:
            progress.history.changes.append(LoadChange(running.place, running.use, is_charge=False))
    missing = _find_missing_predecessor(task, progress.located, state.completed) if running is None else None
    candidates = None
    if missing is not None:
        reason = Reason.PREDECESSOR_INCOMPLETE if missing in progress.located else Reason.PREDECESSOR_MISSING
        choice = Choice(verdict=Verdict.UNPLACED, reason=reason, subject=missing)
        told = rebase_on_initial(
            choice, find_running_place(how.initial, task.name), prior_moves.get(task.name)
        )
        progress.decisions.append(
            explain_replacement(unplaced_decision(task, told), how.initial.replaced.get(task.name))
        )
    elif running is None and _start_plainly(how, state, prior_moves, progress, task):
        return
    else:
        choice, candidates = _choose_place(how, state, prior_moves, progress, task)
        _record_plainly(how, prior_moves, progress, task, choice)
    progress.choices[task.name] = choice
    if candidates is not None and choice.place is not None:
        charge_demand(progress, task.name, choice.place, usage_at(candidates, choice.place))
        _reserve_for_unit(how, state, progress, task, choice.place)
    else:
        progress.located.pop(task.name, None)  # it ran on a host that counts as gone
    if progress.moves_left is not None and choice.counted and task.name not in prior_moves:
        progress.moves_left -= 1


@lru_cache(maxsize=10_000)  # of few places, for very many tasks
def _keep_at(place: int) -> Choice:
    return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_BEST, place=place)


@lru_cache(maxsize=10_000)
def _start_at(place: int) -> Choice:
    return Choice(verdict=Verdict.PLACED, reason=Reason.BEST, place=place)


def _start_plainly(
    how: PlacementPass,
    state: InitialState,
    prior_moves: Mapping[str, Choice],
    progress: PassState,
    task: Task,
) -> bool:
    """Start ``task`` where the arrays alone decide; False, with nothing done, where they may not."""
    name = task.name
    if progress.start is None or name in how.initial.running or name in how.initial.replaced:
        return False
    if name in prior_moves or how.context.placement_rules.concern(name):
        return False
    start = progress.start(task, find_predecessors(how, state, progress, task))
    if start is None:
        return False
    choice = progress.choices[name] = _start_at(start.place)
    if start.decision is not None:
        progress.decisions.append(start.decision)
    _record_plainly(how, prior_moves, progress, task, choice)
    charge_demand(progress, name, start.place, start.use)
    return True


def _record_plainly(
    how: PlacementPass,
    prior_moves: Mapping[str, Choice],
    progress: PassState,
    task: Task,
    choice: Choice,
) -> None:
    """Keep the decision without its numbers, if only the decision is asked for."""
    if how.record and not how.explain:
        initial_place = find_running_place(how.initial, task.name)
        told = rebase_on_initial(choice, initial_place, prior_moves.get(task.name))
        decision = build_plain_decision(how.context.fleet, task, told, initial_place)
        progress.decisions.append(explain_replacement(decision, how.initial.replaced.get(task.name)))


def _stays_at_a_glance(
    how: PlacementPass, state: InitialState, progress: PassState, task: Task, here: int
) -> bool:
    """Whether a pass that explains nothing may leave ``task`` where it is, without a look at every host."""
    if (how.record and how.explain) or not how.rules.settles or not progress.peaks.valid:
        return False
    if how.context.placement_rules.concern(task.name):
        return False
    predecessors = find_predecessors(how, state, progress, task)
    located = tuple(predecessors.values())
    if stays_by_room(how.context, progress.ledger, task, here, located, progress.peaks):
        return True
    candidates = gather_candidates(
        how.context,
        progress.ledger,
        task,
        incumbent=here,
        predecessors=predecessors,
        placed=progress.placed,
    )
    return stays_in_place(candidates, progress.peaks)


def _choose_place(
    how: PlacementPass,
    state: InitialState,
    prior_moves: Mapping[str, Choice],
    progress: PassState,
    task: Task,
) -> tuple[Choice, CandidateSet]:
    running = state.running.get(task.name)
    incumbent = running.place if running is not None else None
    predecessors = find_predecessors(how, state, progress, task)
    gather = partial(
        gather_candidates,
        how.context,
        progress.ledger,
        task,
        incumbent=incumbent,
        predecessors=predecessors,
        placed=progress.placed,
    )
    company = _build_company(how, state, progress, task)
    barred: Mapping[int, Rejection] = _NONE_BARRED
    if company is not None:
        candidates, barred = weigh_in_company(
            company, task, incumbent, lambda barred=None: weigh_candidates(gather(barred=barred))
        )
    else:
        candidates = weigh_candidates(gather())
    choice = how.rules.choose(candidates, _build_move_constraints(how, progress, task, running, company))
    initial_place = find_running_place(how.initial, task.name)
    if initial_place is None and incumbent is not None and choice.verdict is Verdict.PLACED:
        # Another place than that of an earlier pass: the task runs nowhere yet, so nothing moves.
        choice = Choice(verdict=Verdict.PLACED, reason=Reason.BEST, place=choice.place)
    if how.rules.settles:
        choice = prefer_standby(choice, candidates, how.initial)
    progress.peaks.valid = progress.peaks.valid and incumbent in (None, choice.place)
    if progress.history is not None:
        waived = choice.place in candidates.denied and choice.place == incumbent
        if waived:
            candidates = weigh_candidates(gather(stays=True, barred=barred))
        told = rebase_on_initial(choice, initial_place, prior_moves.get(task.name))
        ranking = RankingRequest(
            context=how.context,
            history=progress.history,
            step=len(progress.history.changes),
            task=task,
            incumbent=incumbent,
            predecessors=predecessors,
            stays=waived,
            chosen=told.place,
            barred=barred,
        )
        decision = build_decision(candidates, told, initial_place, ranking)
        progress.decisions.append(explain_replacement(decision, how.initial.replaced.get(task.name)))
    return choice, candidates


def _build_move_constraints(
    how: PlacementPass,
    progress: PassState,
    task: Task,
    running: RunningTask | None,
    company: Company | None,
) -> MoveConstraints:
    """The constraints of this pass. ``max_moves`` is about tasks that run before the plan.

    Tasks that share a host have been there as long as the last of them.
    """
    if running is None and company is None:
        return _NO_CONSTRAINTS
    since = running.since if running is not None else None
    if company is not None:
        runs = [company.running[mate] for mate in company.list_mates(task.name) if mate in company.running]
        since = max([since, *(run.since for run in runs if run.since is not None)]) if since else since
    return MoveConstraints(
        frozen=how.initial.frozen,
        voluntary=how.voluntary,
        dwell_s=how.context.now - since if since is not None else None,
        moves_left=progress.moves_left if task.name in how.initial.running else None,
        follows=company is not None and follows_unit(company, task.name),
        in_unit=company is not None and bool(company.list_mates(task.name)),
    )


def _build_company(
    how: PlacementPass, state: InitialState, progress: PassState, task: Task
) -> Company | None:
    """The tasks that rules between tasks join ``task`` with; None: no rule concerns it."""
    if not how.context.placement_rules.concern(task.name):
        return None
    return Company(
        context=how.context,
        ledger=progress.ledger,
        open=progress.open,
        running=state.running,
        decided=progress.choices,
        located=progress.located,
    )


def _reserve_for_unit(
    how: PlacementPass, state: InitialState, progress: PassState, task: Task, place: int
) -> None:
    """Keep the room that the tasks need which share this host and come later."""
    company = _build_company(how, state, progress, task)
    for mate, use in list_reservations(company, task.name, place) if company is not None else ():
        if mate not in progress.reserved:
            change_reservation(progress, place, use, is_charge=True)
            progress.reserved[mate] = place, use


def _find_missing_predecessor(
    task: Task, located: Mapping[str, int], completed: frozenset[str]
) -> str | None:
    """The first predecessor that is not as far as ``task`` needs it."""
    for need in task.needs:
        if not is_need_met(need, located, completed):
            return need.task
    return None
