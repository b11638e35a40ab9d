# SPDX-License-Identifier: Apache-2.0
"""Moves, restarts and replacements of a task: one unit, in the order that its handoff contract states.

stop-first: safe? -> hold -> [save, transfer] -> stop old, verified gone -> start new -> [load] -> ready ->
release.
start-first: safe? -> hold -> [save, transfer] -> start new -> [load] -> ready -> stop old -> release. A node
of ROS is told before that its successor starts, which may throw it out of the graph.
warm: start the copy, if there is none -> safe? -> hold -> deactivate old, verified -> activate new -> ready
-> release -> the old one stays as a copy, or stops (``warm_move``).
replacement of an instance that is gone with its unreachable host: hold -> start new -> ready -> release.

What ends a handoff (taking the new instance away, putting the old one back, release) asks a host that was
silent in this run once more: a request that let its deadline pass may have been carried out.

A robot on hold is released only when an instance is ready again, new or old. Where none is, it stays on hold,
the result reports it, and the next apply that gets an instance ready releases it (``hold_release``).
"""

import contextlib
import time
from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.errors import HostError, RefusedError
from edgectl.executor.action_phases import (
    PlannedPhase,
    PlannedPhases,
    build_hook_phases,
    build_leaving_phases,
    build_run_phases,
    build_stop_phase,
)
from edgectl.executor.concurrent_change import ConcurrentChangeError
from edgectl.executor.handoff_error import HandoffError
from edgectl.executor.heard import begin_gap_watch
from edgectl.executor.host_requests import build_status_request
from edgectl.executor.phases import perform_phase, perform_phases, resolve_variables
from edgectl.executor.start_phases import StartPhases
from edgectl.executor.state_phases import build_carried_run_phases
from edgectl.executor.state_transfer import drop_state
from edgectl.executor.step_run import StepRun
from edgectl.executor.switch import SwitchError
from edgectl.executor.warm_move import swap_active_instance
from edgectl.model.check import CheckLocation
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.task import RestartPolicy, Task

# For so long what is left of a new instance in a ROS graph is no fault of the old one, which stays.
_FORGOTTEN_S = 30.0


def move_task(act: StepRun, task: Task, planned: StartPhases) -> ActionResult:
    """Move a task from its host to another; with both the same, start it anew there.

    Deferred where the new host does not answer, the moment is not safe, or an ``env_command`` fails:
    nothing was touched.
    """
    new = act.step.decision.host or ""
    old = act.step.decision.previous_host or new
    try:
        perform_phases(act, planned.prepare)
        variables = resolve_variables(act, task, new)
    except HostError as error:
        return act.end(_judge_preparation(act), located=old, error=error)
    begin_gap_watch(act, task)
    try:
        _prepare_swap(act, planned, old)
        warm = planned.change[0].phase is Phase.DEACTIVATE
        swap = swap_active_instance if warm else _swap_instances
        downtime = swap(act, task, planned, old, new, variables)
    except HandoffError as failed:
        return _end_failed_handoff(act, task, failed)
    return _release_and_end(act, planned, new, downtime)


def replace_task(act: StepRun, task: Task, planned: StartPhases) -> ActionResult:
    """Start a task elsewhere while its old host is unreachable, with the hooks that do not need that host.

    Nothing runs, so no moment is unsafe and nothing is stopped; a hold ``on: host`` has no host to run on.
    Deferred where the new host does not answer, an ``env_command`` or the hold fails: nothing was started,
    and the task still counts as on its old host.
    """
    old, host = act.step.decision.previous_host, act.step.decision.host or ""
    try:
        perform_phases(act, planned.prepare)
        variables = resolve_variables(act, task, host)
        perform_phases(act, planned.hold)
    except HostError as error:
        return act.end(Outcome.DEFERRED, located=old, error=error)
    try:
        start_instance(act, task, planned.change, host, variables)
    except HostError as error:
        there = old if isinstance(error, RefusedError) else host
        return _end_failed_handoff(act, task, HandoffError(error, there, steers=False))
    return _release_and_end(act, planned, host, None)


def start_instance(
    act: StepRun, task: Task, change: PlannedPhases, host: str, variables: Mapping[str, str]
) -> None:
    """Start the task on ``host`` and wait until it is ready; where a copy that waits there cannot be
    activated, start it anew.

    Raises:
        HostError: as `perform_phases`.
    """
    try:
        perform_phases(act, change, variables)
    except (RefusedError, SwitchError):
        if change[0].phase is not Phase.ACTIVATE:
            raise
        perform_phase(act, build_stop_phase(act.name, task, host, act.run.inventory, instance=None))
        perform_phases(act, build_run_phases(task, host, act.run.inventory), variables)


def inherit_state(act: StepRun, task: Task, planned: StartPhases, host: str) -> PlannedPhases:
    """Bring the state that an interrupted move has left to ``host``; the phases that start the task then.

    Where that fails, it starts without: nobody serves meanwhile. A copy that has taken in a part of the state
    is started anew.

    Raises:
        HostError: that copy does not stop.
    """
    try:
        perform_phases(act, planned.carry)
    except HostError:
        act.begin_recovery()
        loaded = act.phases[-1].phase is Phase.LOAD
        if not loaded and planned.change[0].phase is Phase.ACTIVATE:
            return planned.change
        if loaded:
            perform_phase(act, build_stop_phase(act.name, task, host, act.run.inventory, instance=None))
        return build_run_phases(task, host, act.run.inventory)
    return planned.change


def _judge_preparation(act: StepRun) -> Outcome:
    """A copy that does not get ready is a failure; what else keeps a move from beginning may pass."""
    failed = bool(act.phases) and act.phases[-1].phase is Phase.STANDBY
    return Outcome.FAILED if failed else Outcome.DEFERRED


def _prepare_swap(act: StepRun, planned: StartPhases, old: str) -> None:
    """Run the hold hook and bring the state to the new host, while the old instance runs."""
    try:
        perform_phases(act, (*planned.hold, *planned.carry))
    except HostError as error:
        raise HandoffError(error, old, steers=True) from error


def _release_and_end(act: StepRun, planned: StartPhases, host: str, downtime: float | None) -> ActionResult:
    """Run the release hook once the new instance is ready, and stop the old one where it is no copy."""
    act.begin_recovery()
    try:
        perform_phases(act, planned.release)
        perform_phases(act, planned.retire)
    except HostError as error:
        drop_state(act)
        return act.end(Outcome.FAILED, located=host, downtime_s=downtime, error=error)
    drop_state(act)
    return act.end(Outcome.DONE, located=host, downtime_s=downtime)


def _swap_instances(
    act: StepRun, task: Task, planned: StartPhases, old: str, new: str, variables: dict[str, str]
) -> float:
    """Old for new in the stated order; the time in between in seconds, 0 where they overlapped.

    It ends when the new instance is ready; without a ready check when it was started, for it has run since.
    """
    stop_first, began = planned.change[0].phase is Phase.STOP, time.monotonic()
    started = began
    for phase in planned.change:
        try:
            perform_phase(act, phase, variables)
            appeared = phase.phase in (Phase.START, Phase.ACTIVATE)
            started = time.monotonic() if appeared else started
        except HostError as error:
            act.begin_recovery()
            if stop_first:
                raise _recover_stop_first(act, task, phase, old, new, error, began) from error
            raise _recover_start_first(act, task, phase, old, new, error) from error
    ended = time.monotonic() if task.ready is not None else started
    return ended - began if stop_first else 0.0


def _recover_stop_first(
    act: StepRun, task: Task, failed: PlannedPhase, old: str, new: str, error: HostError, began: float
) -> HandoffError:
    """Where the old instance is gone and the new one failed, put the old one back."""
    if isinstance(error, ConcurrentChangeError):
        return HandoffError(error, error.located, steers=False)
    if failed.phase is Phase.STOP:
        return HandoffError(error, old, steers=isinstance(error, RefusedError))
    if old == new:
        return HandoffError(error, new, steers=False)
    return _restore_old_instance(act, task, old, new, error, began)


def _recover_start_first(
    act: StepRun, task: Task, failed: PlannedPhase, old: str, new: str, error: HostError
) -> HandoffError:
    """Where the new instance failed, take it away again; the old one was never touched, but a node of the new
    one may have thrown it out of the ROS graph: then it is put back.
    """
    if failed.phase is Phase.STOP:
        return HandoffError(error, new, steers=True)
    if _has_ended(act, task, old):
        return _restore_old_instance(act, task, old, new, error, time.monotonic())
    withdrawn = _withdraw_new_instance(act, task, old, new, error)
    with contextlib.suppress(HostError):
        perform_phases(
            act, build_leaving_phases(task, old, act.step, act.run.inventory, seconds=_FORGOTTEN_S)
        )
    return withdrawn


def _has_ended(act: StepRun, task: Task, old: str) -> bool:
    """Whether the old instance, a node of ROS, certainly has ended."""
    host = act.run.hosts[old]
    if host.ros is None:
        return False
    try:
        entries = act.run.ask(host, build_status_request(host, task.name)).get("tasks")
    except HostError:
        return False
    entry = entries.get(task.name, {}) if isinstance(entries, dict) else None
    return isinstance(entry, dict) and entry.get("state") not in protocol.ALIVE_STATES


def _end_failed_handoff(act: StepRun, task: Task, failed: HandoffError) -> ActionResult:
    """Report the first cause; release the robot if an instance steers it, else report that it still holds."""
    act.begin_recovery()
    error = failed.error
    try:
        if failed.steers:
            perform_phases(act, _build_release(act, task, failed.located or ""))
        elif task.handoff.hold is not None:
            error = _build_still_holding_error(act, task, error)
    except HostError as another:
        error = HostError(f"{error.message}; {another.message}", hint=error.hint)
    drop_state(act)
    outcome = Outcome.DEFERRED if isinstance(failed.error, ConcurrentChangeError) else Outcome.FAILED
    return act.end(outcome, located=failed.located, downtime_s=failed.downtime_s, error=error)


def _build_still_holding_error(act: StepRun, task: Task, error: HostError) -> HostError:
    on_robot = task.handoff.hold is not None and task.handoff.hold.on is CheckLocation.ROBOT and task.robots
    what = task.robots[0] if on_robot else f"what {act.name} controls"
    message = f"{error.message}; {what} STILL HOLDS: no instance of {act.name} is ready"
    # What fails under restart: never no apply starts again.
    how = f"edgectl restart {act.name}" if task.restart is RestartPolicy.NEVER else "apply again"
    hint = f"{how}, which releases it once an instance is ready"
    return HostError(message, hint=f"{error.hint}; then {hint}" if error.hint else hint, host=error.host)


def _build_release(act: StepRun, task: Task, host: str) -> tuple[PlannedPhase, ...]:
    return build_hook_phases(Phase.RELEASE, task, task.handoff.release, host, act.run.inventory)


def _stop_new_instance(act: StepRun, task: Task, new: str) -> None:
    perform_phase(act, build_stop_phase(act.name, task, new, act.run.inventory, instance=None))


def _withdraw_new_instance(act: StepRun, task: Task, old: str, new: str, cause: HostError) -> HandoffError:
    try:
        _stop_new_instance(act, task, new)
    except HostError as error:
        message = f"{cause.message}; the new instance could not be taken away: {error.message}"
        return HandoffError(HostError(message, hint=error.hint, host=new), old, steers=True)
    return HandoffError(
        HostError(f"{cause.message}; it still runs on {old}", hint=cause.hint, host=new), old, steers=True
    )


def _restore_old_instance(
    act: StepRun, task: Task, old: str, new: str, cause: HostError, began: float
) -> HandoffError:
    """Start the old instance again, unless the new one may run: two at once would be worse than none."""
    try:
        _stop_new_instance(act, task, new)
    except HostError as error:
        message = (
            f"{cause.message}; not restored on {old}, because it may still run on {new}: {error.message}"
        )
        return HandoffError(
            HostError(message, hint=f"check {new}, then apply again", host=new), new, steers=False
        )
    sent, carried = False, act.carried is not None
    try:
        build = build_carried_run_phases if carried else build_run_phases
        restore = build(task, old, act.run.inventory, phase=Phase.RESTORE)
        variables = resolve_variables(act, task, old)
        sent = True
        lost = _perform_restore(act, restore, variables)
    except HostError as error:
        message = f"{cause.message}; could not be restored on {old} either: {error.message}"
        there = old if sent and not isinstance(error, RefusedError) else None
        return HandoffError(HostError(message, hint=error.hint, host=old), there, steers=False)
    restored = HostError(f"{cause.message}; restored on {old}{lost}", hint=cause.hint, host=new)
    return HandoffError(restored, old, steers=True, downtime_s=time.monotonic() - began)


def _perform_restore(act: StepRun, restore: tuple[PlannedPhase, ...], variables: dict[str, str]) -> str:
    """Start the old instance again and load its state; it serves also where it does not take that.

    Returns how the message goes on then.
    """
    lost = ""
    for phase in restore:
        try:
            perform_phase(act, phase, variables)
        except HostError as error:
            if phase.phase is not Phase.LOAD:
                raise
            lost = f", without its state: {error.message}"
    return lost
