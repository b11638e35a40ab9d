"""Cordon hosts and move their tasks away through the handoff contracts, until a deadline."""

import dataclasses
import time
from collections.abc import Callable, Sequence

from edgectl.dataclass import dataclass
from edgectl.executor.operator_plans import list_copies, list_running_instances
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy
from edgectl.model.result import Outcome
from edgectl.model.snapshot import Snapshot
from edgectl.model.standby_plan import StandbyAction
from edgectl.names import check_known_names
from edgectl.state.manager_state import load_manager_state, save_manager_state
from edgectl.usecases.coordination import share_state
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from edgectl.usecases.plan_execution import (
    ApplyOptions,
    ApplyResult,
    Confirm,
    confirm_always,
    confirm_and_execute,
    lock_fleet,
)
from edgectl.usecases.probe import probe_fleet

_RETRY_PAUSE_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DrainResult:
    """The passes that changed something (else the first), in order, and the tasks that are or may be left:
    (task, host).
    """

    passes: tuple[ApplyResult, ...]
    left: tuple[tuple[str, str], ...] = ()

    @property
    def applied(self) -> ApplyResult:
        """The last pass; its results decide the exit code."""
        return self.passes[-1]

    @property
    def done(self) -> bool:
        """Whether the hosts are empty."""
        return not self.left and not self.applied.declined


def drain_hosts(
    fleet: Fleet,
    policy: Policy,
    names: Sequence[str],
    confirm: Confirm = confirm_always,
    options: ApplyOptions | None = None,
    *,
    timeout: float = 300.0,
    pause: Callable[[float], None] = time.sleep,
) -> DrainResult:
    """Cordon ``names`` and move their tasks away; retry deferred and failed moves until ``timeout`` seconds
    have passed.

    The operator is asked once, before anything is done; ``uncordon`` makes the hosts schedulable again. No
    other task moves.

    Raises:
        UsageError: a host is unknown.
        LockBusyError: another edgectl is changing this fleet.
    """
    check_known_names(names, fleet.inventory.hosts, "host")
    deadline = time.monotonic() + timeout
    options = dataclasses.replace(options or ApplyOptions(), deadline=deadline)
    with lock_fleet(fleet, "drain", options) as held:

        def begin(plan: Plan) -> bool:
            return confirm(plan) and _mark_draining(held, names)

        made = _plan_drain(held, policy, names, options)
        if options.dry_run:
            return DrainResult(passes=(confirm_and_execute(held, made, begin, options, verb="drain"),))
        if not made.changes:
            _mark_draining(held, names)
        passes = [confirm_and_execute(held, made, begin, options, verb="drain")]
        while _can_retry(passes[-1], options, deadline):
            pause(min(_RETRY_PAUSE_S, max(0.0, deadline - time.monotonic())))
            made = _plan_drain(held, policy, names, options)
            if not made.changes:
                break
            passes.append(confirm_and_execute(held, made, confirm_always, options, verb="drain"))
        return DrainResult(
            passes=tuple(passes),
            left=() if passes[-1].declined else _list_remaining_tasks(held, names, made, options),
        )


def _plan_drain(fleet: Fleet, policy: Policy, names: Sequence[str], options: ApplyOptions) -> Plan:
    """The plan limited to the tasks of the drained hosts, made as if the hosts were cordoned. No other task
    moves.
    """
    snapshot = probe_fleet(fleet, options.probe)
    manager = snapshot.manager or ManagerState()
    closed = dataclasses.replace(
        manager, cordons=manager.cordons | set(names), draining=manager.draining | set(names)
    )
    still = dataclasses.replace(policy, attended=False, max_moves=0)
    made = make_plan(fleet, still, snapshot=dataclasses.replace(snapshot, manager=closed))
    leaving = _list_tasks_on(snapshot, names) | {
        task for task, placement in manager.placements.items() if placement.host in names
    }
    copied = _list_copied_tasks(snapshot, names)
    return dataclasses.replace(
        made,
        steps=tuple(
            step if step.task in leaving else _keep_copies_alone(step, names)
            for step in made.steps
            if step.task in leaving or step.task in copied
        ),
        expected={},
        tasks_left_alone={},
    )


def _list_tasks_on(snapshot: Snapshot, names: Sequence[str]) -> set[str]:
    return {
        task
        for task, places in list_running_instances(snapshot).items()
        if not places.keys().isdisjoint(names)
    }


def _list_copied_tasks(snapshot: Snapshot, names: Sequence[str]) -> set[str]:
    """The tasks with inactive copies on the hosts."""
    return {task for task, places in list_copies(snapshot).items() if not places.keys().isdisjoint(names)}


def _keep_copies_alone(step: Step, names: Sequence[str]) -> Step:
    """The step of a task that runs elsewhere, with the actions on its copies alone; if it is about to be
    changed itself, with their stops on the drained hosts.
    """
    if not step.action.changes and not step.stop:
        return step
    stops = tuple(each for each in step.standbys if each.action is StandbyAction.STOP and each.host in names)
    return dataclasses.replace(step, action=Action.NONE, stop=(), instances={}, changed=(), standbys=stops)


def _mark_draining(fleet: Fleet, names: Sequence[str]) -> bool:
    manager = load_manager_state(fleet.state, fleet.warn)
    save_manager_state(
        fleet.state,
        dataclasses.replace(
            manager, cordons=manager.cordons | set(names), draining=manager.draining | set(names)
        ),
    )
    if fleet.lease is not None:
        share_state(fleet, fleet.lease.term)
    return True


def _can_retry(applied: ApplyResult, options: ApplyOptions, deadline: float) -> bool:
    """Whether an action failed that may succeed on retry, with time left."""
    results = applied.results
    if results is None or options.stop_requested.is_set() or time.monotonic() >= deadline:
        return False
    failed = any(action.outcome is Outcome.FAILED for action in results.actions)
    return not results.done and not (failed and options.fail_fast)


def _list_remaining_tasks(
    fleet: Fleet, names: Sequence[str], made: Plan, options: ApplyOptions
) -> tuple[tuple[str, str], ...]:
    """Tasks that run or wait on the hosts, and tasks last known on those that do not answer."""
    snapshot = probe_fleet(fleet, options.probe)
    seen = [
        (task, host)
        for found in (list_running_instances(snapshot), list_copies(snapshot))
        for task, places in found.items()
        for host in places
        if host in names
    ]
    silent = {host for host in names if host in snapshot.hosts and not snapshot.hosts[host].ok}
    return (
        *seen,
        *(
            (step.task, host)
            for step in made.steps
            if (host := step.decision.previous_host) is not None and host in silent
        ),
    )
