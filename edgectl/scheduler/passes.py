"""One pass over the sequence (Algorithm 1 of the paper) and the world that it leaves behind (DESIGN 5.3, 5.10)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.task import Need, Task, Until
from edgectl.scheduler.choice import Brakes, Choice
from edgectl.scheduler.ledger import Ledger, Use, demand
from edgectl.scheduler.record import decided, relative, told, unseen
from edgectl.scheduler.view import Setting, View, look
from edgectl.scheduler.world import Running, World

Rule = Callable[[View, Brakes], Choice]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one pass chose for each task it decides, where that puts it with which rho, and gamma after it."""

    choices: Mapping[str, Choice]
    placed: Mapping[str, tuple[int, Use]]
    ledger: Ledger
    decisions: tuple[Decision, ...] = ()

    @property
    def places(self) -> dict[str, int | None]:
        """The place of each task, None where unplaced: what a repetition must not change."""
        return {name: choice.place for name, choice in self.choices.items()}


@dataclass(slots=True, kw_only=True)
class _Progress:
    """The pass so far."""

    ledger: Ledger
    located: dict[str, int]
    placed: dict[int, int] = field(default_factory=dict)
    uses: dict[str, tuple[int, Use]] = field(default_factory=dict)
    choices: dict[str, Choice] = field(default_factory=dict)
    decisions: list[Decision] = field(default_factory=list)
    moves_left: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Pass:
    """How to go over the sequence. ``letter``: the paper's way, that is, a running task's own use stays in
    gamma and only what ran before the pass is a predecessor.

    ``origin``: the world before the plan, by which moves are counted and recorded. ``record``: keep the rankings.
    """

    setting: Setting
    order: Sequence[Task]
    rule: Rule
    origin: World
    letter: bool = False
    voluntary: bool = True
    record: bool = False


def run(how: Pass, world: World, carried: Mapping[str, Choice]) -> Outcome:
    """Place every task of the sequence once. ``carried``: moves that earlier passes of this plan have made."""
    progress = _Progress(ledger=world.ledger.copy(), located=dict(world.located), moves_left=_moves_left(how, carried))
    for task in how.order:
        fixed = world.fixed.get(task.name)
        if fixed is None:
            _decide(how, world, carried, progress, task)
        else:
            progress.decisions.append(fixed)
    return Outcome(choices=progress.choices, placed=progress.uses, ledger=progress.ledger, decisions=tuple(progress.decisions))


def after(world: World, outcome: Outcome, origin: World) -> World:
    """The expected outcome as a world: each placed task runs where it was put, using its rho."""
    running = {name: _running(name, outcome, origin) for name, choice in outcome.choices.items() if choice.place is not None}
    located = {**world.located, **{name: there.place for name, there in running.items()}}
    return replace(world, ledger=outcome.ledger, running=running, located=located)


def _running(name: str, outcome: Outcome, origin: World) -> Running:
    place, use = outcome.placed[name]
    before = origin.running.get(name)
    return Running(place=place, use=use, since=before.since if before is not None and before.place == place else None)


def moved(outcome: Outcome, carried: Mapping[str, Choice], origin: World) -> dict[str, Choice]:
    """Why each task stands where this plan, not the origin, has it: the choice that put it there."""
    moves = {**carried, **{name: choice for name, choice in outcome.choices.items() if choice.verdict is Verdict.PLACED}}
    return {name: choice for name, choice in moves.items() if choice.place != _place(origin, name)}


def _place(world: World, name: str) -> int | None:
    running = world.running.get(name)
    return running.place if running is not None else None


def _moves_left(how: Pass, carried: Mapping[str, Choice]) -> int | None:
    policy = how.setting.policy
    if policy.attended or policy.max_moves is None:
        return None
    return policy.max_moves - sum(choice.voluntary for choice in carried.values())


def _decide(how: Pass, world: World, carried: Mapping[str, Choice], progress: _Progress, task: Task) -> None:
    """One task: its own use leaves gamma, every place is weighed, and its rho is charged where it is put."""
    running = world.running.get(task.name)
    if running is not None and not how.letter:
        progress.ledger.take_out(running.place, running.use)
    missing = _missing(task, progress.located, world.completed) if running is None else None
    if missing is not None:
        reason = Reason.PREDECESSOR_INCOMPLETE if missing in progress.located else Reason.PREDECESSOR_MISSING
        choice = Choice(verdict=Verdict.UNPLACED, reason=reason, subject=missing)
        progress.decisions.append(told(unseen(task, choice), how.origin.replaced.get(task.name)))
    else:
        choice = _choose(how, world, carried, progress, task)
    progress.choices[task.name] = choice
    if choice.place is not None:
        _charge(progress, task, choice.place)
    if progress.moves_left is not None and choice.voluntary and task.name not in carried:
        progress.moves_left -= 1


def _choose(how: Pass, world: World, carried: Mapping[str, Choice], progress: _Progress, task: Task) -> Choice:
    running = world.running.get(task.name)
    incumbent = running.place if running is not None else None
    known = world.located if how.letter else progress.located
    predecessors = {need.task: known[need.task] for need in task.needs if need.task in known}
    weigh = partial(look, how.setting, progress.ledger, task, incumbent=incumbent, predecessors=predecessors, placed=progress.placed)
    view = weigh()
    choice = how.rule(view, _brakes(how, world, progress, running))
    if how.record:
        origin = _place(how.origin, task.name)
        if choice.place in view.denied and choice.place == incumbent:
            view = weigh(stays=True)
        decision = decided(view, relative(choice, origin, carried.get(task.name)), origin)
        progress.decisions.append(told(decision, how.origin.replaced.get(task.name)))
    return choice


def _brakes(how: Pass, world: World, progress: _Progress, running: Running | None) -> Brakes:
    dwell_s = how.setting.now - running.since if running is not None and running.since is not None else None
    return Brakes(frozen=world.frozen, voluntary=how.voluntary, dwell_s=dwell_s, moves_left=progress.moves_left)


def _charge(progress: _Progress, task: Task, place: int) -> None:
    use = demand(progress.ledger.fleet, task, place)
    progress.ledger.charge(place, use)
    progress.uses[task.name] = (place, use)
    progress.located[task.name] = place
    progress.placed[place] = progress.placed.get(place, 0) + 1


def _missing(task: Task, located: Mapping[str, int], completed: frozenset[str]) -> str | None:
    """The first predecessor that is not as far as ``task`` needs it."""
    return next((need.task for need in task.needs if not _met(need, located, completed)), None)


def _met(need: Need, located: Mapping[str, int], completed: frozenset[str]) -> bool:
    """Placed in this plan or running is enough (the executor waits for ready), unless it must have completed (ADR 0013)."""
    return need.task in completed or (need.until is not Until.COMPLETED and need.task in located)
