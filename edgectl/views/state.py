# SPDX-License-Identifier: Apache-2.0
"""State of tasks and hosts as phrases, and remarks on failed tasks and limits."""

from collections.abc import Collection

from edgectl.dataclass import dataclass
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.rules.lost_places import LostPlace, list_lost_tasks
from edgectl.units import format_duration
from edgectl.views.text import Cell

_ORPHAN_REMARK = "its supervisor was lost: it is not restarted and has no self_fence until edgectl apply"
_FAILED_STATES = (TaskState.FAILED, TaskState.CRASHLOOP)


@dataclass(frozen=True, slots=True, kw_only=True)
class AbsentTask:
    """A task that no host reports.

    ``state``: completed, unknown, not running or (unmanaged) not found. Where unknown: the last ``host`` and
    its ``contact`` (s since 1970), or the ``lost`` place.
    """

    state: str
    host: str | None = None
    contact: float | None = None
    lost: LostPlace | None = None


def resolve_absent_task(task: Task, value: Snapshot) -> AbsentTask:
    """State of ``task``, which no host of the snapshot reports."""
    memory = value.manager or ManagerState()
    placement = memory.placements.get(task.name)
    if memory.done.get(task.name) == task.spec_hash:
        return AbsentTask(state="completed")
    if placement is not None and placement.host in value.hosts and not value.hosts[placement.host].ok:
        return AbsentTask(state="unknown", host=placement.host, contact=memory.contact.get(placement.host))
    lost = list_lost_tasks(value).get(task.name)
    if lost is not None:
        return AbsentTask(state="unknown", host=lost.host, lost=lost)
    return AbsentTask(state="not running" if task.managed else "not found")


def find_failed_tasks(tasks: Tasks, value: Snapshot) -> dict[str, tuple[str, TaskSample]]:
    """The wanted tasks that have ended without success and run nowhere, each with host and latest run.

    One whose last known host does not answer may run there.
    """
    memory = value.manager or ManagerState()
    silent = {host for host, each in value.hosts.items() if not each.ok}
    failed: dict[str, tuple[str, TaskSample]] = {}
    for name, task in tasks.tasks.items():
        runs = [(host, each.tasks[name]) for host, each in value.hosts.items() if name in each.tasks]
        wanted = task.managed and memory.done.get(name) != task.spec_hash
        unseen = name in memory.placements and memory.placements[name].host in silent
        if wanted and runs and not unseen and all(run.state in _FAILED_STATES for _, run in runs):
            failed[name] = max(runs, key=lambda found: found[1].generation)
    return failed


def list_unhealthy_tasks(value: Snapshot) -> list[str]:
    """The tasks that run and are not alive, each with its host."""
    return [
        f"{name} on {host}"
        for host, each in value.hosts.items()
        for name, sample in each.tasks.items()
        if sample.state is TaskState.UNHEALTHY
    ]


def is_restarting(sample: TaskSample) -> bool:
    """Whether a task has crashed and waits for its next start, or is not yet up after it."""
    return sample.state is TaskState.STARTING and sample.last_exit not in (None, 0)


def list_restarting_tasks(value: Snapshot) -> list[str]:
    """The tasks that crashed and are not up again, each with its host and figures."""
    return [
        f"{name} on {host} ({_describe_restarts(sample)})"
        for host, each in value.hosts.items()
        for name, sample in each.tasks.items()
        if is_restarting(sample)
    ]


def _describe_restarts(sample: TaskSample) -> str:
    plural = "s" * (sample.restarts != 1)
    return f"{sample.restarts} restart{plural}, last exit {sample.last_exit}"


def list_failed_needs(task: Task | None, failed: Collection[str]) -> list[str]:
    """The tasks that ``task`` needs and that have failed."""
    return [need.task for need in task.needs if need.task in failed] if task is not None else []


def format_silence(contact: float | None, now: float) -> str:
    """Time since the last contact with a host, in brackets; empty where that is not known."""
    return "" if contact is None else f" (silent for {format_duration(max(0.0, now - contact))})"


def format_operator_mark(host: str, memory: ManagerState | None) -> str:
    """Mark of the operator on a host: fenced, draining, cordoned, or empty."""
    if memory is None:
        return ""
    words = {"fenced": memory.fenced, "draining": memory.draining, "cordoned": memory.cordons}
    return next((word for word, hosts in words.items() if host in hosts), "")


TASK_STATE_STYLES = {
    TaskState.READY: "good",
    TaskState.RUNNING: "good",
    TaskState.STARTING: "warn",
    TaskState.UNHEALTHY: "bad",
    TaskState.COMPLETED: "dim",
    TaskState.FAILED: "bad",
    TaskState.CRASHLOOP: "bad",
}


def format_task_state(sample: TaskSample) -> str:
    """``ready`` or ``failed (5 restarts, last exit 1)``.

    A crash loop counts as failed, a service that ended with 0 as exited.
    """
    if sample.state is TaskState.FAILED and sample.detail == "exited with 0":
        return "exited (exit code 0)"
    if sample.state is TaskState.CRASHLOOP and sample.last_exit is not None:
        return f"failed ({_describe_restarts(sample)})"
    return sample.state.value + (f" ({sample.detail})" if sample.detail else "")


def render_host_status(name: str, sample: HostSample | None, memory: ManagerState | None) -> Cell:
    """Whether a host answered, and the mark of the operator."""
    if sample is None:
        return Cell("not probed", "dim")
    closed = format_operator_mark(name, memory)
    word = "ok" if sample.ok else "unreachable"
    return Cell(
        f"{word}, {closed}" if closed else word, "bad" if not sample.ok else "warn" if closed else "good"
    )


def list_task_remarks(value: Snapshot) -> list[str]:
    """Last log lines and remedy of each failed task, orphans, and limits that are not enforced."""
    tasks = [
        (f"{name} on {host}", sample)
        for host, each in value.hosts.items()
        for name, sample in each.tasks.items()
    ]
    said = [f"{where}: last output: {line}" for where, sample in tasks for line in sample.log_tail]
    limits = [
        f"{where}: limits: {sample.limits}"
        for where, sample in tasks
        if sample.limits.startswith("not") and sample.state.alive
    ]
    orphans = [f"{where}: {_ORPHAN_REMARK}" for where, sample in tasks if sample.orphaned]
    return said + _list_given_up_notes(value) + orphans + limits


def _list_given_up_notes(value: Snapshot) -> list[str]:
    """Remedy of each task that is not restarted any more, unless another copy is alive."""
    runs = [(name, sample) for host in value.hosts.values() for name, sample in host.tasks.items()]
    alive = {name for name, sample in runs if sample.state.alive}
    over = dict.fromkeys(name for name, sample in runs if sample.given_up and name not in alive)
    return [
        f"{name} is given up; edgectl restart {name}, or a changed spec, starts it again" for name in over
    ]


def describe_attention(sample: TaskSample) -> str:
    """The reason why an operator should look at a task; empty where all is well."""
    if sample.given_up:
        return "given up; edgectl restart, or a changed spec, starts it again"
    if sample.state in (TaskState.FAILED, TaskState.CRASHLOOP):
        return format_task_state(sample) + (f": {sample.log_tail[-1]}" if sample.log_tail else "")
    if sample.orphaned:
        return _ORPHAN_REMARK
    if sample.state is TaskState.UNHEALTHY:
        return format_task_state(sample)
    if is_restarting(sample):
        return f"restarts after a crash ({_describe_restarts(sample)})"
    return f"limits: {sample.limits}" if sample.limits.startswith("not") and sample.state.alive else ""
