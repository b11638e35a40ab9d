# SPDX-License-Identifier: Apache-2.0
"""A warm move: the copy on the new host becomes active once the old instance is proven inactive.

Both hosts are prepared before the old instance is touched, so that the gap is the two commands and the way
there and back. Failed at any step, the old instance is active again, unless the new one may be active.
"""

import contextlib
import time
from collections.abc import Callable, Mapping

from edgectl.dataclass import dataclass
from edgectl.errors import HostError, RefusedError
from edgectl.executor import host_requests
from edgectl.executor.action_phases import (
    PlannedPhase,
    PlannedPhases,
    build_ready_phase,
    build_run_phases,
    build_stop_phase,
    get_host,
)
from edgectl.executor.handoff_error import HandoffError
from edgectl.executor.phases import perform_phase, perform_phases, resolve_variables
from edgectl.executor.standby_phases import build_switch_phase, get_await_time
from edgectl.executor.start_phases import StartPhases
from edgectl.executor.step_run import StepRun
from edgectl.executor.switch import SwitchError, name_instance, prepare_switch
from edgectl.model.result import Phase
from edgectl.model.task import Task

# Beyond the timeouts of its commands, for each phase in which a state is carried.
_TRANSFER_S = 40.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Swap:
    """One swap under way. ``variables``: the environment of the task on the old host."""

    act: StepRun
    task: Task
    old: str
    new: str
    instance: str
    variables: Mapping[str, str]
    began: float


def swap_active_instance(
    act: StepRun, task: Task, planned: StartPhases, old: str, new: str, variables: Mapping[str, str]
) -> float:
    """Deactivate on ``old``, activate on ``new``, wait until ready; seconds during which none was active.

    Raises:
        HandoffError: it says what is active now.
    """
    deactivate, activate, ready = planned.change
    if activate.requests[0].body["instance"] == host_requests.NO_INSTANCE:
        activate = name_instance(activate, act.started)
    waits_s = get_await_time(deactivate) + _compute_carry_time(planned.carry_inactive)
    try:
        own = resolve_variables(act, task, old)
        with contextlib.ExitStack() as held:
            go_active = held.enter_context(prepare_switch(act, activate, variables, await_go_s=waits_s))
            go_inactive = held.enter_context(prepare_switch(act, deactivate, own, await_go_s=waits_s))
            swap = _Swap(
                act=act,
                task=task,
                old=old,
                new=new,
                instance=str(deactivate.requests[0].body["instance"]),
                variables=own,
                began=time.monotonic(),
            )
            _deactivate_old(swap, go_inactive)
            _carry_state(swap, planned.carry_inactive)
            return _activate_new(swap, go_active, ready)
    except HostError as error:
        # Not prepared: nothing was touched.
        raise HandoffError(error, old, steers=True) from error


def _compute_carry_time(carry: PlannedPhases) -> float:
    """How long (s) a prepared activation waits for the state that is carried while no instance is active."""
    return sum(_TRANSFER_S + phase.requests[0].timeout_s for phase in carry)


def _carry_state(swap: _Swap, carry: PlannedPhases) -> None:
    """Bring the state to the copy; where that fails, the old instance still has it."""
    try:
        perform_phases(swap.act, carry)
    except HostError as error:
        raise _restore_old(swap, error) from error


def _deactivate_old(swap: _Swap, go_inactive: Callable[[], None]) -> None:
    try:
        go_inactive()
    except RefusedError as error:
        raise HandoffError(error, swap.old, steers=True) from error
    except HostError as error:
        if isinstance(error, SwitchError) and error.active:
            raise HandoffError(error, swap.old, steers=True) from error
        raise _restore_old(swap, error) from error


def _activate_new(swap: _Swap, go_active: Callable[[], None], ready: PlannedPhase) -> float:
    """Activate the copy and wait until it is ready; the seconds until it was active."""
    try:
        go_active()
        seconds = time.monotonic() - swap.began
        perform_phase(swap.act, ready)
    except HostError as error:
        raise _withdraw_new(swap, error) from error
    return seconds


def _withdraw_new(swap: _Swap, cause: HostError) -> HandoffError:
    """Stop the copy, with proof, and activate the old instance: two at once would be worse than none.

    A copy whose activation failed and was undone stays as it was.
    """
    swap.act.begin_recovery()
    if isinstance(cause, SwitchError) and cause.inactive:
        return _restore_old(swap, cause)
    stop = build_stop_phase(swap.act.name, swap.task, swap.new, swap.act.run.inventory, instance=None)
    try:
        perform_phase(swap.act, stop)
    except HostError as error:
        message = (
            f"{cause.message}; not activated again on {swap.old}, because it may be active on {swap.new}: "
            f"{error.message}"
        )
        hint = f"check {swap.new}, then apply again"
        return HandoffError(HostError(message, hint=hint, host=swap.new), swap.new, steers=False)
    return _restore_old(swap, cause)


def _restore_old(swap: _Swap, cause: HostError) -> HandoffError:
    """Activate the old instance again; one that refuses that is started anew."""
    swap.act.begin_recovery()
    try:
        _reactivate(swap)
    except HostError as error:
        message = f"{cause.message}; not active again on {swap.old} either: {error.message}"
        return HandoffError(HostError(message, hint=error.hint, host=swap.old), swap.old, steers=False)
    restored = HostError(f"{cause.message}; active again on {swap.old}", hint=cause.hint, host=swap.new)
    return HandoffError(restored, swap.old, steers=True, downtime_s=time.monotonic() - swap.began)


def _reactivate(swap: _Swap) -> None:
    act, inventory = swap.act, swap.act.run.inventory
    again = build_switch_phase(Phase.RESTORE, swap.task, swap.old, inventory, instance=swap.instance)
    try:
        perform_phase(act, again, swap.variables)
    except (RefusedError, SwitchError):
        perform_phase(act, build_stop_phase(act.name, swap.task, swap.old, inventory, instance=None))
        restart = build_run_phases(swap.task, swap.old, inventory, phase=Phase.RESTORE)
        perform_phases(act, restart, swap.variables)
        return
    perform_phase(act, build_ready_phase(swap.task, get_host(inventory, swap.old), inventory))
