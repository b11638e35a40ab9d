# SPDX-License-Identifier: Apache-2.0
"""The phases of a start, move or restart in order, by activation where an inactive copy waits. Pure."""

from collections.abc import Iterable

from edgectl.dataclass import dataclass
from edgectl.executor import host_requests
from edgectl.executor.action_phases import (
    PlannedPhases,
    build_hook_phases,
    build_leaving_phases,
    build_need_phases,
    build_reach_phase,
    build_ready_phase,
    build_run_phases,
    build_safe_phases,
    build_stop_phase,
    get_host,
)
from edgectl.executor.dependencies import find_replacement_hold, is_replacement
from edgectl.executor.image_phases import build_pull_phases
from edgectl.executor.standby_phases import (
    build_copy_stop_phases,
    build_standby_phase,
    build_switch_phase,
    find_heir_source,
    find_usable_standby,
    is_warm_move,
)
from edgectl.executor.state_phases import (
    build_carried_run_phases,
    build_carry_phases,
    build_load_phases,
    keep_state,
)
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import Phase
from edgectl.model.snapshot import TaskSample
from edgectl.model.standby import SaveMoment
from edgectl.model.standby_plan import StandbyAction
from edgectl.model.task import HandoffOrder, Need, Task, Tasks


@dataclass(frozen=True, slots=True, kw_only=True)
class StartPhases:
    """The phases of a start, move or restart.

    ``needs``: waits for predecessors. ``prepare``: is the host there, is it safe; nothing is touched yet.
    ``hold`` and ``release``: hooks of the handoff. ``carry``: its state is brought to the new host while the
    old instance runs; ``carry_inactive``: of a warm move, while no instance is active.
    ``change``: stop, start and ready in the order of the handoff; of a warm move: deactivate, activate and
    ready. ``retire``: what is stopped once the new instance is ready and the robot released.
    """

    needs: PlannedPhases
    prepare: PlannedPhases
    hold: PlannedPhases = ()
    carry: PlannedPhases = ()
    change: PlannedPhases
    carry_inactive: PlannedPhases = ()
    release: PlannedPhases = ()
    retire: PlannedPhases = ()

    @property
    def in_order(self) -> PlannedPhases:
        """All phases as they are performed where none fails."""
        first, *others = self.change
        change = (first, *self.carry_inactive, *others)
        return (
            *(*self.needs, *self.prepare, *self.hold, *self.carry),
            *(*change, *self.release, *self.retire),
        )


def build_start_phases(
    step: Step, task: Task, needs: Iterable[Need], plan: Plan, inventory: Inventory, tasks: Tasks
) -> StartPhases:
    """The phases of a starting step (one with a host) of ``plan``; ``needs``: the predecessors to wait for.

    Raises:
        HostError: a predecessor does not run, or a host left the inventory or is never contacted.
    """
    new, old = step.decision.host or "", step.decision.previous_host
    waits = build_need_phases(needs, plan, inventory, tasks)
    if is_warm_move(step, task, plan):
        return _build_warm_move_phases(step, task, waits, plan, inventory)
    copy = find_usable_standby(plan, task, new)
    # A copy of another spec makes way: a host has one instance of a task.
    unusable = () if copy is not None else build_copy_stop_phases(task.name, task, new, plan, inventory)
    prepare = (
        build_reach_phase(task.name, new, inventory),
        *(build_pull_phases(task, new, inventory) if copy is None else ()),
    )
    start_first = _is_start_first(step, task)
    replaces = _list_node_addresses(plan, old or "", task.name) if start_first else None
    start = _build_appear_phases(task, new, copy, inventory, replaces=replaces)
    if step.action is Action.START and not is_replacement(step):
        carry = _build_inheritance(step, task, copy, plan, inventory)
        if carry and copy is None:
            start = build_carried_run_phases(task, new, inventory)
        return StartPhases(needs=waits, prepare=(*prepare, *unusable), carry=carry, change=start)
    release = build_hook_phases(Phase.RELEASE, task, task.handoff.release, new, inventory)
    if is_replacement(step):
        hold = build_hook_phases(Phase.HOLD, task, find_replacement_hold(task), new, inventory)
        return StartPhases(
            needs=waits, prepare=(*prepare, *unusable), hold=hold, change=start, release=release
        )
    old = old or new
    stop = build_stop_phase(task.name, task, old, inventory, instance=step.instances.get(old))
    carry = build_carry_phases(task, old, new, inventory, instance=step.instances.get(old))
    if old == new:
        carry = ()  # what is restarted in place begins anew
    elif copy is not None:
        carry += build_load_phases(task, new, inventory, repeat=False, instance=copy.instance)
    elif carry:
        start, stop = build_carried_run_phases(task, new, inventory, replaces=replaces), keep_state(stop)
    leave = build_leaving_phases(task, old, step, inventory) if start_first else ()
    return StartPhases(
        needs=waits,
        prepare=(*prepare, *build_safe_phases(task, old, inventory), *unusable, *leave),
        hold=build_hook_phases(Phase.HOLD, task, task.handoff.hold, old, inventory),
        carry=carry,
        change=(*start, stop) if start_first else (stop, *start),
        release=release,
    )


def _build_inheritance(
    step: Step, task: Task, copy: TaskSample | None, plan: Plan, inventory: Inventory
) -> PlannedPhases:
    """Bring the state of an interrupted move to the host where the task starts, and into the copy there."""
    source, new = find_heir_source(plan, step, task), step.decision.host or ""
    if source is None:
        return ()
    host, left = source
    carry = build_carry_phases(task, host, new, inventory, instance=left.instance)
    if copy is None:
        return carry
    return (*carry, *build_load_phases(task, new, inventory, repeat=False, instance=copy.instance))


def _is_start_first(step: Step, task: Task) -> bool:
    """Whether the old instance of the step runs until the new one is ready.

    At most one instance of a task with copies is ever active, whatever its order.
    """
    if task.activation is not None or step.action is Action.START or is_replacement(step):
        return False
    elsewhere = step.decision.previous_host not in (None, step.decision.host)
    return elsewhere and task.handoff.order is HandoffOrder.START_FIRST


def _list_node_addresses(plan: Plan, host: str, task: str) -> tuple[str, ...]:
    """List the addresses of the nodes of the instance on ``host``, as far as a ROS 1 master had them."""
    sample = plan.snapshot.hosts.get(host)
    run = sample.tasks.get(task) if sample is not None else None
    return tuple(sorted(set(run.nodes.values()))) if run is not None else ()


def _build_appear_phases(
    task: Task,
    host: str,
    copy: TaskSample | None,
    inventory: Inventory,
    *,
    replaces: tuple[str, ...] | None,
) -> PlannedPhases:
    """Start the task where it is decided to run, or activate the copy that waits there."""
    if copy is None:
        return build_run_phases(task, host, inventory, replaces=replaces)
    return (
        build_switch_phase(Phase.ACTIVATE, task, host, inventory, instance=copy.instance),
        build_ready_phase(task, get_host(inventory, host), inventory),
    )


def _build_warm_move_phases(
    step: Step, task: Task, needs: PlannedPhases, plan: Plan, inventory: Inventory
) -> StartPhases:
    """A copy is there before anything is touched; it becomes active once the old instance is inactive.

    Raises:
        HostError: a host left the inventory or is never contacted.
    """
    new, old = step.decision.host or "", step.decision.previous_host or ""
    copy = find_usable_standby(plan, task, new)
    instance = copy.instance if copy is not None else host_requests.NO_INSTANCE
    carry = (
        *build_carry_phases(task, old, new, inventory, instance=step.instances[old]),
        *build_load_phases(task, new, inventory, repeat=False, instance=instance),
    )
    early = task.state is not None and task.state.moment is SaveMoment.ACTIVE
    stays = any(each.host == old and each.action is StandbyAction.DEACTIVATE for each in step.standbys)
    stop = build_stop_phase(task.name, task, old, inventory, instance=step.instances[old])
    return StartPhases(
        needs=needs,
        prepare=(
            build_reach_phase(task.name, new, inventory),
            *(_build_copy_phases(task, new, plan, inventory) if copy is None else ()),
            *build_safe_phases(task, old, inventory),
        ),
        hold=build_hook_phases(Phase.HOLD, task, task.handoff.hold, old, inventory),
        carry=carry if early else (),
        carry_inactive=() if early else carry,
        change=(
            build_switch_phase(Phase.DEACTIVATE, task, old, inventory, instance=step.instances[old]),
            build_switch_phase(Phase.ACTIVATE, task, new, inventory, instance=instance),
            build_ready_phase(task, get_host(inventory, new), inventory),
        ),
        release=build_hook_phases(Phase.RELEASE, task, task.handoff.release, new, inventory),
        retire=() if stays else (stop,),
    )


def _build_copy_phases(task: Task, host: str, plan: Plan, inventory: Inventory) -> PlannedPhases:
    """Have a new copy on the host; one of another spec makes way."""
    stop = build_copy_stop_phases(task.name, task, host, plan, inventory)
    pull = build_pull_phases(task, host, inventory)
    return (*pull, *stop, build_standby_phase(task, host, inventory))
