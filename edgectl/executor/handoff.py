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
from edgectl.executor.act import Act
from edgectl.executor.order import hold_without_old
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.task import HandoffOrder, Restart, Task, Where


class _AtError(Exception):
    """The handoff went wrong: ``located`` is where the task now stands, ``steers`` whether a ready instance is there."""

    def __init__(self, error: HostError, located: str | None, *, steers: bool, downtime_s: float | None = None) -> None:
        super().__init__(error.message)
        self.error = error
        self.located = located
        self.steers = steers
        self.downtime_s = downtime_s


def move(act: Act, task: Task, old: str, new: str) -> ActionResult:
    """Move a task from ``old`` to ``new``; with both the same, start it anew there.

    Deferred where the new host does not answer, the moment is not safe, or an ``env_command`` fails: nothing was touched.
    """
    try:
        phases.reach(act.run, new)
        phases.await_safe(act, task, old)
        variables = phases.variables(act, task, new)
    except HostError as error:
        return act.end(Outcome.DEFERRED, located=old, error=error)
    try:
        _hold(act, task, old)
        downtime = _swap(act, task, old, new, variables)
    except _AtError as failed:
        return _failed(act, task, failed)
    try:
        phases.hook(act, task, Phase.RELEASE, task.handoff.release, new)
    except HostError as error:
        return act.end(Outcome.FAILED, located=new, downtime_s=downtime, error=error)
    return act.end(Outcome.DONE, located=new, downtime_s=downtime)


def replace(act: Act, task: Task, host: str) -> ActionResult:
    """Start a task whose old host is silent on ``host``, with what its handoff says as far as that can be done without the old host.

    Nothing runs, so no moment is unsafe and nothing is stopped; a hold ``on: host`` has no host to run on. Deferred where the new host
    does not answer, an ``env_command`` or the hold fails: nothing was started, and the task still counts as on its old host.
    """
    old = act.step.decision.previous_host
    try:
        phases.reach(act.run, host)
        variables = phases.variables(act, task, host)
        phases.hook(act, task, Phase.HOLD, hold_without_old(task), host)
    except HostError as error:
        return act.end(Outcome.DEFERRED, located=old, error=error)
    try:
        phases.await_ready(act, task, host, phases.start(act, task, host, variables))
    except HostError as error:
        there = old if isinstance(error, RefusedError) else host
        return _failed(act, task, _AtError(error, there, steers=False))
    try:
        phases.hook(act, task, Phase.RELEASE, task.handoff.release, host)
    except HostError as error:
        return act.end(Outcome.FAILED, located=host, error=error)
    return act.end(Outcome.DONE, located=host)


def _hold(act: Act, task: Task, old: str) -> None:
    try:
        phases.hook(act, task, Phase.HOLD, task.handoff.hold, old)
    except HostError as error:
        raise _AtError(error, old, steers=True) from error


def _swap(act: Act, task: Task, old: str, new: str, variables: dict[str, str]) -> float:
    """Old for new in the stated order; the time in between in seconds, 0 where they overlapped."""
    if old != new and task.handoff.order is HandoffOrder.START_FIRST:
        _start_first(act, task, old, new, variables)
        return 0.0
    return _stop_first(act, task, old, new, variables)


def _failed(act: Act, task: Task, failed: _AtError) -> ActionResult:
    """Report the first cause, and release what holds if something steers it; else say loudly that it still holds."""
    error = failed.error
    try:
        if failed.steers:
            phases.hook(act, task, Phase.RELEASE, task.handoff.release, failed.located or "")
        elif task.handoff.hold is not None:
            error = _still_holding(act, task, error)
    except HostError as another:
        error = HostError(f"{error.message}; {another.message}", hint=error.hint)
    return act.end(Outcome.FAILED, located=failed.located, downtime_s=failed.downtime_s, error=error)


def _still_holding(act: Act, task: Task, error: HostError) -> HostError:
    on_robot = task.handoff.hold is not None and task.handoff.hold.on is Where.ROBOT and task.robots
    what = task.robots[0] if on_robot else f"what {act.name} controls"
    message = f"{error.message}; {what} STILL HOLDS: no instance of {act.name} is ready"
    # What fails under restart: never no apply starts again.
    how = f"edgectl restart {act.name}" if task.restart is Restart.NEVER else "apply again"
    hint = f"{how}, which releases it once an instance is ready"
    return HostError(message, hint=f"{error.hint}; then {hint}" if error.hint else hint, host=error.host)


def _stop_first(act: Act, task: Task, old: str, new: str, variables: dict[str, str]) -> float:
    began = time.monotonic()
    try:
        phases.stop(act, old, instance=act.step.instances.get(old))
    except HostError as error:
        raise _AtError(error, old, steers=isinstance(error, RefusedError)) from error
    try:
        phases.await_ready(act, task, new, phases.start(act, task, new, variables))
    except HostError as error:
        if old == new:
            raise _AtError(error, new, steers=False) from error
        raise _restored(act, task, old, new, error, began) from error
    return time.monotonic() - began


def _start_first(act: Act, task: Task, old: str, new: str, variables: dict[str, str]) -> None:
    try:
        phases.await_ready(act, task, new, phases.start(act, task, new, variables))
    except HostError as error:
        raise _withdrawn(act, old, new, error) from error
    try:
        phases.stop(act, old, instance=act.step.instances.get(old))
    except HostError as error:
        raise _AtError(error, new, steers=True) from error


def _withdrawn(act: Act, old: str, new: str, cause: HostError) -> _AtError:
    """Take the new instance away again; the old one was never touched."""
    try:
        phases.stop(act, new, instance=None)
    except HostError as error:
        message = f"{cause.message}; the new instance could not be taken away: {error.message}"
        return _AtError(HostError(message, hint=error.hint, host=new), old, steers=True)
    return _AtError(HostError(f"{cause.message}; it still runs on {old}", hint=cause.hint, host=new), old, steers=True)


def _restored(act: Act, task: Task, old: str, new: str, cause: HostError, began: float) -> _AtError:
    """Put the old instance back, unless the new one cannot be proven gone: two at once would be worse than none."""
    try:
        phases.stop(act, new, instance=None)
    except HostError as error:
        message = f"{cause.message}; not restored on {old}, because it may still run on {new}: {error.message}"
        return _AtError(HostError(message, hint=f"see to {new}, then apply again", host=new), new, steers=False)
    sent = False
    try:
        variables = phases.variables(act, task, old)
        sent = True
        phases.await_ready(act, task, old, phases.start(act, task, old, variables, attempt=2, phase=Phase.RESTORE))
    except HostError as error:
        message = f"{cause.message}; could not be restored on {old} either: {error.message}"
        there = old if sent and not isinstance(error, RefusedError) else None
        return _AtError(HostError(message, hint=error.hint, host=old), there, steers=False)
    restored = HostError(f"{cause.message}; restored on {old}", hint=cause.hint, host=new)
    return _AtError(restored, old, steers=True, downtime_s=time.monotonic() - began)
