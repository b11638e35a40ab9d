"""The scheduler: (Inventory, Tasks, Snapshot, Memory, Policy, now) -> Assignment. Pure, and the same bytes for the same inputs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from edgectl.model.assignment import Assignment, Decision, Reason, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Need, NeedCondition, Task, Tasks
from edgectl.model.weights import normalise_weights
from edgectl.scheduler.candidates import AssignmentContext, CandidateSet, evaluate_candidates
from edgectl.scheduler.capacities import build_capacities
from edgectl.scheduler.choice import Choice, MoveConstraints
from edgectl.scheduler.decisions import (
    build_decision,
    explain_replacement,
    rebase_on_initial,
    unplaced_decision,
)
from edgectl.scheduler.demand import add_measured_demands
from edgectl.scheduler.demand_spread import find_demand_spreads
from edgectl.scheduler.initial_state import InitialState, RunningTask, build_initial_state
from edgectl.scheduler.ledger import Ledger, TaskUsage, compute_demand_usage
from edgectl.scheduler.move_cost import collect_handoff_history
from edgectl.scheduler.policies import CHOICE_RULES
from edgectl.scheduler.scan import build_demand_shares
from edgectl.scheduler.sequence import order_tasks

ChoiceRule = Callable[[CandidateSet, MoveConstraints], Choice]


@dataclass(frozen=True, slots=True, kw_only=True)
class PassResult:
    """What one pass chose for each task it decides, where that puts it with which rho, and gamma after it."""

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
    """The pass so far."""

    ledger: Ledger
    located: dict[str, int]
    placed: dict[int, int] = field(default_factory=dict)
    uses: dict[str, tuple[int, TaskUsage]] = field(default_factory=dict)
    choices: dict[str, Choice] = field(default_factory=dict)
    decisions: list[Decision] = field(default_factory=list)
    moves_left: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementPass:
    """How to go over the sequence. ``letter``: the paper's way, that is, a running task's own use stays in
    gamma and only what ran before the pass is a predecessor.

    ``origin``: the world before the plan, by which moves are counted and recorded. ``record``: keep the rankings.
    """

    setting: AssignmentContext
    order: Sequence[Task]
    rule: ChoiceRule
    initial: InitialState
    strict_paper: bool = False
    voluntary: bool = True
    record: bool = False


def run_pass(how: PlacementPass, world: InitialState, carried: Mapping[str, Choice]) -> PassResult:
    """Place every task of the sequence once. ``carried``: moves that earlier passes of this plan have made."""
    progress = _PassState(
        ledger=world.ledger.copy(), located=dict(world.located), moves_left=_count_moves_left(how, carried)
    )
    for task in how.order:
        fixed = world.fixed.get(task.name)
        if fixed is None:
            _decide_task(how, world, carried, progress, task)
        else:
            progress.decisions.append(fixed)
    return PassResult(
        choices=progress.choices,
        placed=progress.uses,
        ledger=progress.ledger,
        decisions=tuple(progress.decisions),
    )


def state_from_pass(world: InitialState, outcome: PassResult, origin: InitialState) -> InitialState:
    """The expected outcome as a world: each placed task runs where it was put, using its rho."""
    running = {
        name: _build_running_task(name, outcome, origin)
        for name, choice in outcome.choices.items()
        if choice.place is not None
    }
    located = {**world.located, **{name: there.place for name, there in running.items()}}
    return replace(world, ledger=outcome.ledger, running=running, located=located)


def _build_running_task(name: str, outcome: PassResult, origin: InitialState) -> RunningTask:
    place, use = outcome.placed[name]
    before = origin.running.get(name)
    return RunningTask(
        place=place, use=use, since=before.since if before is not None and before.place == place else None
    )


def collect_prior_moves(
    outcome: PassResult, carried: Mapping[str, Choice], origin: InitialState
) -> dict[str, Choice]:
    """Why each task stands where this plan, not the origin, has it: the choice that put it there."""
    moves = {
        **carried,
        **{name: choice for name, choice in outcome.choices.items() if choice.verdict is Verdict.PLACED},
    }
    return {name: choice for name, choice in moves.items() if choice.place != _find_place(origin, name)}


def _find_place(world: InitialState, name: str) -> int | None:
    running = world.running.get(name)
    return running.place if running is not None else None


def _count_moves_left(how: PlacementPass, carried: Mapping[str, Choice]) -> int | None:
    policy = how.setting.policy
    if policy.attended or policy.max_moves is None:
        return None
    return policy.max_moves - sum(choice.voluntary for choice in carried.values())


def _decide_task(
    how: PlacementPass, world: InitialState, carried: Mapping[str, Choice], progress: _PassState, task: Task
) -> None:
    """One task: its own use leaves gamma, every place is weighed, and its rho is charged where it is put."""
    running = world.running.get(task.name)
    if running is not None and not how.strict_paper:
        progress.ledger.release(running.place, running.use)
    missing = _find_missing_predecessor(task, progress.located, world.completed) if running is None else None
    if missing is not None:
        reason = Reason.PREDECESSOR_INCOMPLETE if missing in progress.located else Reason.PREDECESSOR_MISSING
        choice = Choice(verdict=Verdict.UNPLACED, reason=reason, subject=missing)
        progress.decisions.append(
            explain_replacement(unplaced_decision(task, choice), how.initial.replaced.get(task.name))
        )
    else:
        choice = _choose_place(how, world, carried, progress, task)
    progress.choices[task.name] = choice
    if choice.place is not None:
        _charge_demand(progress, task, choice.place)
    if progress.moves_left is not None and choice.voluntary and task.name not in carried:
        progress.moves_left -= 1


def _choose_place(
    how: PlacementPass, world: InitialState, carried: Mapping[str, Choice], progress: _PassState, task: Task
) -> Choice:
    running = world.running.get(task.name)
    incumbent = running.place if running is not None else None
    known = world.located if how.strict_paper else progress.located
    predecessors = {need.task: known[need.task] for need in task.needs if need.task in known}
    weigh = partial(
        evaluate_candidates,
        how.setting,
        progress.ledger,
        task,
        incumbent=incumbent,
        predecessors=predecessors,
        placed=progress.placed,
    )
    view = weigh()
    choice = how.rule(view, _build_move_constraints(how, world, progress, running))
    if how.record:
        origin = _find_place(how.initial, task.name)
        if choice.place in view.denied and choice.place == incumbent:
            view = weigh(stays=True)
        decision = build_decision(view, rebase_on_initial(choice, origin, carried.get(task.name)), origin)
        progress.decisions.append(explain_replacement(decision, how.initial.replaced.get(task.name)))
    return choice


def _build_move_constraints(
    how: PlacementPass, world: InitialState, progress: _PassState, running: RunningTask | None
) -> MoveConstraints:
    dwell_s = how.setting.now - running.since if running is not None and running.since is not None else None
    return MoveConstraints(
        frozen=world.frozen, voluntary=how.voluntary, dwell_s=dwell_s, moves_left=progress.moves_left
    )


def _charge_demand(progress: _PassState, task: Task, place: int) -> None:
    use = compute_demand_usage(progress.ledger.fleet, task, place)
    progress.ledger.charge(place, use)
    progress.uses[task.name] = (place, use)
    progress.located[task.name] = place
    progress.placed[place] = progress.placed.get(place, 0) + 1


def _find_missing_predecessor(
    task: Task, located: Mapping[str, int], completed: frozenset[str]
) -> str | None:
    """The first predecessor that is not as far as ``task`` needs it."""
    return next((need.task for need in task.needs if not _is_need_met(need, located, completed)), None)


def _is_need_met(need: Need, located: Mapping[str, int], completed: frozenset[str]) -> bool:
    """Placed in this plan or running is enough (the executor waits for ready), unless it must have completed (ADR 0013)."""
    return need.task in completed or (need.until is not NeedCondition.COMPLETED and need.task in located)


# How many passes may be tried before a plan counts as one that does not settle (DESIGN 5.10).
MAX_PASSES = 5


def assign(
    inventory: Inventory, tasks: Tasks, snapshot: Snapshot, memory: ManagerState, policy: Policy, now: float
) -> Assignment:
    """A host, numbers and a reason for each task, in sequence order (Section IV of the paper; DESIGN section 5).

    ``now``: seconds since 1970, on the clock of ``snapshot.taken_at``.

    Raises:
        ValueError: the tasks' needs form a cycle, or the weights are not usable (both are errors of the files, found by validation).
    """
    used = replace(policy, weights=normalise_weights(policy.weights))
    fleet = add_measured_demands(build_capacities(inventory, snapshot, memory, used.without), tasks, memory)
    world = build_initial_state(tasks, memory, fleet, now)
    setting = AssignmentContext(
        fleet=fleet,
        policy=used,
        shares=build_demand_shares(fleet),
        now=now,
        first=_select_first_placements(memory, world),
        handoffs=collect_handoff_history(memory),
    )
    order = order_tasks(tasks.tasks.values(), used.sequence)
    how = PlacementPass(
        setting=setting,
        order=order,
        rule=CHOICE_RULES[used.name],
        initial=world,
        strict_paper=used.name is PolicyName.PAPER,
    )
    outcome, settled = (
        _run_until_settled(how, world) if used.name is PolicyName.UTILITY else _run_once(how, world)
    )
    return Assignment(
        policy=used,
        decisions=outcome.decisions,
        expected=outcome.ledger.expected({place for place, _ in outcome.placed.values()}),
        settled=settled,
        frozen=world.frozen,
        unseen=world.unseen,
        demand_spreads=find_demand_spreads(fleet, tasks),
    )


def _select_first_placements(memory: ManagerState, world: InitialState) -> dict[str, str]:
    """First placements, without those of tasks that leave theirs because it is silent (ADR 0023)."""
    return {task: host for task, host in memory.first.items() if task not in world.replaced}


def _run_until_settled(how: PlacementPass, origin: InitialState) -> tuple[PassResult, bool]:
    """The first of five passes that its repetition does not change; else one without voluntary moves.

    The first pass is recorded at once, because most plans stand at once; a later one only when it is known to be the one.
    """
    recorded = replace(how, record=True)
    world = origin
    carried: dict[str, Choice] = {}
    outcome = run_pass(recorded, world, carried)
    for _ in range(MAX_PASSES):
        put = collect_prior_moves(outcome, carried, origin)
        next_world = state_from_pass(world, outcome, origin)
        repeated = run_pass(how, next_world, put)
        if repeated.places == outcome.places:
            return outcome if world is origin else run_pass(recorded, world, carried), True
        world, carried, outcome = next_world, put, repeated
    return run_pass(replace(recorded, voluntary=False), origin, {}), False


def _run_once(how: PlacementPass, origin: InitialState) -> tuple[PassResult, bool]:
    """One pass, and whether its repetition would change it."""
    outcome = run_pass(replace(how, record=True), origin, {})
    return outcome, run_pass(
        how, state_from_pass(origin, outcome, origin), collect_prior_moves(outcome, {}, origin)
    ).places == outcome.places
