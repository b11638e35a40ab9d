"""How a task's state is told: one phrase, and below the table what a failed task said last and which limits do not hold."""

from edgectl.model.memory import Memory
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.views.absent import standing
from edgectl.views.text import Cell

STATES = {
    TaskState.READY: "good", TaskState.RUNNING: "good", TaskState.STARTING: "warn", TaskState.COMPLETED: "dim",
    TaskState.FAILED: "bad", TaskState.CRASHLOOP: "bad",
}  # fmt: skip


def phrase(sample: TaskSample) -> str:
    """Such as ``ready`` or ``failed (5 restarts, last exit 1)``: given up counts as failed, a service that ended well as exited."""
    if sample.state is TaskState.FAILED and sample.detail == "exited with 0":
        return "exited (exit code 0)"
    if sample.state is TaskState.CRASHLOOP and sample.last_exit is not None:
        return f"failed ({sample.restarts} restarts, last exit {sample.last_exit})"
    return sample.state.value + (f" ({sample.detail})" if sample.detail else "")


def host_status(name: str, sample: HostSample | None, memory: Memory | None) -> Cell:
    """Whether a host answered, and how the operator closed it."""
    if sample is None:
        return Cell("not probed", "dim")
    closed = standing(name, memory)
    word = "ok" if sample.ok else "unreachable"
    return Cell(f"{word}, {closed}" if closed else word, "bad" if not sample.ok else "warn" if closed else "good")


def remarks(value: Snapshot) -> list[str]:
    """Of each failed task the last lines of its log and what starts it again, and of each task the limits that are not enforced."""
    tasks = [(f"{name} on {host}", sample) for host, each in value.hosts.items() for name, sample in each.tasks.items()]
    said = [f"{where} said last: {line}" for where, sample in tasks for line in sample.log_tail]
    limits = [f"{where}: limits: {sample.limits}" for where, sample in tasks if sample.limits.startswith("not") and sample.state.alive]
    return said + _given_up(value) + limits


def _given_up(value: Snapshot) -> list[str]:
    """How to mend each task that is not started again by itself, unless another copy lives."""
    runs = [(name, sample) for host in value.hosts.values() for name, sample in host.tasks.items()]
    alive = {name for name, sample in runs if sample.state.alive}
    over = dict.fromkeys(name for name, sample in runs if sample.given_up and name not in alive)
    return [f"{name} is given up; edgectl restart {name}, or a changed spec, starts it again" for name in over]
