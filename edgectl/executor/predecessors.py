"""Whether the predecessors of a task are as far as it needs them."""

import time
from collections.abc import Iterable

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.executor import host_requests, phases
from edgectl.executor.step_run import RunContext
from edgectl.model.assignment import Verdict
from edgectl.model.plan import Action, Step
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.snapshot import TaskSample, TaskState
from edgectl.model.task import Need, NeedCondition, Task

# How long a successor waits for a job to complete before it is left to the next apply.
_COMPLETION_S = 30.0


def is_need_satisfied(need: Need, result: ActionResult | None) -> bool:
    """Whether a predecessor that this plan started (or moved) went well enough for its successor to start."""
    if result is None:
        return False
    if result.outcome is Outcome.DONE:
        return True
    still_there = result.outcome is Outcome.DEFERRED and result.located is not None
    return still_there or (need.until is NeedCondition.RUNNING and result.located is not None)


def wait_for_predecessors(run: RunContext, needs: Iterable[Need]) -> None:
    """Wait for predecessors: those that this plan does not touch, and jobs that must have completed.

    Raises:
        HostError: one of them is not as far by its own deadline.
    """
    steps = {step.task: step for step in run.plan.steps}
    for need in needs:
        step = steps.get(need.task)
        task = run.tasks.tasks.get(need.task)
        if step is not None and task is not None and not _is_predecessor_settled(run, need, task, step):
            _wait_for_predecessor(run, need, task, step)


def _is_predecessor_settled(run: RunContext, need: Need, task: Task, step: Step) -> bool:
    """Whether the snapshot already shows the predecessor where it must be, or nobody can ask it."""
    if step.decision.verdict in (Verdict.COMPLETED, Verdict.HELD) or step.action in (
        Action.COMPLETE,
        Action.HOLD,
        Action.NONE,
    ):
        return True
    if not task.managed:
        return need.until is not NeedCondition.COMPLETED
    if need.until is NeedCondition.COMPLETED:
        return False
    if step.action in (Action.START, Action.MOVE, Action.RESTART):
        return True
    sample = _find_predecessor_sample(run, step)
    if sample is None:
        return False
    return sample.state is TaskState.READY or (
        sample.state is TaskState.RUNNING and (task.ready is None or need.until is NeedCondition.RUNNING)
    )


def _find_predecessor_sample(run: RunContext, step: Step) -> TaskSample | None:
    host = run.plan.snapshot.hosts.get(step.decision.host or "")
    return host.tasks.get(step.task) if host else None


def _wait_for_predecessor(run: RunContext, need: Need, task: Task, step: Step) -> None:
    host = run.hosts.get(step.decision.host or "")
    if host is None:
        raise HostError(f"waits for {need.task}, which does not run", hint="apply again once it does")
    if need.until is NeedCondition.COMPLETED:
        deadline = time.monotonic() + _COMPLETION_S
        while not _is_reported_completed(
            run.ask(host, host_requests.build_status_request(host, need.task)), need.task
        ):
            if time.monotonic() >= deadline:
                raise HostError(f"waits for {need.task} to complete", hint="apply again once it has")
            time.sleep(run.options.poll_s)
        return
    sample = _find_predecessor_sample(run, step)
    timeout = task.ready.timeout if task.ready else 10.0
    phases.wait_for_ready_on_host(
        run, task, host, sample.instance if sample else "", time.monotonic() + timeout
    )


def _is_reported_completed(answer: host_requests.Request, name: str) -> bool:
    entries = answer.get("tasks")
    entry = entries.get(name) if isinstance(entries, dict) else None
    return isinstance(entry, dict) and entry.get("state") == protocol.COMPLETED
