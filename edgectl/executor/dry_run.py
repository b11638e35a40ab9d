# SPDX-License-Identifier: Apache-2.0
"""The requests of a plan in the order of ``apply --max-parallel 1``."""

import sys

from edgectl.errors import HostError
from edgectl.executor.action_phases import (
    PlannedPhases,
    PlannedRequest,
    build_adopt_phases,
    build_stop_phases,
)
from edgectl.executor.dependencies import (
    STARTING_ACTIONS,
    StepDependencies,
    build_step_dependencies,
    order_by_dependencies,
)
from edgectl.executor.start_phases import build_start_phases
from edgectl.model.inventory import Connection, Inventory
from edgectl.model.plan import Plan, Step
from edgectl.model.result import Phase
from edgectl.model.task import Tasks
from edgectl.transport.agent_client import build_agent_command


def list_dry_run_requests(plan: Plan, inventory: Inventory, tasks: Tasks) -> list[dict[str, object]]:
    """One entry per request: task, phase, host, the remote command line and its standard input.

    Requests that are repeated (waits, checks) stand once. An action that apply would not begin has none.
    Instance ids and generations are made when a plan is applied; here they stand as 0.
    """
    return [
        _encode_request(step.task, planned.phase, request)
        for step, phases in _list_step_phases(plan, inventory, tasks)
        for planned in phases
        for request in planned.requests
    ]


def _list_step_phases(plan: Plan, inventory: Inventory, tasks: Tasks) -> list[tuple[Step, PlannedPhases]]:
    """First everything that stops, then everything that starts, each after those it waits for."""
    steps = {step.task: step for step in plan.steps}
    waits = build_step_dependencies(plan.steps, tasks)
    order = order_by_dependencies({name: wait.tasks for name, wait in waits.items()})
    stops = [(step, _build_stops(step, inventory, tasks)) for step in plan.steps]
    starts = [
        (steps[name], _build_starts(steps[name], waits[name], plan, inventory, tasks)) for name in order
    ]
    return stops + starts


def _build_stops(step: Step, inventory: Inventory, tasks: Tasks) -> PlannedPhases:
    try:
        return (
            *build_stop_phases(step, inventory, tasks),
            *build_adopt_phases(step, inventory, tasks),
        )
    except HostError:
        return ()


def _build_starts(
    step: Step, waits: StepDependencies, plan: Plan, inventory: Inventory, tasks: Tasks
) -> PlannedPhases:
    task = tasks.tasks.get(step.task)
    if step.action not in STARTING_ACTIONS or task is None or step.decision.host is None:
        return ()
    try:
        needs = (*waits.needs, *waits.others)
        return build_start_phases(step, task, needs, plan, inventory, tasks).in_order
    except HostError:
        return ()


def _encode_request(task: str, phase: Phase, request: PlannedRequest) -> dict[str, object]:
    python = sys.executable if request.host.connection is Connection.LOCAL else "python3"
    return {
        "task": task,
        "phase": phase.value,
        "host": request.host.name,
        "command": build_agent_command(python),
        "stdin": request.body,
    }
