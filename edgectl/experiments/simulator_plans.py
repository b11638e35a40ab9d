# SPDX-License-Identifier: Apache-2.0
"""Simulated cycles of the manager: a probe, and a plan of the real scheduler and the real diff."""

from collections.abc import Hashable, Mapping, Sequence

from edgectl.executor.dependencies import build_step_dependencies, order_by_dependencies
from edgectl.executor.diff import diff_assignment
from edgectl.experiments.simulator_memory import KnownCycle, SimMemory
from edgectl.experiments.simulator_oracle import assign_by_oracle
from edgectl.experiments.simulator_probe import do_links_change, pass_probe, read_cpu, simulate_probe
from edgectl.experiments.simulator_state import SimState
from edgectl.model.assignment import Assignment, Reason
from edgectl.model.plan import Step
from edgectl.model.resource import CPU
from edgectl.model.task import Tasks
from edgectl.rules.measured_demand import WARM_UP_S
from edgectl.scheduler.assign import PreparedPlan, assign, decide_plan, prepare_plan
from edgectl.scheduler.known_plan import read_again, remember_plan, stays_within
from edgectl.scheduler.stay_limits import find_stay_limits, keep_running_tasks

# Of decisions for which it does not matter how much anything uses.
_REASONS_WITHOUT_READINGS = (
    Reason.NEVER_MOVED,
    Reason.ONBOARD_LOCAL,
    Reason.DONE,
    Reason.UNMANAGED,
    Reason.PREDECESSOR_INCOMPLETE,
    Reason.PREDECESSOR_MISSING,
)


def plan_cycle(state: SimState) -> tuple[Step, ...]:
    """Probe and plan. A plan for which no reading counts stands until something else changes (ADR 137)."""
    if state.standing is not None:
        pass_probe(state)
        return state.standing
    if state.memory is None or state.oracle or do_links_change(state):
        plan = _plan_anew(state)
    else:
        plan = _plan_from_memory(state, state.memory)
    state.standing = plan if not state.oracle and not _may_change(plan) else None
    return plan


def order_steps(tasks: Tasks, steps: Sequence[Step]) -> list[tuple[Step, list[str]]]:
    """The steps in an order of the executor, each with the tasks whose steps end before it."""
    waits = build_step_dependencies(tuple(steps), tasks)
    after = {step.task: waits[step.task].tasks if step.task in waits else frozenset[str]() for step in steps}
    by_name = {step.task: step for step in steps}
    return [(by_name[name], sorted(after[name])) for name in order_by_dependencies(after)]


def _may_change(plan: Sequence[Step]) -> bool:
    """Whether the next plan may be another one although only readings and the time are others."""
    return any(step.action.changes for step in plan) or _weighs_readings(plan)


def _weighs_readings(plan: Sequence[Step]) -> bool:
    """Whether another plan of the same state may differ, by readings and the time alone."""
    return any(step.decision.reason not in _REASONS_WITHOUT_READINGS for step in plan)


def _plan_anew(state: SimState) -> tuple[Step, ...]:
    snapshot = simulate_probe(state)
    assignment = assign(
        state.inventory, state.tasks, snapshot, state.manager, state.policy, state.env.now, explain=False
    )
    if state.oracle:
        assignment = assign_by_oracle(state, assignment)
    return diff_assignment(assignment, state.tasks, snapshot, state.manager)


def _plan_from_memory(state: SimState, memory: SimMemory) -> tuple[Step, ...]:
    """The plan of a state in which only readings and times can be others than when it was first seen."""
    key = _describe_cycle(state)
    known = memory.cycles.get(key)
    if known is not None:
        return _plan_again(state, known)
    snapshot = simulate_probe(state)
    prepared = prepare_plan(
        state.inventory,
        state.tasks,
        snapshot,
        state.manager,
        state.policy,
        state.env.now,
        explain=False,
        former=memory.first_plan,
    )
    memory.first_plan = memory.first_plan or prepared
    plan = remember_plan(prepared)
    if plan is None:
        return diff_assignment(decide_plan(prepared, state.tasks), state.tasks, snapshot, state.manager)
    known = KnownCycle(plan=plan, snapshot=snapshot, limits=find_stay_limits(prepared))
    memory.add_cycle(key, known)
    cpu = {host: sample.usage[CPU.name].used for host, sample in snapshot.hosts.items()}
    return _keep_running_tasks(state, known, cpu) or _decide(state, known, prepared)


def _plan_again(state: SimState, known: KnownCycle) -> tuple[Step, ...]:
    if known.standing is not None:
        pass_probe(state)
        return known.standing
    cpu = read_cpu(state)
    kept = _keep_running_tasks(state, known, cpu)
    if kept is not None:
        return kept
    started = {name: service.since for name, service in state.services.items()}
    return _decide(
        state, known, read_again(known.plan, cpu, started, state.manager, state.policy, state.env.now)
    )


def _keep_running_tasks(
    state: SimState, known: KnownCycle, cpu: Mapping[str, float]
) -> tuple[Step, ...] | None:
    """The plan where these readings let no task leave its host; None where they may (ADR 123)."""
    if known.limits is None or not stays_within(known.plan, known.limits, cpu, state.manager):
        return None
    if known.kept is None:
        assignment = keep_running_tasks(known.plan.prepared)
        known.kept = diff_assignment(assignment, state.tasks, known.snapshot, state.manager)
        known.standing = None if _weighs_readings(known.kept) else known.kept
    return known.kept


def _decide(state: SimState, known: KnownCycle, prepared: PreparedPlan) -> tuple[Step, ...]:
    assignment = decide_plan(prepared, state.tasks)
    decided = _describe_decisions(assignment)
    steps = known.steps.get(decided)
    if steps is None:
        steps = diff_assignment(assignment, state.tasks, known.snapshot, state.manager)
        known.steps[decided] = steps
        if not _weighs_readings(steps):
            known.standing = steps
    return steps


def _describe_cycle(state: SimState) -> Hashable:
    """Equal where probe and record of the manager are, but for readings of CPU and times."""
    now, manager, services = state.env.now, state.manager, state.services
    return (
        state.shared,
        tuple([state.left.get(name) == 0 for name in services]),
        tuple([now - service.since >= WARM_UP_S for service in services.values()]),
        frozenset([(name, there.host) for name, there in manager.placements.items()]),
        frozenset(manager.done),
    )


def _describe_decisions(assignment: Assignment) -> Hashable:
    """All that is said of each task without explanations."""
    return tuple(
        [
            (each.verdict, each.reason, each.host, each.previous_host, each.subject)
            for each in assignment.decisions
        ]
    )
