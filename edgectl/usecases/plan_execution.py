# SPDX-License-Identifier: Apache-2.0
"""Execution of plans: lock, open sessions, journal, and the manager's state afterwards."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.errors import StateError, UsageError
from edgectl.executor.dependencies import list_stop_hosts
from edgectl.executor.manager_state_update import compute_next_generations, update_manager_state
from edgectl.executor.run_options import RunIdentity, RunOptions
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.gateway.task_lookup import find_doubled_instances
from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan
from edgectl.model.progress import ProgressListener, ignore_progress
from edgectl.model.result import Outcome, Results
from edgectl.rules.ros_nodes import list_lost_nodes
from edgectl.state.heartbeats import record_orphans
from edgectl.state.journal import JOURNAL_FILE_NAME, Journal
from edgectl.state.journal_reader import JournalSummary, read_journal_cached
from edgectl.state.lock import FleetLock, describe_manager, get_user_name
from edgectl.state.manager_state import load_manager_state, save_manager_state, select_saved_fields
from edgectl.transport.connections import SessionPool
from edgectl.transport.fleet_lease import Term, WatchNote
from edgectl.transport.silence import SilenceTransport, SilentHosts
from edgectl.units import format_duration
from edgectl.usecases.coordination import (
    announce_starts,
    build_journal_listener,
    load_pending_starts,
    share_results,
)
from edgectl.usecases.doubtful_starts import (
    Starts,
    encode_journaled_doubts,
    list_open_starts,
    load_doubtful_starts,
    load_journaled_doubts,
    restore_known_places,
)
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.fleet_lease import compute_files_digest, hold_fleet
from edgectl.usecases.heartbeat import track_heartbeats
from edgectl.usecases.lost_nodes import forget_lost_nodes
from edgectl.usecases.measured_demand import find_news_of_demands
from edgectl.usecases.plan import compute_plan_id, keep_whole_plan
from edgectl.usecases.record import record_results

Confirm = Callable[[Plan], bool]
_LOOK_TIMEOUT_S = 10.0
_NO_RESULTS = Results(revision=0, actions=(), seconds=0.0)


def confirm_always(_plan: Plan) -> bool:
    """Agree without asking."""
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class ApplyOptions(RunOptions):
    """The options of a change, from the command line to the executor (`RunOptions`).

    ``lock_timeout`` (s): how long to wait for another edgectl; None: for one cycle of a watch, else not at
    all. ``choose`` narrows a plan (``--target``). ``recheck_window`` (s): before tasks move because of
    load, measure once more for so long and plan again (ADR 74); None: act on the first plan. ``dry_run``:
    plan only; nothing is locked, asked, sent or saved.
    """

    lock_timeout: float | None = None
    probe: ProbeOptions | None = None
    choose: Callable[[Plan], Plan] = keep_whole_plan
    recheck_window: float | None = None
    dry_run: bool = False
    progress: ProgressListener = ignore_progress


@dataclass(frozen=True, slots=True, kw_only=True)
class ApplyResult:
    """A plan and its results; no results where there was nothing to do or it was declined.

    ``doubled``: tasks of which two instances were alive after the change, with their hosts.
    """

    plan: Plan
    results: Results | None = None
    declined: bool = False
    doubled: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@contextlib.contextmanager
def lock_fleet(fleet: Fleet, verb: str, options: ApplyOptions) -> Iterator[Fleet]:
    """The fleet, locked against every other edgectl of this machine, with sessions kept open until the end.

    Its first probe claims it on the hosts, against every other machine: probe it before anything is changed.

    Raises:
        LockBusyError: another edgectl is changing this fleet.
    """
    if options.dry_run:
        with SessionPool(fleet.transport) as pool:
            yield dataclasses.replace(fleet, transport=pool)
        return
    with (
        FleetLock(fleet.state, verb=verb, timeout=options.lock_timeout, clock=fleet.clock),
        SessionPool(fleet.transport) as pool,
        hold_fleet(dataclasses.replace(fleet, transport=pool), verb, patience_s=options.lock_timeout) as held,
    ):
        yield held


def confirm_and_execute(
    fleet: Fleet,
    plan: Plan,
    confirm: Confirm,
    options: ApplyOptions,
    *,
    verb: str = "apply",
    name: str | None = None,
) -> ApplyResult:
    """Ask, journal, execute and save; ``verb`` goes into the journal; ``name`` is the id of a saved plan.
    Call it within ``lock_fleet``.

    Raises:
        UsageError: it would start tasks that run on under the former name of this fleet.
    """
    if options.dry_run:
        return ApplyResult(plan=plan)
    check_former_fleet(fleet, plan)
    manager = plan.snapshot.manager or ManagerState()
    if plan.changes and not confirm(plan):
        return ApplyResult(plan=plan, declined=True)
    cut_off, silent = _warn_of_unfinished_apply(fleet), SilentHosts()
    if not plan.changes:
        manager = forget_lost_nodes(fleet, plan, manager, _NO_RESULTS)
        after = _save_manager_state(fleet, plan, manager, _NO_RESULTS, {})
        open_starts = list_open_starts(fleet, plan.snapshot, after, {})
        _share_results(fleet, manager, open_starts)
        _recover_interrupted_apply(fleet, cut_off, silent, open_starts)
        return ApplyResult(plan=plan)
    if isinstance(fleet.transport, SessionPool):
        fleet.transport.expect_requests(_list_changed_hosts(fleet, plan))
    # Before anything is announced. An apply that changes nothing, as most of cron do, needs none of it.
    from edgectl.executor.run import run_plan

    used = compute_next_generations(
        manager, plan.snapshot, plan.steps, fleet.clock(), _list_used_generations(fleet, cut_off)
    )
    plan_id, term = name or compute_plan_id(plan), _get_term(fleet)
    announce_starts(fleet, term, plan.steps, used, plan_id=plan_id, revision=cut_off.revision + 1)
    with Journal.open(
        fleet.state, clock=fleet.clock, warn=fleet.warn, on_append=build_journal_listener(fleet, term)
    ) as journal:
        identity = RunIdentity(
            plan_id=plan_id,
            revision=journal.log.revision + 1,
            generations=used,
            verb=verb,
            user=get_user_name(),
        )
        with track_heartbeats(fleet) as tracked:
            results = run_plan(
                plan,
                fleet.inventory,
                fleet.tasks,
                tracked.transport,
                journal,
                identity,
                options,
                options.progress,
                lease=fleet.lease,
                silent=silent,
            )
        after = _save_manager_state(fleet, plan, manager, results, used)
        open_starts = list_open_starts(fleet, plan.snapshot, after, used)
        _record_placements(fleet, journal, results.revision, after, open_starts)
    left = forget_lost_nodes(fleet, plan, manager, results)
    if left != manager:
        _save_manager_state(fleet, plan, left, results, used)
    _share_results(fleet, left, open_starts)
    _forget_adopted_orphans(fleet, manager, results)
    record_results(fleet, plan, results)
    _recover_interrupted_apply(fleet, cut_off, silent, open_starts)
    if fleet.lease is not None and fleet.lease.watched_by is not None and verb != "watch":
        fleet.warn(_describe_watch(fleet, fleet.lease.watched_by))
    return ApplyResult(plan=plan, results=results, doubled=_look_for_doubled(fleet, plan, silent))


def _list_changed_hosts(fleet: Fleet, plan: Plan) -> list[Host]:
    """The hosts on which a step starts or stops something."""
    named = {
        name
        for step in plan.steps
        if step.action.changes or step.stop
        for name in (step.decision.host, *list_stop_hosts(step))
    }
    return [host for host in fleet.inventory.hosts.values() if host.name in named]


def check_former_fleet(fleet: Fleet, plan: Plan) -> None:
    """Refuse to start what runs on as a task of the fleet that this one was before it lost its name.

    Raises:
        UsageError: there is such a task.
    """
    if fleet.inventory.is_fleet_named:
        return
    from edgectl.rules.former_fleet import find_former_fleet

    found = find_former_fleet(fleet.inventory, plan.steps, plan.snapshot, describe_manager())
    if found is not None:
        raise UsageError(found.message, hint=found.hint)


def _list_used_generations(fleet: Fleet, cut_off: JournalSummary) -> dict[str, int]:
    """The highest generation that a start of each task may have used, by this machine or another one."""
    used = dict(cut_off.generations)
    for task, start in load_pending_starts(fleet).items():
        used[task] = max(used.get(task, 0), start.generation + 1)
    return used


def _look_for_doubled(fleet: Fleet, plan: Plan, silent: SilentHosts) -> dict[str, tuple[str, ...]]:
    """One more look at all hosts that answered: the tasks of which more than one instance is alive."""
    names = [name for name, host in plan.snapshot.hosts.items() if host.ok and name in fleet.inventory.hosts]
    with track_heartbeats(fleet) as tracked:
        doubled = find_doubled_instances(
            [fleet.inventory.hosts[name] for name in names],
            SilenceTransport(tracked.transport, silent),
            timeout=_LOOK_TIMEOUT_S,
        )
    for task, hosts in doubled.items():
        fleet.warn(f"DOUBLED: {task} runs on {' and '.join(hosts)}; edgectl apply stops all but one")
    return doubled


def _describe_watch(fleet: Fleet, watch: WatchNote) -> str:
    files = "" if watch.digest == compute_files_digest(fleet) else ", from other files"
    return f"{watch.who} watches this fleet every {format_duration(watch.every_s)} and plans again{files}"


def _forget_adopted_orphans(fleet: Fleet, manager: ManagerState, results: Results) -> None:
    """An orphan that was adopted fences itself again."""
    adopted = {
        (result.host, result.task)
        for result in results.actions
        if result.action is Action.ADOPT and result.outcome is Outcome.DONE
    }
    left = {
        host: tuple(task for task in tasks if (host, task) not in adopted)
        for host, tasks in manager.orphans.items()
    }
    if left != dict(manager.orphans):
        record_orphans(fleet.state, left)


def has_nothing_to_do(fleet: Fleet, plan: Plan) -> bool:
    """Whether executing the plan would do nothing: no action, nothing to record, no interrupted apply to
    recover.
    """
    if plan.changes:
        return False
    manager = plan.snapshot.manager or ManagerState()
    after = _compute_state_to_save(fleet, plan, manager, _NO_RESULTS, {})
    return (
        select_saved_fields(after) == load_manager_state(fleet.state)
        and list_open_starts(fleet, plan.snapshot, after, {}) == load_doubtful_starts(fleet)
        and (_get_term(fleet) is None or find_news_of_demands(fleet, after.measured) is None)
        and not any(list_lost_nodes(plan.snapshot, fleet.inventory, ()))
        and read_journal_cached(fleet.state / JOURNAL_FILE_NAME).sound
    )


def _record_placements(
    fleet: Fleet, journal: Journal, revision: int, after: ManagerState, open_starts: Starts
) -> None:
    """The present placement of every task, to which a rollback returns."""
    placements = {task: placement.host for task, placement in after.placements.items()}
    doubtful = encode_journaled_doubts(fleet, open_starts)
    try:
        journal.append("placed", revision=revision, placements=placements, doubtful=doubtful)
    except StateError as error:
        fleet.warn(f"{error.message}: revision {revision} cannot be restored")


def _warn_of_unfinished_apply(fleet: Fleet) -> JournalSummary:
    """Warn about an apply that was interrupted, as the journal shows it."""
    log = JournalSummary()
    if (fleet.state / JOURNAL_FILE_NAME).exists():
        with Journal.open(fleet.state, clock=fleet.clock, warn=fleet.warn) as journal:
            log = journal.log
    if log.unfinished:
        fleet.warn(
            f"revision {log.revision} was interrupted while it changed {', '.join(log.unfinished)}; the "
            "hosts were asked for their running tasks"
        )
    return log


def _recover_interrupted_apply(
    fleet: Fleet, log: JournalSummary, silent: SilentHosts, open_starts: Starts
) -> None:
    """Release held robots once a ready instance controls them, remove the state that moves have left on
    hosts, close the record of the interrupted apply, but for the starts that stay open.
    """
    settled = load_journaled_doubts(fleet).keys() <= open_starts.keys()
    if not log.unfinished and not log.held and not log.spooled and settled:
        return
    from edgectl.executor.hold_release import release_hold
    from edgectl.executor.state_removal import drop_left_state

    term = _get_term(fleet)
    with Journal.open(
        fleet.state, clock=fleet.clock, warn=fleet.warn, on_append=build_journal_listener(fleet, term)
    ) as journal:
        places = load_manager_state(fleet.state).placements
        for task in journal.log.held:
            located = places[task].host if task in places else None
            with track_heartbeats(fleet) as tracked:
                released = release_hold(
                    task,
                    located,
                    fleet.inventory,
                    fleet.tasks,
                    SilenceTransport(tracked.transport, silent, recovers=True),
                    fleet.warn,
                    fleet.lease,
                )
            if released:
                journal.append("released", task=task)
        for task, hosts in journal.log.spooled.items():
            with track_heartbeats(fleet) as tracked:
                transport = SilenceTransport(tracked.transport, silent)
                dropped = drop_left_state(task, hosts, fleet.inventory, transport, fleet.lease)
            if dropped:
                journal.append("dropped", task=task)
        doubtful = encode_journaled_doubts(fleet, open_starts)
        journal.append("recovered", tasks=list(log.unfinished), doubtful=doubtful)
    share_results(fleet, term)


def _get_term(fleet: Fleet) -> Term | None:
    return fleet.lease.term if fleet.lease is not None else None


def _save_manager_state(
    fleet: Fleet, plan: Plan, manager: ManagerState, results: Results, used: dict[str, int]
) -> ManagerState:
    """Save the manager's state. A full disk costs history, not the apply."""
    after = _compute_state_to_save(fleet, plan, manager, results, used)
    if select_saved_fields(after) != load_manager_state(fleet.state):
        save_manager_state(fleet.state, after)
    return after


def _share_results(fleet: Fleet, manager: ManagerState, open_starts: Starts) -> None:
    """Save in etcd what the files of this machine have now, where there is one."""
    term = _get_term(fleet)
    if term is not None:
        share_results(fleet, term, open_starts, find_news_of_demands(fleet, manager.measured))


def _compute_state_to_save(
    fleet: Fleet, plan: Plan, manager: ManagerState, results: Results, used: Mapping[str, int]
) -> ManagerState:
    after = update_manager_state(manager, plan, fleet.tasks, results, used, fleet.clock())
    return restore_known_places(fleet, plan.snapshot, after)
