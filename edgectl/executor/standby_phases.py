# SPDX-License-Identifier: Apache-2.0
"""The phases of inactive copies: start one, make an instance active or inactive. Pure."""

from edgectl.agent.link import protocol
from edgectl.executor import host_requests
from edgectl.executor.action_phases import (
    DEFAULT_READY_S,
    PlannedPhase,
    PlannedPhases,
    PlannedRequest,
    build_stop_phase,
    build_wait,
    get_copy_up_time,
    get_host,
    get_start_time,
)
from edgectl.executor.image_phases import build_pull_phases
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import Phase
from edgectl.model.snapshot import HostSample, TaskSample
from edgectl.model.standby import Activation
from edgectl.model.standby_plan import StandbyAction, StandbyStep
from edgectl.model.task import Task, Tasks

# How long a transition of a lifecycle may take: `on_configure` of a large node loads its model.
LIFECYCLE_S = 30.0
# How long an activation that is prepared waits for the word, besides the deactivation that comes before it.
_AWAIT_S = 15.0


def find_standby(plan: Plan, task: str, host: str) -> TaskSample | None:
    """The inactive copy of a task that the snapshot shows alive on ``host``."""
    sample = plan.snapshot.hosts.get(host)
    copy = sample.standbys.get(task) if sample is not None and sample.ok else None
    return copy if copy is not None and copy.managed and copy.state.alive else None


def find_usable_standby(plan: Plan, task: Task, host: str) -> TaskSample | None:
    """The copy on ``host``, if it was started from the present spec and has its supervisor."""
    copy = find_standby(plan, task.name, host)
    usable = copy is not None and copy.spec_hash == task.spec_hash and not copy.orphaned
    return copy if usable else None


def find_heir_source(plan: Plan, step: Step, task: Task) -> tuple[str, TaskSample] | None:
    """The copy that has the state of a task that is active nowhere and starts on another host: the one that
    was active last, where a move was interrupted. None for a task without state.
    """
    if task.state is None or step.action is not Action.START or step.decision.previous_host is not None:
        return None
    copies = ((host, find_usable_standby(plan, task, host)) for host in plan.snapshot.hosts)
    found = [(host, copy) for host, copy in copies if copy is not None and copy.deactivated]
    source = max(found, key=lambda each: each[1].deactivated, default=None)
    return source if source is not None and source[0] != step.decision.host else None


def is_warm_move(step: Step, task: Task, plan: Plan) -> bool:
    """Whether the task moves by activation: it can be made inactive where it runs, as the present spec says.

    An instance that was started from another spec may not know how.
    """
    old, new = step.decision.previous_host or "", step.decision.host or ""
    sample = _get_sample(plan.snapshot.hosts.get(old), step.task)
    return (
        step.action is Action.MOVE
        and task.activation is not None
        and old != new
        and sample is not None
        and sample.state.alive
        and not sample.orphaned
        and sample.spec_hash == task.spec_hash
        and step.instances.get(old) == sample.instance
    )


def _get_sample(host: HostSample | None, task: str) -> TaskSample | None:
    return host.tasks.get(task) if host is not None else None


def build_copy_stop_phases(
    name: str, task: Task | None, host: str, plan: Plan, inventory: Inventory
) -> PlannedPhases:
    """Stop the copy that the snapshot shows on ``host``, where there is one."""
    copy = find_standby(plan, name, host)
    if copy is None:
        return ()
    return (build_stop_phase(name, task, host, inventory, instance=copy.instance),)


def build_standby_phase(task: Task, host_name: str, inventory: Inventory) -> PlannedPhase:
    """Start an inactive copy on a host and wait until it can be activated."""
    host = get_host(inventory, host_name)
    body = host_requests.build_start_request(task, host, inventory.hosts, role=protocol.ROLE_STANDBY)
    timeout_s, up_s = _get_copy_timeout(task), get_copy_up_time(task)
    wait = build_wait(task, host, host_requests.NO_INSTANCE, timeout_s, up_s=up_s)
    return PlannedPhase(
        phase=Phase.STANDBY,
        task=task.name,
        requests=(PlannedRequest(host=host, body=body, timeout_s=get_start_time(task)), wait),
        timeout_s=timeout_s,
    )


def _get_copy_timeout(task: Task) -> float:
    """How long (s) to wait until a new copy can be activated."""
    rule = task.activation
    if rule is not None and rule.ready is not None:
        return rule.ready.timeout
    if rule is not None and rule.lifecycle is not None:
        return LIFECYCLE_S
    return DEFAULT_READY_S + get_copy_up_time(task)


def build_copy_phases(step: Step, copy: StandbyStep, inventory: Inventory, tasks: Tasks) -> PlannedPhases:
    """What a plan does with one inactive copy by itself: stop it, start it, or start it anew.

    Raises:
        HostError: its host left the inventory.
    """
    task, host = tasks.tasks.get(step.task), copy.host or ""
    phases: PlannedPhases = ()
    starts = copy.action in (StandbyAction.START, StandbyAction.RESTART)
    if starts and task is not None:
        phases += build_pull_phases(task, host, inventory)
    if copy.action in (StandbyAction.STOP, StandbyAction.RESTART):
        phases += (build_stop_phase(step.task, task, host, inventory, instance=copy.instance or None),)
    if starts and task is not None:
        phases += (build_standby_phase(task, host, inventory),)
    return phases


def build_switch_phase(
    phase: Phase, task: Task, host_name: str, inventory: Inventory, *, instance: str
) -> PlannedPhase:
    """Make ``instance`` active, or inactive (``phase`` DEACTIVATE), and have it proven."""
    host, rule = get_host(inventory, host_name), task.activation or Activation()
    build = (
        host_requests.build_deactivate_request
        if phase is Phase.DEACTIVATE
        else host_requests.build_activate_request
    )
    body = build(task, host, inventory.hosts, instance=instance)
    timeout_s = host_requests.compute_switch_timeout_s(rule)
    request = PlannedRequest(host=host, body=body, timeout_s=timeout_s)
    return PlannedPhase(phase=phase, task=task.name, requests=(request,))


def get_await_time(before: PlannedPhase) -> float:
    """How long (s) a prepared activation waits for the word while ``before`` is performed."""
    return before.requests[0].timeout_s + _AWAIT_S
