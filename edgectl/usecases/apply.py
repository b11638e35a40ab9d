"""apply: make reality match, one edgectl at a time, with a record of every step."""

import dataclasses

from edgectl.errors import StalePlanError
from edgectl.executor.stale import moved
from edgectl.model.memory import Memory
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy
from edgectl.state.journal import Journal
from edgectl.state.points import reached
from edgectl.usecases.change import Applied, ApplyOptions, Confirm, agreed, carry_out, changing
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import plan as make_plan
from edgectl.usecases.plan import plan_id
from edgectl.usecases.probe import probe

__all__ = ["Applied", "ApplyOptions", "Confirm", "apply", "apply_saved"]


def apply(fleet: Fleet, policy: Policy, confirm: Confirm = agreed, options: ApplyOptions | None = None) -> Applied:
    """Probe, plan, ask ``confirm``, carry out, remember.

    Raises:
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with changing(fleet, "apply", options) as held:
        plan = options.choose(make_plan(held, policy, options=options.probe))
        return carry_out(held, plan, confirm, options)


def apply_saved(fleet: Fleet, plan: Plan, options: ApplyOptions | None = None) -> Applied:
    """Carry out a saved plan, once, and only if nothing moved since it was made.

    Raises:
        StalePlanError: something moved, or the plan was applied before.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    name = plan_id(plan)
    with changing(fleet, "apply", options) as held:
        with Journal.open(fleet.state, clock=fleet.clock, warn=fleet.warn) as journal:
            if name in journal.log.applied:
                raise StalePlanError(["it was applied before"])
        snapshot = probe(held, options.probe)
        changes = moved(plan, fleet.inventory, fleet.tasks, snapshot, snapshot.memory or Memory())
        reached("staleness checked")
        if changes:
            raise StalePlanError(changes)
        fresh = dataclasses.replace(plan, snapshot=snapshot)
        return dataclasses.replace(carry_out(held, fresh, agreed, options, name=name), plan=plan)
