# SPDX-License-Identifier: Apache-2.0
"""Plan: ranking of hosts and changes, with reasons."""

import dataclasses
import hashlib
from collections.abc import Collection
from typing import TYPE_CHECKING

from edgectl.errors import UsageError
from edgectl.executor.diff import plan_from_assignment, select_targets
from edgectl.formats.document import dump_line
from edgectl.formats.kinds import PLAN_KIND
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.assignment import Shortage
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.resource import LATENCY, RATING
from edgectl.model.snapshot import Snapshot
from edgectl.rules.lost_places import find_shared_machine
from edgectl.scheduler.assign import assign
from edgectl.scheduler.claims import describe_claims
from edgectl.scheduler.shortage import find_shortages
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.record import record_plan

if TYPE_CHECKING:
    from edgectl.scheduler.integer_program import Solver


def make_plan(
    fleet: Fleet,
    policy: Policy,
    *,
    snapshot: Snapshot | None = None,
    options: ProbeOptions | None = None,
    recorded: bool = True,
) -> Plan:
    """Decide for every task, from a fresh probe or from ``snapshot``.

    With a given snapshot no host is asked, ``now`` is its ``taken_at`` and the manager's state is the one in
    it: the result is the same on any day. ``recorded``: the plan of a probe becomes part of the history.

    Raises:
        UsageError: two hosts of the inventory are one machine, or a term of the policy is in no plugin.
        PluginError: a term failed.
    """
    if snapshot is None:
        probed = probe_fleet(fleet, options)
        made = make_plan(fleet, policy, snapshot=probed)
        for line in describe_claims(fleet.inventory, fleet.tasks, probed, probed.manager or ManagerState()):
            fleet.warn(line)
        if recorded:
            record_plan(fleet, made)
        return made
    shared = find_shared_machine(fleet.inventory, snapshot)
    if shared is not None:
        raise UsageError(
            f"{shared[0]} and {shared[1]} are one machine: its load and its tasks would count twice",
            hint="remove one, or declare both as slices with capacity: {cpu: .., memory: ..}",
        )
    if policy.terms:
        from edgectl.usecases.ratings import add_ratings

        snapshot = add_ratings(fleet, policy, snapshot)
    manager = snapshot.manager or ManagerState()
    solve = get_solver(policy)
    assignment = assign(fleet.inventory, fleet.tasks, snapshot, manager, policy, snapshot.taken_at, solve)
    return plan_from_assignment(fleet.inventory, fleet.tasks, snapshot, manager, assignment)


def get_solver(policy: Policy) -> "Solver | None":
    """The solver for a plan under ``policy``, which has its deadline from now; None: it needs none."""
    if not policy.optimal:
        return None
    from edgectl.solver.highs import make_solver

    return make_solver()


def check_search(policy: Policy) -> None:
    """Check that the search which ``policy`` asks for can weigh what the policy weighs.

    Raises:
        UsageError: it cannot.
    """
    if (policy.optimal or policy.rebalance) and policy.weights[LATENCY]:
        option = "--optimal" if policy.optimal else "--rebalance"
        hint = "omit it, or weigh no latency; hard deadlines are kept"
        raise UsageError(f"{option} cannot weigh latency, which is not linear in loads", hint=hint)
    if (policy.optimal or policy.rebalance) and policy.weights[RATING]:
        option = "--optimal" if policy.optimal else "--rebalance"
        raise UsageError(f"{option} cannot weigh the ratings of plugins", hint="omit it, or weigh no rating")
    if policy.optimal and policy.rebalance:
        raise UsageError("--optimal finds the best plan without --rebalance", hint="pass one of the two")
    if policy.optimal and policy.name is not PolicyName.UTILITY:
        raise UsageError(f"--optimal is for policy utility, not {policy.name}", hint="omit one of the two")


def is_what_if(fleet: Fleet, policy: Policy) -> bool:
    """Whether a plan under ``policy`` answers a question (``--without``, ``--weights``, ..) and does not show
    what an apply of the files would do. Such a plan is no part of the history.
    """
    stated = fleet.tasks.policy
    return policy != dataclasses.replace(stated, attended=policy.attended, full=policy.full)


def find_fleet_shortages(fleet: Fleet, snapshot: Snapshot) -> tuple[Shortage, ...]:
    """What the edges lack for the tasks of the files, whatever the placement."""
    return find_shortages(fleet.inventory, fleet.tasks, snapshot)


def keep_whole_plan(plan: Plan) -> Plan:
    """Keep every step of the plan."""
    return plan


def limit_plan_to_tasks(plan: Plan, tasks: Collection[str]) -> Plan:
    """The plan with actions for ``tasks`` only; the decisions cover all tasks."""
    return select_targets(plan, tasks)


def compute_plan_id(plan: Plan) -> str:
    """The digest of a plan, under which it is applied at most once."""
    return hashlib.sha256(dump_line(PLAN_KIND.encode(plan)).encode()).hexdigest()


def list_remote_commands(fleet: Fleet, plan: Plan) -> list[dict[str, object]]:
    """The exact remote commands of ``apply --dry-run``."""
    from edgectl.executor.dry_run import list_dry_run_requests

    return list_dry_run_requests(plan, fleet.inventory, fleet.tasks)
