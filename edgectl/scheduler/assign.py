"""The scheduler: (Inventory, Tasks, Snapshot, ManagerState, Policy, now) -> Assignment.

Pure; the same inputs give the same bytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from edgectl.model.assignment import Assignment, Certificate, Decision, Reason, Rejection, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.candidates import (
    AssignmentContext,
    gather_candidates,
    weigh_candidates,
)
from edgectl.scheduler.capacities import Capacities, build_capacities
from edgectl.scheduler.choice import Choice, MoveConstraints
from edgectl.scheduler.company import Company, follows_unit, list_reservations, weigh_in_company
from edgectl.scheduler.decisions import (
    build_decision,
    explain_replacement,
    rebase_on_initial,
    unplaced_decision,
)
from edgectl.scheduler.demand import add_measured_demands
from edgectl.scheduler.demand_spread import find_demand_spreads
from edgectl.scheduler.groups import MAX_ROUNDS, withhold_incomplete_groups
from edgectl.scheduler.initial_state import InitialState, RunningTask, build_initial_state
from edgectl.scheduler.integer_program import Solver, keep_bounds
from edgectl.scheduler.lazy_ranking import LoadChange, LoadHistory, RankingRequest
from edgectl.scheduler.ledger import Ledger, compute_demand_usage
from edgectl.scheduler.move_cost import collect_handoff_history
from edgectl.scheduler.optimum import certify, find_optimum, is_overload_kept, value_plan
from edgectl.scheduler.peaks import LoadPeaks, stays_in_place
from edgectl.scheduler.placement_rules import NO_RULES, build_placement_rules
from edgectl.scheduler.policies import POLICIES, SchedulingPolicy
from edgectl.scheduler.preference import sign_weights
from edgectl.scheduler.repair import (
    UnrepairedPlan,
    choose_places,
    list_wanted,
    rate_plan,
    rebalance_plan,
    repair_plan,
)
from edgectl.scheduler.reservation import reserve_running_tasks
from edgectl.scheduler.scan import build_demand_shares
from edgectl.scheduler.sequence import is_need_met, order_tasks
from edgectl.scheduler.shortage import compute_shortages
from edgectl.scheduler.task_usage import TaskUsage

if TYPE_CHECKING:
    from edgectl.scheduler.array_scan import ArrayScan


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
class _PassState:
    """State of a pass under way. ``history``: its changes of gamma, where rankings are asked for.

    ``open``: the tasks that it decides, where rules between tasks need them. ``reserved``: room kept for
    tasks that will share the host of another.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementPass:
    """One way over the sequence.

    ``initial``: the state before the plan, by which moves are counted and recorded. ``record``: keep the
    rankings.
    """

    context: AssignmentContext
    order: Sequence[Task]
    rules: SchedulingPolicy
    initial: InitialState
    voluntary: bool = True
    record: bool = False


def run_pass(how: PlacementPass, state: InitialState, prior_moves: Mapping[str, Choice]) -> PassResult:
    """Place every task of the sequence once.

    ``prior_moves``: moves that earlier passes of this plan have made.
    """
    progress = _PassState(
        ledger=state.ledger.copy(),
        history=LoadHistory(start=state.ledger) if how.record else None,
        located=dict(state.located),
        open={task.name: task for task in how.order if task.name not in state.fixed}
        if how.context.placement_rules is not NO_RULES
        else {},
        moves_left=_count_moves_left(how, prior_moves),
    )
    if how.context.arrays is not None:
        how.context.arrays.mirror(progress.ledger)
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
    return {name: choice for name, choice in moves.items() if choice.place != _find_place(initial, name)}


def _find_place(state: InitialState, name: str) -> int | None:
    running = state.running.get(name)
    return running.place if running is not None else None


def _count_moves_left(how: PlacementPass, prior_moves: Mapping[str, Choice]) -> int | None:
    policy = how.context.policy
    if policy.attended or policy.max_moves is None:
        return None
    return policy.max_moves - sum(choice.counted for choice in prior_moves.values())


def _decide_task(
    how: PlacementPass,
    state: InitialState,
    prior_moves: Mapping[str, Choice],
    progress: _PassState,
    task: Task,
) -> None:
    """One task: its reservation leaves gamma, every place is weighed, and d is charged where it is put."""
    running = state.running.get(task.name)
    if task.name in progress.reserved:
        _change_reservation(progress, *progress.reserved.pop(task.name), is_charge=False)
    if running is not None and not how.rules.strict_paper:
        progress.ledger.release(running.place, running.use)
        if progress.history is not None:
            progress.history.changes.append(LoadChange(running.place, running.use, is_charge=False))
    missing = _find_missing_predecessor(task, progress.located, state.completed) if running is None else None
    if missing is not None:
        reason = Reason.PREDECESSOR_INCOMPLETE if missing in progress.located else Reason.PREDECESSOR_MISSING
        choice = Choice(verdict=Verdict.UNPLACED, reason=reason, subject=missing)
        told = rebase_on_initial(choice, _find_place(how.initial, task.name), prior_moves.get(task.name))
        progress.decisions.append(
            explain_replacement(unplaced_decision(task, told), how.initial.replaced.get(task.name))
        )
    else:
        choice = _choose_place(how, state, prior_moves, progress, task)
    progress.choices[task.name] = choice
    if choice.place is not None:
        _charge_demand(progress, task, choice.place)
        _reserve_for_unit(how, state, progress, task, choice.place)
    else:
        progress.located.pop(task.name, None)  # it ran on a host that counts as gone
    if progress.moves_left is not None and choice.counted and task.name not in prior_moves:
        progress.moves_left -= 1


def _choose_place(
    how: PlacementPass,
    state: InitialState,
    prior_moves: Mapping[str, Choice],
    progress: _PassState,
    task: Task,
) -> Choice:
    running = state.running.get(task.name)
    incumbent = running.place if running is not None else None
    known = state.located if how.rules.strict_paper else progress.located
    predecessors = {need.task: known[need.task] for need in task.needs if need.task in known}
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
    barred: Mapping[int, Rejection] = {}
    if company is not None:
        candidates, barred = weigh_in_company(
            company, task, incumbent, lambda barred=None: weigh_candidates(gather(barred=barred))
        )
    else:
        candidates = gather()
        if how.rules.settles and not how.record and stays_in_place(candidates, progress.peaks):
            return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_BEST, place=incumbent)
        candidates = weigh_candidates(candidates)
    choice = how.rules.choose(candidates, _build_move_constraints(how, progress, task, running, company))
    initial_place = _find_place(how.initial, task.name)
    if initial_place is None and incumbent is not None and choice.verdict is Verdict.PLACED:
        # Another place than that of an earlier pass: the task runs nowhere yet, so nothing moves.
        choice = Choice(verdict=Verdict.PLACED, reason=Reason.BEST, place=choice.place)
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
    return choice


def _build_move_constraints(
    how: PlacementPass,
    progress: _PassState,
    task: Task,
    running: RunningTask | None,
    company: Company | None,
) -> MoveConstraints:
    """The constraints of this pass. ``max_moves`` is about tasks that run before the plan.

    Tasks that share a host have been there as long as the last of them.
    """
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
    how: PlacementPass, state: InitialState, progress: _PassState, task: Task
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
    how: PlacementPass, state: InitialState, progress: _PassState, task: Task, place: int
) -> None:
    """Keep the room that the tasks need which share this host and come later."""
    company = _build_company(how, state, progress, task)
    for mate, use in list_reservations(company, task.name, place) if company is not None else ():
        if mate not in progress.reserved:
            _change_reservation(progress, place, use, is_charge=True)
            progress.reserved[mate] = place, use


def _change_reservation(progress: _PassState, place: int, use: TaskUsage, *, is_charge: bool) -> None:
    (progress.ledger.charge if is_charge else progress.ledger.release)(place, use)
    progress.peaks.valid = False
    if progress.history is not None:
        progress.history.changes.append(LoadChange(place, use, is_charge=is_charge, counts=False))


def _charge_demand(progress: _PassState, task: Task, place: int) -> None:
    use = compute_demand_usage(progress.ledger.fleet, task, place)
    progress.ledger.charge(place, use)
    if progress.history is not None:
        progress.history.changes.append(LoadChange(place, use, is_charge=True))
    progress.uses[task.name] = (place, use)
    progress.located[task.name] = place
    progress.placed[place] = progress.placed.get(place, 0) + 1


def _find_missing_predecessor(
    task: Task, located: Mapping[str, int], completed: frozenset[str]
) -> str | None:
    """The first predecessor that is not as far as ``task`` needs it."""
    return next((need.task for need in task.needs if not is_need_met(need, located, completed)), None)


# From so many pairs of an edge and a task on NumPy pays for its import.
MIN_ARRAY_PAIRS = 300_000
# Passes that are tried before a plan counts as one that does not settle (ADR 0010).
MAX_PASSES = 5


def assign(
    inventory: Inventory,
    tasks: Tasks,
    snapshot: Snapshot,
    manager: ManagerState,
    policy: Policy,
    now: float,
    solve: Solver | None = None,
) -> Assignment:
    """A host, numbers and a reason for each task, in sequence order (Section IV of the paper).

    ``now``: seconds since 1970, on the clock of ``snapshot.taken_at``. ``solve``: look for the best plan with
    it, if the policy settles plans, and certify how good it is (ADR 71).

    Raises:
        ValueError: the tasks' needs form a cycle, or the weights are not usable (validation of the files
            finds both).
    """
    rules = POLICIES[policy.name]
    used = replace(policy, weights=policy.weights.normalised())
    fleet = add_measured_demands(build_capacities(inventory, snapshot, manager, used.without), tasks, manager)
    state = build_initial_state(tasks, manager, fleet, now, used)
    if not rules.strict_paper:
        state = reserve_running_tasks(state, tasks)
        fleet = state.ledger.fleet
    order = order_tasks(tasks.tasks.values(), used.sequence)
    context = AssignmentContext(
        arrays=_load_array_scan(fleet, tasks, used),
        fleet=fleet,
        policy=sign_weights(used) if rules.settles else used,
        rules=rules.candidates,
        shares=build_demand_shares(fleet),
        now=now,
        first=_select_first_placements(manager, state),
        handoffs=collect_handoff_history(manager),
        placement_rules=build_placement_rules(order, fleet, state) if rules.settles else NO_RULES,
    )
    how = PlacementPass(
        context=context,
        order=order,
        rules=rules,
        initial=state,
    )
    certificate = None
    if not rules.settles:
        outcome, settled = _run_once(how, state)
    else:
        found, certificate = _run_with_groups(how, state, solve)
        outcome, settled = found.outcome, found.settled
    return Assignment(
        policy=used,
        decisions=outcome.decisions,
        expected=outcome.ledger.expected({place for place, _ in outcome.placed.values()}),
        settled=settled,
        frozen=state.frozen,
        unseen=state.unseen,
        demand_spreads=find_demand_spreads(fleet, tasks),
        shortages=compute_shortages(state, tasks),
        certificate=certificate,
    )


def _load_array_scan(fleet: Capacities, tasks: Tasks, policy: Policy) -> "ArrayScan | None":
    """The scan in NumPy where that pays, and where NumPy is installed (extra ``scale``)."""
    if fleet.edges * len(tasks.tasks) < MIN_ARRAY_PAIRS:
        return None
    try:
        from edgectl.scheduler.array_scan import build_array_scan
    except ImportError:
        return None
    return build_array_scan(fleet, policy.weights)


def _select_first_placements(manager: ManagerState, state: InitialState) -> dict[str, str]:
    """First placements, without those of tasks that leave theirs because it is silent (ADR 0023)."""
    return {task: host for task, host in manager.first.items() if task not in state.replaced}


class SettledPlan(NamedTuple):
    """A plan, whether its repetition leaves it as it is, and the moves of the passes before it."""

    outcome: PassResult
    settled: bool
    prior_moves: Mapping[str, Choice]


def _run_with_groups(
    how: PlacementPass, initial: InitialState, solve: Solver | None
) -> tuple[SettledPlan, Certificate | None]:
    """A plan in which no group is started in part (ADR 73): made again without each that is incomplete."""
    plain, found = _run_until_settled(how, optimal=solve is not None)
    groups, tasks = how.context.placement_rules.groups, {task.name: task for task in how.order}
    for round_ in range(MAX_ROUNDS + len(groups) if groups else 0):
        withheld = withhold_incomplete_groups(
            groups, tasks, found.outcome.decisions, how.initial.running, every=round_ >= MAX_ROUNDS
        )
        if not withheld:
            break
        state = replace(how.initial, fixed={**how.initial.fixed, **withheld})
        rules = build_placement_rules(how.order, how.context.fleet, state)
        how = replace(how, initial=state, context=replace(how.context, placement_rules=rules))
        plain, found = _run_until_settled(how, optimal=solve is not None)
    if solve is None:
        return found, None
    return _optimise(how, plain, found, solve, withheld=len(how.initial.fixed.keys() - initial.fixed.keys()))


def _run_until_settled(how: PlacementPass, *, optimal: bool) -> tuple[SettledPlan, SettledPlan]:
    """A plan that its repetition does not change; and it with room made for tasks that found none (ADR 64),
    and with a greater sum of utilities where that is asked for.
    """
    plain = _settle(how, how.initial, {})
    found = _make_room(how, plain)
    if optimal:
        known = _build_unrepaired(how, found)
        changed = rebalance_plan(known, started_only=True)
        return plain, _take_better(how, _build_unrepaired(how, plain), found, changed)
    if found.settled and how.context.policy.rebalance:
        found = _rebalance(how, found)
    return plain, found


def _make_room(how: PlacementPass, plain: SettledPlan) -> SettledPlan:
    """The plan with room made for tasks that found none (ADR 64)."""
    changed = repair_plan(_build_unrepaired(how, plain))
    return _settle_changed(how, plain, changed) if changed else plain


def _rebalance(how: PlacementPass, found: SettledPlan) -> SettledPlan:
    """A settled plan with a greater sum of utilities and as many tasks placed, else the same one (ADR 66)."""
    before = _build_unrepaired(how, found)
    changed = rebalance_plan(before)
    if not changed:
        return found
    other = _settle_changed(how, found, changed)
    gains = rate_plan(_build_unrepaired(how, other)) > rate_plan(before)
    placed_before = found.outcome.placed.keys()
    return other if other.settled and gains and other.outcome.placed.keys() >= placed_before else found


def _optimise(
    how: PlacementPass, plain: SettledPlan, known: SettledPlan, solve: Solver, withheld: int
) -> tuple[SettledPlan, Certificate]:
    """The better one of the known plan and of what the solver finds; both are settled and valued by the same
    rules.

    With rules between tasks the solver only bounds: it does not know them, and its places may break them.
    """
    relaxed = how.context.placement_rules is not NO_RULES
    origin, before = _build_unrepaired(how, plain), _build_unrepaired(how, known)
    optimum = find_optimum(origin, before, keep_bounds(solve) if relaxed else solve)
    best = _take_better(how, origin, known, choose_places(before, optimum.places))
    value = value_plan(_build_unrepaired(how, best), origin)
    wanted = len({*origin.placed, *(task.name for task in list_wanted(origin))})
    return best, replace(certify(value, wanted, optimum), relaxed=relaxed, withheld=withheld)


def _take_better(
    how: PlacementPass, origin: UnrepairedPlan, best: SettledPlan, changed: Mapping[str, Choice]
) -> SettledPlan:
    """The plan with ``changed``, settled again, if that makes it better and overloads no host anew."""
    if not changed:
        return best
    other = _settle_changed(how, best, changed)
    plan, known = _build_unrepaired(how, other), _build_unrepaired(how, best)
    better = value_plan(plan, origin).is_better_than(value_plan(known, origin))
    return other if other.settled and better and is_overload_kept(plan, known) else best


def _settle_changed(how: PlacementPass, plan: SettledPlan, changed: Mapping[str, Choice]) -> SettledPlan:
    other = _change_choices(how, plan.outcome, changed)
    moves = collect_prior_moves(other, plan.prior_moves, how.initial)
    return _settle(how, state_from_pass(how.initial, other, how.initial), moves)


def _settle(how: PlacementPass, start: InitialState, prior_moves: Mapping[str, Choice]) -> SettledPlan:
    """The first of five passes that its repetition does not change; else one without voluntary moves.

    The first pass is recorded at once, because most plans stand at once; a later one only when it is known to
    be the one.
    """
    recorded = replace(how, record=True)
    state, moves = start, prior_moves
    outcome = run_pass(recorded, state, moves)
    for _ in range(MAX_PASSES):
        put = collect_prior_moves(outcome, moves, how.initial)
        next_state = state_from_pass(state, outcome, how.initial)
        repeated = run_pass(how, next_state, put)
        if repeated.places == outcome.places:
            last = outcome if state is start else run_pass(recorded, state, moves)
            return SettledPlan(last, settled=True, prior_moves=moves)
        state, moves, outcome = next_state, put, repeated
    last = run_pass(replace(recorded, voluntary=False), start, prior_moves)
    return SettledPlan(last, settled=False, prior_moves=prior_moves)


def _build_unrepaired(how: PlacementPass, plan: SettledPlan) -> UnrepairedPlan:
    outcome = plan.outcome
    left = _count_moves_left(how, collect_prior_moves(outcome, plan.prior_moves, how.initial))
    return UnrepairedPlan(
        context=how.context,
        order=how.order,
        initial=how.initial,
        choices=outcome.choices,
        placed=outcome.placed,
        ledger=outcome.ledger,
        moves_left=None if left is None else max(0, left),
    )


def _change_choices(how: PlacementPass, outcome: PassResult, changed: Mapping[str, Choice]) -> PassResult:
    """``outcome`` with other choices for some tasks, and gamma in step with them."""
    ledger, placed = outcome.ledger.copy(), dict(outcome.placed)
    for name in changed:
        if name in placed:
            ledger.release(*placed.pop(name))
    for task in how.order:
        choice = changed.get(task.name)
        if choice is not None and choice.place is not None:
            use = compute_demand_usage(ledger.fleet, task, choice.place)
            ledger.charge(choice.place, use)
            placed[task.name] = choice.place, use
    return replace(outcome, choices={**outcome.choices, **changed}, placed=placed, ledger=ledger)


def _run_once(how: PlacementPass, initial: InitialState) -> tuple[PassResult, bool]:
    """One pass, and whether its repetition would change it."""
    outcome = run_pass(replace(how, record=True), initial, {})
    return outcome, run_pass(
        how, state_from_pass(initial, outcome, initial), collect_prior_moves(outcome, {}, initial)
    ).places == outcome.places
