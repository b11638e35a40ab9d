"""How a task's state is told: one phrase, and below the table what a failed task said last and which limits do not hold."""

from dataclasses import dataclass

from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import Task
from edgectl.units import format_duration
from edgectl.views.text import Cell


@dataclass(frozen=True, slots=True, kw_only=True)
class AbsentTask:
    """``state``: completed, unknown, not running or (unmanaged) not found. Where unknown: the last ``host`` and its ``contact``."""

    state: str
    host: str | None = None
    contact: float | None = None


def resolve_absent_task(task: Task, value: Snapshot) -> AbsentTask:
    """What became of ``task``, which no host of the snapshot reports."""
    memory = value.manager or ManagerState()
    placement = memory.placements.get(task.name)
    if memory.done.get(task.name) == task.spec_hash:
        return AbsentTask(state="completed")
    if placement is not None and placement.host in value.hosts and not value.hosts[placement.host].ok:
        return AbsentTask(state="unknown", host=placement.host, contact=memory.contact.get(placement.host))
    return AbsentTask(state="not running" if task.managed else "not found")


def format_silence(contact: float | None, now: float) -> str:
    """How long a host has been silent, in brackets; nothing where that is not known."""
    return "" if contact is None else f" (silent for {format_duration(max(0.0, now - contact))})"


def format_operator_mark(host: str, memory: ManagerState | None) -> str:
    """How the operator closed a host: fenced, draining, cordoned, or nothing."""
    if memory is None:
        return ""
    words = {"fenced": memory.fenced, "draining": memory.draining, "cordoned": memory.cordons}
    return next((word for word, hosts in words.items() if host in hosts), "")


TASK_STATE_STYLES = {
    TaskState.READY: "good", TaskState.RUNNING: "good", TaskState.STARTING: "warn", TaskState.COMPLETED: "dim",
    TaskState.FAILED: "bad", TaskState.CRASHLOOP: "bad",
}  # fmt: skip


def format_task_state(sample: TaskSample) -> str:
    """Such as ``ready`` or ``failed (5 restarts, last exit 1)``: given up counts as failed, a service that ended well as exited."""
    if sample.state is TaskState.FAILED and sample.detail == "exited with 0":
        return "exited (exit code 0)"
    if sample.state is TaskState.CRASHLOOP and sample.last_exit is not None:
        return f"failed ({sample.restarts} restarts, last exit {sample.last_exit})"
    return sample.state.value + (f" ({sample.detail})" if sample.detail else "")


def render_host_status(name: str, sample: HostSample | None, memory: ManagerState | None) -> Cell:
    """Whether a host answered, and how the operator closed it."""
    if sample is None:
        return Cell("not probed", "dim")
    closed = format_operator_mark(name, memory)
    word = "ok" if sample.ok else "unreachable"
    return Cell(
        f"{word}, {closed}" if closed else word, "bad" if not sample.ok else "warn" if closed else "good"
    )


def list_task_remarks(value: Snapshot) -> list[str]:
    """Of each failed task the last lines of its log and what starts it again, and of each task the limits that are not enforced."""
    tasks = [
        (f"{name} on {host}", sample)
        for host, each in value.hosts.items()
        for name, sample in each.tasks.items()
    ]
    said = [f"{where} said last: {line}" for where, sample in tasks for line in sample.log_tail]
    limits = [
        f"{where}: limits: {sample.limits}"
        for where, sample in tasks
        if sample.limits.startswith("not") and sample.state.alive
    ]
    return said + _list_given_up_notes(value) + limits


def _list_given_up_notes(value: Snapshot) -> list[str]:
    """How to mend each task that is not started again by itself, unless another copy lives."""
    runs = [(name, sample) for host in value.hosts.values() for name, sample in host.tasks.items()]
    alive = {name for name, sample in runs if sample.state.alive}
    over = dict.fromkeys(name for name, sample in runs if sample.given_up and name not in alive)
    return [
        f"{name} is given up; edgectl restart {name}, or a changed spec, starts it again" for name in over
    ]
