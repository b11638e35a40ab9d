"""State of a task that a person or a script waits for."""

from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.task import Task
from edgectl.rules.lost_places import list_lost_tasks


class AwaitedState(StrEnum):
    """What is waited for: a ready instance, the completion, or that no instance is left."""

    READY = "ready"
    COMPLETED = "completed"
    GONE = "gone"


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskProgress:
    """How far ``task`` is: ``reached`` what is waited for, or ``failed``, so that waiting is in vain.

    ``state``: what was seen of it, on ``host`` where that is known.
    """

    task: str
    reached: bool
    state: str
    host: str | None = None
    failed: bool = False


def find_progress(name: str, task: Task | None, awaited: AwaitedState, snapshot: Snapshot) -> TaskProgress:
    """How far the task ``name`` is; ``task`` is None where no file lists it."""
    manager = snapshot.manager or ManagerState()
    found = _find_samples(name, snapshot)
    if not found:
        return _find_progress_of_absent(name, task, awaited, snapshot)
    host, sample = found[0]
    done = task is not None and manager.done.get(name) == task.spec_hash
    reached = {
        AwaitedState.READY: sample.state is TaskState.READY or _runs_unchecked(task, sample),
        AwaitedState.COMPLETED: sample.state is TaskState.COMPLETED or (done and not sample.state.alive),
        AwaitedState.GONE: not any(each.state.alive for _, each in found) and not _may_run(name, snapshot),
    }[awaited]
    return TaskProgress(
        task=name,
        reached=reached,
        state=sample.state.value,
        host=host,
        failed=not reached and awaited is not AwaitedState.GONE and _has_failed(sample),
    )


def _find_samples(name: str, snapshot: Snapshot) -> list[tuple[str, TaskSample]]:
    """The samples of the task with their hosts: those that live first, then the latest start."""
    found = [(host, each.tasks[name]) for host, each in snapshot.hosts.items() if name in each.tasks]
    return sorted(found, key=lambda place: (not place[1].state.alive, -place[1].generation))


def _runs_unchecked(task: Task | None, sample: TaskSample) -> bool:
    """Whether it runs and nothing asks whether it is ready."""
    return sample.state is TaskState.RUNNING and (task is None or task.ready is None)


def _has_failed(sample: TaskSample) -> bool:
    """Whether its host has given it up."""
    return sample.given_up or sample.state is TaskState.FAILED


def _find_progress_of_absent(
    name: str, task: Task | None, awaited: AwaitedState, snapshot: Snapshot
) -> TaskProgress:
    manager = snapshot.manager or ManagerState()
    if task is not None and manager.done.get(name) == task.spec_hash:
        return TaskProgress(task=name, reached=awaited is not AwaitedState.READY, state="completed")
    if _may_run(name, snapshot):
        placement = manager.placements.get(name)
        where = placement.host if placement is not None else None
        return TaskProgress(task=name, reached=False, state="unknown", host=where)
    return TaskProgress(task=name, reached=awaited is AwaitedState.GONE, state="not running")


def _may_run(name: str, snapshot: Snapshot) -> bool:
    """Whether it may run where nobody answers: its last host is silent, or its last place is lost."""
    manager = snapshot.manager or ManagerState()
    placement = manager.placements.get(name)
    silent = placement is not None and placement.host in snapshot.silent_hosts
    return silent or name in list_lost_tasks(snapshot)
