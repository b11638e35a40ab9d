# SPDX-License-Identifier: Apache-2.0
"""The scheduler: (Inventory, Tasks, Snapshot, ManagerState, Policy, now) -> Assignment.

Pure; the same inputs give the same bytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Assignment, OperatorPin
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.candidates import AssignmentContext
from edgectl.scheduler.capacities import Capacities, build_capacities, update_samples
from edgectl.scheduler.demand import add_measured_demands
from edgectl.scheduler.demand_spread import find_demand_spreads
from edgectl.scheduler.garbage import pause_collection
from edgectl.scheduler.initial_state import InitialState, build_initial_state
from edgectl.scheduler.move_cost import collect_handoff_history
from edgectl.scheduler.operator_pins import (
    NOTHING_YIELDED,
    Yielded,
    explain_pins,
    find_yielded_hosts,
    pin_tasks,
    resolve_pins,
)
from edgectl.scheduler.pass_state import PlacementPass
from edgectl.scheduler.placement_rules import NO_RULES, build_placement_rules
from edgectl.scheduler.policies import POLICIES
from edgectl.scheduler.preference import sign_weights
from edgectl.scheduler.ratings import collect_ratings
from edgectl.scheduler.reservation import reserve_running_tasks
from edgectl.scheduler.scan import build_demand_shares
from edgectl.scheduler.sequence import order_tasks
from edgectl.scheduler.settle import run_once, run_with_groups
from edgectl.scheduler.shortage import compute_shortages
from edgectl.scheduler.standby_steps import build_standby_steps
from edgectl.scheduler.standbys import place_standbys

if TYPE_CHECKING:
    from edgectl.scheduler.array_scan import ArrayScan
    from edgectl.scheduler.integer_program import Solver

# From so many pairs of an edge and a task on NumPy pays for its import.
MIN_ARRAY_PAIRS = 300_000


def assign(
    inventory: Inventory,
    tasks: Tasks,
    snapshot: Snapshot,
    manager: ManagerState,
    policy: Policy,
    now: float,
    solve: "Solver | None" = None,
    *,
    explain: bool = True,
) -> Assignment:
    """A host, numbers and a reason for each task, in sequence order (Section IV of the paper).

    ``now``: seconds since 1970, on the clock of ``snapshot.taken_at``. ``solve``: look for the best plan with
    it, if the policy settles plans, and certify how good it is (ADR 71). Without ``explain`` the places are
    the same, and the numbers and warnings are left out (ADR 134).

    Raises:
        UsageError: the policy weighs ratings of plugins that the snapshot does not hold.
        ValueError: the tasks' needs form a cycle, or the weights are not usable (validation of the files
            finds both).
    """
    large = len(inventory.edges) * len(tasks.tasks) >= MIN_ARRAY_PAIRS
    with pause_collection(large=large):
        prepared = prepare_plan(inventory, tasks, snapshot, manager, policy, now, explain=explain)
        return decide_plan(prepared, tasks, solve)


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedPlan:
    """All that a plan is decided from.

    ``how``: the pass, and the state before it. ``measured``: that state before the reservations of what runs.
    ``policy``: with normalised weights. ``unpinned``: the sequence without the ``pins`` of operators, and
    without the hosts ``yielded`` to pinned tasks.
    """

    how: PlacementPass
    measured: InitialState
    policy: Policy
    unpinned: Sequence[Task]
    pins: Mapping[str, OperatorPin]
    yielded: Yielded


def prepare_plan(
    inventory: Inventory,
    tasks: Tasks,
    snapshot: Snapshot,
    manager: ManagerState,
    policy: Policy,
    now: float,
    *,
    explain: bool = True,
    former: PreparedPlan | None = None,
) -> PreparedPlan:
    """The first half of `assign`: what the fleet and the tasks are like, before anything is decided.

    ``former``: of the same files and policy, when hosts and links could do what they can now, the same hosts
    were closed, and the manager had measured the same. What these alone decide is taken over (ADR 183): what
    runs, what is in use and what the manager has placed may differ.
    """
    rules = POLICIES[policy.name]
    used = replace(policy, weights=(rules.weights or policy.weights).normalised())
    if former is None:
        fleet = build_capacities(inventory, snapshot, manager, used.without)
        fleet = add_measured_demands(fleet, tasks, manager)
    else:
        fleet = update_samples(former.measured.ledger.fleet, snapshot)
    measured = state = build_initial_state(tasks, manager, fleet, now, used)
    if not rules.strict_paper:
        state = reserve_running_tasks(state, tasks)
        fleet = state.ledger.fleet
    pins = (
        resolve_pins(tasks, manager, fleet, state, now, best_effort=used.best_effort)
        if rules.follows_pins
        else {}
    )
    unpinned = order_tasks(tasks.tasks.values(), used.sequence) if former is None else former.unpinned
    yielded = find_yielded_hosts(unpinned, pins) if pins and rules.settles else NOTHING_YIELDED
    order = pin_tasks(unpinned, pins, yielded)
    context = AssignmentContext(
        arrays=_load_array_scan(fleet, order, used),
        fleet=fleet,
        policy=sign_weights(used) if rules.settles else used,
        rules=rules.candidates,
        shares=build_demand_shares(fleet, None if former is None else former.how.context.shares),
        now=now,
        first=select_first_placements(manager, state),
        handoffs=collect_handoff_history(manager),
        placement_rules=build_placement_rules(order, fleet, state) if rules.settles else NO_RULES,
        ratings=collect_ratings(used, snapshot, fleet),
        turns={} if rules.settles else {task.name: turn for turn, task in enumerate(order)},
        edge_rejections={} if former is None else former.how.context.edge_rejections,
        offers={} if former is None else former.how.context.offers,
    )
    return PreparedPlan(
        how=PlacementPass(context=context, order=order, rules=rules, initial=state, explain=explain),
        measured=measured,
        policy=used,
        unpinned=unpinned,
        pins=pins,
        yielded=yielded,
    )


def decide_plan(prepared: PreparedPlan, tasks: Tasks, solve: "Solver | None" = None) -> Assignment:
    """The second half of `assign`: a host for each task."""
    how, explain = prepared.how, prepared.how.explain
    state, fleet = how.initial, how.context.fleet
    certificate, made = None, how
    if not how.rules.settles:
        outcome, settled = run_once(how, state)
    else:
        known = run_with_groups(how, optimal=solve is not None)
        made, found = known.how, known.found
        if solve is not None:
            from edgectl.scheduler.best_plan import find_best_plan

            found, certificate = find_best_plan(how, known, solve)
        outcome, settled = found.outcome, found.settled
    # A pin is about the task itself: its copies wait wherever its file lets them.
    made = replace(made, order=prepared.unpinned) if prepared.pins else made
    standbys, expected = place_standbys(made, outcome)
    used_places = {place for place, _ in outcome.placed.values()}
    return Assignment(
        policy=prepared.policy,
        decisions=explain_pins(outcome.decisions, prepared.pins, prepared.yielded),
        expected=expected.expected(used_places.union(*(each.places for each in standbys))) if explain else {},
        standbys=build_standby_steps(made, standbys, expected) if standbys or state.standbys else {},
        settled=settled,
        frozen=state.frozen,
        unseen=state.unseen,
        demand_spreads=find_demand_spreads(fleet, tasks) if explain else (),
        shortages=compute_shortages(state, tasks) if explain else (),
        certificate=certificate,
    )


def _load_array_scan(fleet: Capacities, order: Sequence[Task], policy: Policy) -> "ArrayScan | None":
    """The scan in NumPy where that pays, and where NumPy is installed (extra ``scale``)."""
    if fleet.edges * len(order) < MIN_ARRAY_PAIRS:
        return None
    try:
        from edgectl.scheduler.array_scan import build_array_scan
    except ImportError:
        return None
    return build_array_scan(fleet, policy.weights, (task.name for task in order))


def select_first_placements(manager: ManagerState, state: InitialState) -> dict[str, str]:
    """First placements, without those of tasks that leave theirs because it is silent (ADR 0023)."""
    return {task: host for task, host in manager.first.items() if task not in state.replaced}
