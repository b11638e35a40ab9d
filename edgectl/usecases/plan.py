"""plan: what should be done, and why."""

import hashlib
from collections.abc import Collection

from edgectl.executor.diff import plan_of, select
from edgectl.executor.dryrun import dry_run
from edgectl.formats import plan as form
from edgectl.formats.base import dumps
from edgectl.gateway.collect import ProbeOptions
from edgectl.model.memory import Memory
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.scheduler.assign import assign
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.probe import probe
from edgectl.usecases.record import record_plan


def plan(fleet: Fleet, policy: Policy, *, snapshot: Snapshot | None = None, options: ProbeOptions | None = None) -> Plan:
    """Decide for every task, from a fresh probe or from ``snapshot``.

    With a given snapshot no host is asked, ``now`` is its ``taken_at`` and the memory is the one in it: the same on any day.
    """
    if snapshot is None:
        made = plan(fleet, policy, snapshot=probe(fleet, options))
        record_plan(fleet, made)
        return made
    memory = snapshot.memory or Memory()
    assignment = assign(fleet.inventory, fleet.tasks, snapshot, memory, policy, snapshot.taken_at)
    return plan_of(fleet.inventory, fleet.tasks, snapshot, memory, assignment)


def whole(plan: Plan) -> Plan:
    """Choose all of a plan."""
    return plan


def targeted(plan: Plan, tasks: Collection[str]) -> Plan:
    """The plan with action on ``tasks`` alone; everything was decided for all of them."""
    return select(plan, tasks)


def plan_id(plan: Plan) -> str:
    """The digest of a plan's text: the name under which it is applied at most once."""
    return hashlib.sha256(dumps(form.encode(plan)).encode()).hexdigest()


def commands(fleet: Fleet, plan: Plan) -> list[dict[str, object]]:
    """The exact remote commands of ``apply --dry-run``."""
    return dry_run(plan, fleet.inventory, fleet.tasks)
