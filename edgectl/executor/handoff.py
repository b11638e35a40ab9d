"""A task that changes its place (or its command): one unit, in the order that its handoff contract states.

stop-first: safe? -> hold -> stop old, verified gone -> start new -> ready -> release.
start-first: safe? -> hold -> start new -> ready -> stop old -> release.
replacement of an instance on a silent host, which is gone for certain: hold -> start new -> ready -> release.

What was told to hold is released only when an instance is ready again, new or old. Where none is, it goes on holding, the result says so,
and the next apply that gets an instance ready releases it (``recover``).
"""

import time

from edgectl.errors import HostError, RefusedError
from edgectl.executor import phases
from edgectl.executor.dependencies import find_replacement_hold
from edgectl.executor.step_run import StepRun
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.task import CheckLocation, HandoffOrder, RestartPolicy, Task


class _HandoffError(Exception):
    """The handoff went wrong: ``located`` is where the task now stands, ``steers`` whether a ready instance is there."""

    def __init__(
        self, error: HostError, located: str | None, *, steers: bool, downtime_s: float | None = None
    ) -> None:
        super().__init__(error.message)
        self.error = error
        self.located = located
        self.steers = steers
        self.downtime_s = downtime_s


def move_task(act: StepRun, task: Task, old: str, new: str) -> ActionResult:
    """Move a task from ``old`` to ``new``; with both the same, start it anew there.

    Deferred where the new host does not answer, the moment is not safe, or an ``env_command`` fails: nothing was touched.
    """
    try:
        phases.check_reachable(act.run, new)
        phases.wait_for_safe_handoff(act, task, old)
        variables = phases.resolve_variables(act, task, new)
    except HostError as error:
        return act.end(Outcome.DEFERRED, located=old, error=error)
    try:
        _run_hold_hook(act, task, old)
        downtime = _swap_instances(act, task, old, new, variables)
    except _HandoffError as failed:
        return _end_failed_handoff(act, task, failed)
    try:
        phases.run_hook(act, task, Phase.RELEASE, task.handoff.release, new)
    except HostError as error:
        return act.end(Outcome.FAILED, located=new, downtime_s=downtime, error=error)
    return act.end(Outcome.DONE, located=new, downtime_s=downtime)


def replace_task(act: StepRun, task: Task, host: str) -> ActionResult:
    """Start a task whose old host is silent on ``host``, with what its handoff says as far as that can be done without the old host.

    Nothing runs, so no moment is unsafe and nothing is stopped; a hold ``on: host`` has no host to run on. Deferred where the new host
    does not answer, an ``env_command`` or the hold fails: nothing was started, and the task still counts as on its old host.
    """
    old = act.step.decision.previous_host
    try:
        phases.check_reachable(act.run, host)
        variables = phases.resolve_variables(act, task, host)
        phases.run_hook(act, task, Phase.HOLD, find_replacement_hold(task), host)
    except HostError as error:
        return act.end(Outcome.DEFERRED, located=old, error=error)
    try:
        phases.wait_for_ready(act, task, host, phases.start_task(act, task, host, variables))
    except HostError as error:
        there = old if isinstance(error, RefusedError) else host
        return _end_failed_handoff(act, task, _HandoffError(error, there, steers=False))
    try:
        phases.run_hook(act, task, Phase.RELEASE, task.handoff.release, host)
    except HostError as error:
        return act.end(Outcome.FAILED, located=host, error=error)
    return act.end(Outcome.DONE, located=host)


def _run_hold_hook(act: StepRun, task: Task, old: str) -> None:
    try:
        phases.run_hook(act, task, Phase.HOLD, task.handoff.hold, old)
    except HostError as error:
        raise _HandoffError(error, old, steers=True) from error


def _swap_instances(act: StepRun, task: Task, old: str, new: str, variables: dict[str, str]) -> float:
    """Old for new in the stated order; the time in between in seconds, 0 where they overlapped."""
    if old != new and task.handoff.order is HandoffOrder.START_FIRST:
        _swap_start_first(act, task, old, new, variables)
        return 0.0
    return _swap_stop_first(act, task, old, new, variables)


def _end_failed_handoff(act: StepRun, task: Task, failed: _HandoffError) -> ActionResult:
    """Report the first cause, and release what holds if something steers it; else say loudly that it still holds."""
    error = failed.error
    try:
        if failed.steers:
            phases.run_hook(act, task, Phase.RELEASE, task.handoff.release, failed.located or "")
        elif task.handoff.hold is not None:
            error = _build_still_holding_error(act, task, error)
    except HostError as another:
        error = HostError(f"{error.message}; {another.message}", hint=error.hint)
    return act.end(Outcome.FAILED, located=failed.located, downtime_s=failed.downtime_s, error=error)


def _build_still_holding_error(act: StepRun, task: Task, error: HostError) -> HostError:
    on_robot = task.handoff.hold is not None and task.handoff.hold.on is CheckLocation.ROBOT and task.robots
    what = task.robots[0] if on_robot else f"what {act.name} controls"
    message = f"{error.message}; {what} STILL HOLDS: no instance of {act.name} is ready"
    # What fails under restart: never no apply starts again.
    how = f"edgectl restart {act.name}" if task.restart is RestartPolicy.NEVER else "apply again"
    hint = f"{how}, which releases it once an instance is ready"
    return HostError(message, hint=f"{error.hint}; then {hint}" if error.hint else hint, host=error.host)


def _swap_stop_first(act: StepRun, task: Task, old: str, new: str, variables: dict[str, str]) -> float:
    began = time.monotonic()
    try:
        phases.stop_task(act, old, instance=act.step.instances.get(old))
    except HostError as error:
        raise _HandoffError(error, old, steers=isinstance(error, RefusedError)) from error
    try:
        phases.wait_for_ready(act, task, new, phases.start_task(act, task, new, variables))
    except HostError as error:
        if old == new:
            raise _HandoffError(error, new, steers=False) from error
        raise _restore_old_instance(act, task, old, new, error, began) from error
    return time.monotonic() - began


def _swap_start_first(act: StepRun, task: Task, old: str, new: str, variables: dict[str, str]) -> None:
    try:
        phases.wait_for_ready(act, task, new, phases.start_task(act, task, new, variables))
    except HostError as error:
        raise _withdraw_new_instance(act, old, new, error) from error
    try:
        phases.stop_task(act, old, instance=act.step.instances.get(old))
    except HostError as error:
        raise _HandoffError(error, new, steers=True) from error


def _withdraw_new_instance(act: StepRun, old: str, new: str, cause: HostError) -> _HandoffError:
    """Take the new instance away again; the old one was never touched."""
    try:
        phases.stop_task(act, new, instance=None)
    except HostError as error:
        message = f"{cause.message}; the new instance could not be taken away: {error.message}"
        return _HandoffError(HostError(message, hint=error.hint, host=new), old, steers=True)
    return _HandoffError(
        HostError(f"{cause.message}; it still runs on {old}", hint=cause.hint, host=new), old, steers=True
    )


def _restore_old_instance(
    act: StepRun, task: Task, old: str, new: str, cause: HostError, began: float
) -> _HandoffError:
    """Put the old instance back, unless the new one cannot be proven gone: two at once would be worse than none."""
    try:
        phases.stop_task(act, new, instance=None)
    except HostError as error:
        message = (
            f"{cause.message}; not restored on {old}, because it may still run on {new}: {error.message}"
        )
        return _HandoffError(
            HostError(message, hint=f"see to {new}, then apply again", host=new), new, steers=False
        )
    sent = False
    try:
        variables = phases.resolve_variables(act, task, old)
        sent = True
        phases.wait_for_ready(
            act, task, old, phases.start_task(act, task, old, variables, attempt=2, phase=Phase.RESTORE)
        )
    except HostError as error:
        message = f"{cause.message}; could not be restored on {old} either: {error.message}"
        there = old if sent and not isinstance(error, RefusedError) else None
        return _HandoffError(HostError(message, hint=error.hint, host=old), there, steers=False)
    restored = HostError(f"{cause.message}; restored on {old}", hint=cause.hint, host=new)
    return _HandoffError(restored, old, steers=True, downtime_s=time.monotonic() - began)
