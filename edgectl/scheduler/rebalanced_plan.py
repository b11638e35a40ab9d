# SPDX-License-Identifier: Apache-2.0
"""The sum of utilities of a decided plan, and a plan in which it is higher (ADR 66)."""

from dataclasses import replace

from edgectl.model.assignment import Reason
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.decided_plan import DecidedPlan, build_choices
from edgectl.scheduler.packed_plan import PlanFrame, build_packing, build_plan_frame
from edgectl.scheduler.rebalance import rebalance_packing
from edgectl.scheduler.utility_sum import Objective


def rate_plan(plan: DecidedPlan) -> float:
    """The sum of the utilities of all placed tasks at the loads after the plan."""
    frame = build_plan_frame(plan, {})
    packing = build_packing(frame)
    return _build_objective(frame).rate(packing, packing.at)


def _build_objective(frame: PlanFrame) -> Objective:
    plan, columns = frame.plan, frame.links
    placed = [task for task in plan.order if task.name in plan.placed]
    successors: dict[str, list[str]] = {task.name: [] for task in placed}
    for task in placed:
        for need in task.needs:
            successors.setdefault(need.task, []).append(task.name)
    return Objective(
        weights=plan.context.policy.weights,
        edges=plan.context.fleet.edges,
        links={task.name: [columns[robot] for robot in task.robots if robot in columns] for task in placed},
        needs={task.name: [need.task for need in task.needs] for task in placed},
        successors=successors,
        elsewhere=plan.initial.located,
    )


def rebalance_plan(plan: DecidedPlan, *, started_only: bool = False) -> dict[str, Choice]:
    """The choices with which the sum of all utilities is higher (ADR 66), where they differ from those of
    ``plan``.

    ``started_only``: no running task moves.
    """
    frame = build_plan_frame(plan, {})
    packing = build_packing(frame)
    if started_only:
        for name in packing.items.keys() & plan.initial.running.keys():
            packing.items[name] = packing.items[name]._replace(movable=False)
    rebalance_packing(packing, _build_objective(frame), plan.context.policy.move_margin)
    return {
        name: replace(choice, reason=Reason.REBALANCED, subject=None)
        for name, choice in build_choices(plan, packing, {}).items()
    }
