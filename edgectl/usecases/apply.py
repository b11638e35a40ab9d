# SPDX-License-Identifier: Apache-2.0
"""Apply a plan under the fleet's lock and record every step."""

import dataclasses

from edgectl.errors import StalePlanError
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.assignment import Reason
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan
from edgectl.model.policy import Policy
from edgectl.state.failpoints import hit_failpoint
from edgectl.state.journal import Journal
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import compute_plan_id, get_solver, make_plan
from edgectl.usecases.plan_execution import (
    ApplyOptions,
    ApplyResult,
    Confirm,
    confirm_always,
    confirm_and_execute,
    lock_fleet,
)
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.record import record_plan

# Window (s) of the second measurement of unattended runs.
RECHECK_WINDOW_S = 5.0
# Moves that a reading which is off may cause.
_MOVES_BY_LOAD = (Reason.GAIN, Reason.GAIN_OVER_COST, Reason.FORCED_INFEASIBLE, Reason.RELIEF)

__all__ = ["ApplyOptions", "ApplyResult", "Confirm", "apply_saved_plan", "check_saved_plan", "plan_and_apply"]


def plan_and_apply(
    fleet: Fleet, policy: Policy, confirm: Confirm = confirm_always, options: ApplyOptions | None = None
) -> ApplyResult:
    """Probe, plan, ask ``confirm``, execute and record.

    Raises:
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with lock_fleet(fleet, "apply", options) as held:
        plan = options.choose(_plan_with_recheck(held, policy, options))
        return confirm_and_execute(held, plan, confirm, options)


def _plan_with_recheck(fleet: Fleet, policy: Policy, options: ApplyOptions) -> Plan:
    """A plan from a fresh probe; where it moves tasks because of load, from a longer one that is averaged
    into the samples of the last minutes.
    """
    window = options.recheck_window
    probe = dataclasses.replace(options.probe or ProbeOptions(), probe_idle_links=True)
    plan = make_plan(fleet, policy, options=probe, recorded=window is None)
    if window is None:
        return plan
    if any(step.action is Action.MOVE and step.decision.reason in _MOVES_BY_LOAD for step in plan.steps):
        longer = dataclasses.replace(probe, window=window, timeout=probe.timeout + window)
        from edgectl.usecases.recent_loads import smooth_from_history

        loads = smooth_from_history(fleet, probe_fleet(fleet, longer), until=plan.snapshot.taken_at)
        plan = make_plan(fleet, policy, snapshot=loads)
    record_plan(fleet, plan)
    return plan


def check_saved_plan(fleet: Fleet, plan: Plan) -> None:
    """Compare a saved plan with the files; no host is asked.

    Raises:
        StalePlanError: it was made for other files, or does not fit them.
    """
    from edgectl.usecases.saved_plan import list_file_conflicts

    conflicts = list_file_conflicts(plan, fleet.inventory, fleet.tasks)
    if conflicts:
        raise StalePlanError(conflicts)


def apply_saved_plan(fleet: Fleet, plan: Plan, options: ApplyOptions | None = None) -> ApplyResult:
    """Execute a saved plan once, only if nothing changed since it was made, and only steps that edgectl would
    plan now.

    Raises:
        StalePlanError: something changed, a step is unsafe, or the plan was applied before.
        LockBusyError: another edgectl is changing this fleet.
    """
    from edgectl.executor.drift import list_drift
    from edgectl.usecases.saved_plan import list_file_conflicts, list_unsafe_steps

    options = options or ApplyOptions()
    name = compute_plan_id(plan)
    with lock_fleet(fleet, "apply", options) as held:
        with Journal.open(fleet.state, clock=fleet.clock, warn=fleet.warn) as journal:
            if name in journal.log.applied:
                raise StalePlanError(["it was applied before"])
        snapshot = probe_fleet(held, options.probe)
        if plan.policy.terms:
            from edgectl.usecases.ratings import add_ratings

            snapshot = add_ratings(fleet, plan.policy, snapshot)
        changes = (
            *list_file_conflicts(plan, fleet.inventory, fleet.tasks),
            *list_drift(plan, snapshot, snapshot.manager or ManagerState()),
        ) or list_unsafe_steps(plan, fleet.inventory, fleet.tasks, snapshot, get_solver(plan.policy))
        hit_failpoint("staleness checked")
        if changes:
            raise StalePlanError(changes)
        fresh = dataclasses.replace(plan, snapshot=snapshot)
        return dataclasses.replace(
            confirm_and_execute(held, fresh, confirm_always, options, name=name), plan=plan
        )
