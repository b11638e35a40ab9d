"""What every verb that changes a fleet shares: the lock, the open sessions, the journal, and the memory afterwards."""

import contextlib
import dataclasses
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from edgectl.errors import StateError
from edgectl.executor.recover import release
from edgectl.executor.remember import generations, remember
from edgectl.executor.run import RunOptions, run
from edgectl.gateway.collect import ProbeOptions
from edgectl.model.memory import Memory
from edgectl.model.plan import Plan
from edgectl.model.progress import Listener, unheard
from edgectl.model.result import Results
from edgectl.state.journal import NAME as JOURNAL
from edgectl.state.journal import Journal
from edgectl.state.journal_read import Log, standing
from edgectl.state.lock import FleetLock, user
from edgectl.state.memory import kept, load_memory, save_memory
from edgectl.transport.pool import SessionPool
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.keepalive import kept_alive
from edgectl.usecases.plan import plan_id, whole
from edgectl.usecases.record import record_results
from edgectl.usecases.touch import in_touch

Confirm = Callable[[Plan], bool]
_NOTHING_DONE = Results(revision=0, actions=(), seconds=0.0)


def agreed(_plan: Plan) -> bool:
    """Say yes without asking."""
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class ApplyOptions:
    """``lock_timeout`` (s): how long to wait for another edgectl. ``max_parallel``: actions at once.

    ``fail_fast``: after a failure nothing new begins; ``deadline`` (monotonic): nor after it.

    ``choose`` narrows a plan (``--target``). ``stop_requested``: set it, and no further action begins.
    """

    lock_timeout: float = 0.0
    max_parallel: int = 16
    fail_fast: bool = False
    deadline: float | None = None
    probe: ProbeOptions | None = None
    choose: Callable[[Plan], Plan] = whole
    progress: Listener = unheard
    stop_requested: threading.Event = field(default_factory=threading.Event)


@dataclass(frozen=True, slots=True, kw_only=True)
class Applied:
    """The plan, and how it went; no results where there was nothing to do, or it was declined."""

    plan: Plan
    results: Results | None = None
    declined: bool = False


@contextlib.contextmanager
def changing(fleet: Fleet, verb: str, options: ApplyOptions) -> Iterator[Fleet]:
    """The fleet, locked against every other edgectl of this machine, its sessions kept open until the end.

    Raises:
        LockBusyError: another edgectl is changing this fleet.
    """
    with (
        FleetLock(fleet.state, verb=verb, timeout=options.lock_timeout, clock=fleet.clock),
        SessionPool(fleet.transport) as pool,
    ):
        yield dataclasses.replace(fleet, transport=pool)


def carry_out(
    fleet: Fleet, plan: Plan, confirm: Confirm, options: ApplyOptions, *, verb: str = "apply", name: str | None = None
) -> Applied:
    """Ask, record, run and remember; ``verb`` goes into the journal; ``name`` is the id of a saved plan. Call it within ``changing``."""
    memory = plan.snapshot.memory or Memory()
    if plan.changes and not confirm(plan):
        return Applied(plan=plan, declined=True)
    cut_off = _say_unfinished(fleet)
    if not plan.changes:
        _remember(fleet, plan, memory, _NOTHING_DONE, {})
        _recover(fleet, cut_off)
        return Applied(plan=plan)
    used = generations(memory, plan.snapshot, plan.steps, fleet.clock(), cut_off.generations)
    with Journal.open(fleet.state, clock=fleet.clock, warn=fleet.warn) as journal:
        run_options = RunOptions(
            plan_id=name or plan_id(plan),
            revision=journal.log.revision + 1,
            generations=used,
            max_parallel=options.max_parallel,
            stop_requested=options.stop_requested,
            fail_fast=options.fail_fast,
            deadline=options.deadline,
            verb=verb,
            user=user(),
        )
        with in_touch(fleet) as near, kept_alive(near, plan.snapshot):
            results = run(plan, fleet.inventory, fleet.tasks, near.transport, journal, run_options, options.progress)
        after = _remember(fleet, plan, memory, results, used)
        _record_placements(fleet, journal, results.revision, after)
    record_results(fleet, plan, results)
    _recover(fleet, cut_off)
    return Applied(plan=plan, results=results)


def settled(fleet: Fleet, plan: Plan) -> bool:
    """Whether `carry_out` would do nothing at all: no action, nothing new to remember, nothing cut off to recover from."""
    if plan.changes:
        return False
    after = remember(plan.snapshot.memory or Memory(), plan, fleet.tasks, _NOTHING_DONE, {}, fleet.clock())
    return kept(after) == load_memory(fleet.state) and standing(fleet.state / JOURNAL).sound


def _record_placements(fleet: Fleet, journal: Journal, revision: int, after: Memory) -> None:
    """Where every task stands now: what a rollback goes back to."""
    placements = {task: placement.host for task, placement in after.placements.items()}
    try:
        journal.append("placed", revision=revision, placements=placements)
    except StateError as error:
        fleet.warn(f"{error.message}: revision {revision} cannot be gone back to")


def _say_unfinished(fleet: Fleet) -> Log:
    """What the journal knows of an apply that was cut off."""
    log = Log()
    if (fleet.state / JOURNAL).exists():
        with Journal.open(fleet.state, clock=fleet.clock, warn=fleet.warn) as journal:
            log = journal.log
    if log.unfinished:
        fleet.warn(f"revision {log.revision} was cut off while it changed {', '.join(log.unfinished)}; the hosts were asked what runs now")
    return log


def _recover(fleet: Fleet, log: Log) -> None:
    """Let robots go that an earlier handoff left holding, once they are steered; close the record of the apply that was cut off."""
    if not log.unfinished and not log.held:
        return
    with Journal.open(fleet.state, clock=fleet.clock, warn=fleet.warn) as journal:
        places = load_memory(fleet.state).placements
        for task in journal.log.held:
            located = places[task].host if task in places else None
            with in_touch(fleet) as near:
                released = release(task, located, fleet.inventory, fleet.tasks, near.transport, fleet.warn)
            if released:
                journal.append("released", task=task)
        journal.append("recovered", tasks=list(log.unfinished))


def _remember(fleet: Fleet, plan: Plan, memory: Memory, results: Results, used: dict[str, int]) -> Memory:
    """Save what is known now. A disk that does not take it costs history, not the apply."""
    after = remember(memory, plan, fleet.tasks, results, used, fleet.clock())
    if kept(after) != load_memory(fleet.state):
        save_memory(fleet.state, after)
    return after
