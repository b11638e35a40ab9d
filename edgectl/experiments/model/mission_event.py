# SPDX-License-Identifier: Apache-2.0
"""Events of a mission: what changes, when, how often; and the record of what happened."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from edgectl.model.encoding import Bounds, FromOne, Positive, Rounded, in_document
from edgectl.model.task import NeedCondition, Tasks

Time = Annotated[float, Rounded(decimals=3)]
Fraction = Annotated[float, Bounds(above=True, maximum=1.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class HostLoad:
    """Load of a stranger on ``host``: cores that it would use alone, and bytes."""

    host: str
    cpu: float = 0.0
    memory: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkChange:
    """What a link carries in bytes/s, and what is added to its round trips in s; None: as before."""

    edge: str
    robot: str
    throughput: float | None = None
    delay: float | None = field(default=None, metadata=in_document("delay_s"))


@dataclass(frozen=True, slots=True, kw_only=True)
class DemandChange:
    """What a task needs from now on, whatever its file states; ``demand``: by resource, in its unit."""

    task: str
    demand: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCommand:
    """An argument vector for the host ``on``, or the manager ("").

    ``undo``: the vector that ends the change; () for none. ``deadline``: of each of the two, in s.
    """

    argv: tuple[str, ...]
    on: str = ""
    undo: tuple[str, ...] = ()
    deadline: Positive = field(default=30.0, metadata=in_document("deadline_s", always=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class EventPrompt:
    """A request to a person, who confirms it within ``deadline`` s."""

    text: str
    deadline: Positive = field(default=30.0, metadata=in_document("deadline_s", always=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotProgress:
    """The share of its mission, above 0 to 1, that ``robot`` has done."""

    robot: str
    reaches: Fraction


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCondition:
    """What must hold, all of it: tasks that have completed, tasks that run, simulated jobs that are done."""

    completed: tuple[str, ...] = ()
    placed: tuple[str, ...] = ()
    jobs: tuple[str, ...] = ()
    progress: RobotProgress | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionEvent:
    """One change, at ``at`` s after the start of the mission, or once ``when`` holds for the first time.

    It is repeated every ``every`` s, ``times`` times in all (None: until the mission ends), each time up to
    ``jitter`` s later, and undone after ``duration`` s (None: never). Exactly one of the fields in
    `CHANGE_KEYS` is stated. ``kind``: what a command or a person brings about; "" for the key itself.
    """

    name: str
    at: Time | None = field(default=None, metadata=in_document("at_s"))
    when: EventCondition | None = None
    every: Positive | None = field(default=None, metadata=in_document("every_s"))
    times: FromOne | None = None
    jitter: Time = field(default=0.0, metadata=in_document("jitter_s"))
    duration: Positive | None = field(default=None, metadata=in_document("for_s"))
    load: HostLoad | None = None
    link: LinkChange | None = None
    lost: str | None = None
    join: str | None = None
    demand: DemandChange | None = None
    add: str | None = None
    run: EventCommand | None = None
    ask: EventPrompt | None = None
    kind: str = ""

    @property
    def change(self) -> str:
        """The key of the change."""
        return next(key for key in CHANGE_KEYS if getattr(self, key) is not None)

    @property
    def occurrences(self) -> int | None:
        """How often it happens at most; None: until the mission ends."""
        return self.times if self.every is not None else 1

    @property
    def subject(self) -> str:
        """The host, link or task that it changes; the program or the text where edgectl cannot know."""
        value = getattr(self, self.change)
        return value if isinstance(value, str) else _SUBJECTS[self.change](value)


_SUBJECTS: Mapping[str, Callable[[Any], str]] = {
    "load": lambda load: load.host,
    "link": lambda link: f"{link.edge}-{link.robot}",
    "demand": lambda demand: demand.task,
    "run": lambda run: run.on or run.argv[0],
    "ask": lambda ask: ask.text,
}
# Changes of a scenario alone, of both, of an experiment alone.
MODEL_CHANGE_KEYS = ("load", "link", "lost", "demand")
TASK_CHANGE_KEYS = ("join", "add")
ACT_CHANGE_KEYS = ("run", "ask")
CHANGE_KEYS = (*MODEL_CHANGE_KEYS, *TASK_CHANGE_KEYS, *ACT_CHANGE_KEYS)


@dataclass(frozen=True, slots=True, kw_only=True)
class EventRecord:
    """A change that happened ``at`` s after the start of the mission, and was undone at ``until``.

    ``until``: None where it was not undone. ``error``: why it was not made, or not undone. ``tasks``: those
    that begin with it.
    """

    event: str
    kind: str
    subject: str
    at: Time = field(metadata=in_document("at_s"))
    until: Time | None = field(default=None, metadata=in_document("until_s"))
    error: str = ""
    tasks: tuple[str, ...] = ()


def begin_record(event: MissionEvent, at: float, tasks: Tasks) -> EventRecord:
    """The record of an occurrence that begins ``at`` s after the start of the mission; ``tasks``: all.

    A task that waits until another has completed, or for a task that does, begins later than it enters.
    """
    present = select_present_tasks(tasks, (event,), ()).tasks
    return EventRecord(
        event=event.name,
        kind=event.kind or event.change,
        subject=event.subject,
        at=at,
        tasks=tuple(name for name in tasks.tasks if name not in present and _can_begin(name, tasks)),
    )


def _can_begin(name: str, tasks: Tasks) -> bool:
    """Whether the task begins as soon as the tasks that it needs run."""
    return all(
        need.until is not NeedCondition.COMPLETED and _can_begin(need.task, tasks)
        for need in tasks.tasks[name].needs
    )


def match_tasks(name: str, tasks: Tasks) -> list[str]:
    """The task of this name, or all of the template of this name."""
    return [task.name for task in tasks.tasks.values() if name in (task.name, task.template)]


def select_present_tasks(tasks: Tasks, events: Collection[MissionEvent], happened: Collection[str]) -> Tasks:
    """``tasks`` without those that wait for an event of which the name is not in ``happened``.

    A robot that has not joined keeps back all tasks that serve it, and a task that is not added yet itself;
    both also keep back what needs one of these tasks.
    """
    waiting = [event for event in events if event.name not in happened]
    robots = {event.join for event in waiting if event.join is not None}
    absent = {
        name for event in waiting if event.add is not None for name in match_tasks(event.add, tasks)
    } | {task.name for task in tasks.tasks.values() if not robots.isdisjoint(task.robots)}
    if not absent:
        return tasks
    while more := {
        task.name
        for task in tasks.tasks.values()
        if task.name not in absent and any(need.task in absent for need in task.needs)
    }:
        absent |= more
    return replace(tasks, tasks={name: task for name, task in tasks.tasks.items() if name not in absent})
