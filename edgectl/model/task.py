# SPDX-License-Identifier: Apache-2.0
"""Tasks with their demands, order constraints and commands."""

import posixpath
import re
from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.check import AliveRule, Check
from edgectl.model.demand import Demand
from edgectl.model.image import ContainerImage
from edgectl.model.latency import HeardRule, LatencyRule
from edgectl.model.policy import Policy
from edgectl.model.predicted_latency import JobSize, ServiceTime
from edgectl.model.standby import Activation, StandbyRule, StateRule

_NODE_NAME = re.compile(r"(?:^|\s)__(?:name|node):=(\S+)")
_NODE_NAMESPACE = re.compile(r"(?:^|\s)__ns:=(\S+)")


class TaskKind(StrEnum):
    """A service runs until stopped; a job completes when it exits with 0."""

    SERVICE = "service"
    JOB = "job"


class NeedCondition(StrEnum):
    """State that a predecessor must reach before its successor may start."""

    RUNNING = "running"
    READY = "ready"
    COMPLETED = "completed"


class OnboardRule(StrEnum):
    """Whether the task's own robot is a candidate host."""

    ALLOW = "allow"
    NEVER = "never"
    ONLY = "only"


class RestartPolicy(StrEnum):
    """Condition under which the supervisor starts the command again."""

    ALWAYS = "always"
    ON_FAILURE = "on-failure"
    NEVER = "never"


class HandoffOrder(StrEnum):
    """Which instance goes first in a move."""

    STOP_FIRST = "stop-first"
    START_FIRST = "start-first"


class UnreachablePolicy(StrEnum):
    """Treatment of a task whose host does not answer."""

    HOLD = "hold"
    REPLACE = "replace"


class NeedRestart(StrEnum):
    """Whether a task restarts because a predecessor was restarted."""

    WITH = "with"


@dataclass(frozen=True, slots=True, kw_only=True)
class Need:
    """An order constraint: ``task`` (an expanded name) must be at least ``until``.

    ``restart``: ``with`` restarts the task after a restart of its predecessor; None: it runs on.
    """

    task: str
    until: NeedCondition = NeedCondition.READY
    restart: NeedRestart | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StopRule:
    """Stop procedure of a task: ``signal`` to the tree, ``grace`` seconds, then KILL.

    Preset ``ros``: INT to the main process first.
    """

    signal: str = "TERM"
    grace: float = 20.0
    preset: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HandoffContract:
    """The contract of a move; each hook is a command on the robot unless its ``on`` says host."""

    order: HandoffOrder = HandoffOrder.STOP_FIRST
    safe_when: Check | None = None
    hold: Check | None = None
    release: Check | None = None
    timeout: float = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HostRules:
    """Which hosts may run the task.

    Empty ``only`` means any; every label must match; ``pin`` is a hard constraint.
    """

    only: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    labels: Mapping[str, str] = field(default_factory=dict)
    pin: str | None = None

    def allow(self, host: str, labels: Mapping[str, str]) -> bool:
        """Whether the host of this name and with these labels may run the task."""
        if self.pin is not None:
            return host == self.pin
        named = host not in self.never and (not self.only or host in self.only)
        return named and all(labels.get(key) == value for key, value in self.labels.items())


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectRule:
    """Pattern of a task that edgectl did not start: a regular expression over command lines, or a ROS node's
    name.
    """

    cmdline: str | None = None
    ros_node: str | None = None


class NothingFits(StrEnum):
    """What a task does for which no host has room: wait for it, or run on the best host all the same."""

    WAIT = "wait"
    BEST_EFFORT = "best-effort"


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskLimits:
    """Caps that the runtime enforces where it can: cores and bytes. None: no cap."""

    cpu: float | None = None
    memory: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LogLimits:
    """Bound of a task's log: ``files`` files of at most ``max_size`` bytes."""

    max_size: float = 10 * 2**20
    files: int = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One task after expansion.

    ``template`` is its name in the file; ``spec_hash`` changes when what runs would change. ``robots`` are
    the robots it serves (links count for each); ``priority`` high first; ``deadline`` in seconds, the
    bound of its latency; ``hard_deadline``: it goes only where that is kept. Entries of
    ``env`` may be ``Secret``; ``env_command`` is an argument vector that prints more of them as lines
    NAME=value. ``spec_fields``: short hash of each field that ``spec_hash`` covers. ``self_fence``: its
    supervisor stops it when no request of a manager has reached the host for so many seconds; None: never.
    ``preempt``: it may take the room of tasks of lower priority, which are then stopped. ``apart`` and
    ``together``: tasks (expanded names) that must not, or must, share its host. ``spread``: "host" or the key
    of a label over whose values the tasks of its entry are shared out evenly. ``group``: tasks that are only
    started all together. ``up``: without
    ``ready``, how long (s) the command must have run until it counts as ready; None: the default.
    ``if_nothing_fits``: what it does where no host has room, as ``Policy.best_effort`` for all tasks.
    ``downtime_cost``: utility lost per second of downtime, 0 or more; weighed once downtimes are measured.
    ``alive``: asked while the task runs, and for readiness too where ``ready`` is not stated.
    ``service_time`` of a job by class of hosts, "" for every class; ``job``: the bytes of one.
    ``latency``: where its latency is measured; ``heard``: how its robot notices it.
    ``image``: the container that it runs in; ``command`` may be empty then, and the image's own is run.
    ``standby``: other hosts keep an inactive copy of it; ``state``: what a move takes along.
    ``file``: the task file that lists it (ADR 0039); it is no part of any digest.
    """

    name: str
    template: str
    command: str
    spec_hash: str
    demand: Demand = Demand()
    robots: tuple[str, ...] = ()
    needs: tuple[Need, ...] = ()
    priority: float = 0.0
    preempt: bool = False
    if_nothing_fits: NothingFits = NothingFits.WAIT
    apart: tuple[str, ...] = ()
    together: tuple[str, ...] = ()
    spread: str | None = None
    group: str | None = None
    deadline: float | None = None
    hard_deadline: bool = False
    latency: LatencyRule | None = None
    heard: HeardRule | None = None
    service_time: Mapping[str, ServiceTime] = field(default_factory=dict)
    job: JobSize = JobSize()
    hosts: HostRules = HostRules()
    onboard: OnboardRule = OnboardRule.ALLOW
    managed: bool = True
    detect: DetectRule | None = None
    kind: TaskKind = TaskKind.SERVICE
    ready: Check | None = None
    up: float | None = None
    alive: AliveRule | None = None
    done_when: Check | None = None
    stop: StopRule = StopRule()
    restart: RestartPolicy = RestartPolicy.ON_FAILURE
    handoff: HandoffContract = HandoffContract()
    standby: StandbyRule | None = None
    state: StateRule | None = None
    image: ContainerImage | None = None
    env: Mapping[str, str] = field(default_factory=dict)
    workdir: str | None = None
    limits: TaskLimits = TaskLimits()
    log: LogLimits = LogLimits()
    on_unreachable: UnreachablePolicy = UnreachablePolicy.HOLD
    replace_after: float = 120.0
    self_fence: float | None = None
    downtime_cost: float = 10.0
    labels: Mapping[str, str] = field(default_factory=dict)
    env_command: tuple[str, ...] = ()
    spec_fields: Mapping[str, str] = field(default_factory=dict)
    file: str = ""

    @property
    def host_workdir(self) -> str | None:
        """Directory of its commands on a host: ``workdir`` is one in the container where it has an image."""
        return self.workdir if self.image is None else None

    @property
    def activation(self) -> Activation | None:
        """How its instances become active; None: an instance is active from its start."""
        return self.standby.activation if self.standby is not None else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Tasks:
    """All tasks of the task files, by expanded name in natural order, and the policy that the files state.

    ``files``: the files that were read, and ``folders``: the directories that were given whole (ADR 0039).
    """

    tasks: Mapping[str, Task]
    policy: Policy = Policy()
    digest: str = ""
    files: frozenset[str] = frozenset()
    folders: frozenset[str] = frozenset()

    def is_given(self, file: str) -> bool:
        """Whether the task file ``file`` was given, by itself or by its directory; "" is not known."""
        return file in self.files or (file != "" and (posixpath.dirname(file) or ".") in self.folders)


def join_units(tasks: Mapping[str, Task]) -> dict[str, tuple[str, ...]]:
    """The tasks that share a host by ``together``, directly or through others, by each of them.

    In the order of ``tasks``; names that are not in it are ignored.
    """
    units: dict[str, list[str]] = {}
    for name, task in tasks.items():
        for other in task.together:
            if other in tasks and units.get(name, [name]) is not units.get(other):
                joined = [*units.get(name, [name]), *units.get(other, [other])]
                units |= dict.fromkeys(joined, joined)
    rank = {name: index for index, name in enumerate(tasks)}
    ordered = {id(unit): tuple(sorted(unit, key=rank.__getitem__)) for unit in units.values()}
    return {name: ordered[id(unit)] for name, unit in units.items()}


def list_node_names(task: Task) -> tuple[str, ...]:
    """The ROS nodes of a task: those that its command names, and the one that must be alive.

    Nodes of a launch file are not known here.
    """
    spaces = _NODE_NAMESPACE.findall(task.command)
    space = spaces[0].strip("/") if len(spaces) == 1 else ""
    names = [
        "/" + "/".join(part for part in (space, name.strip("/")) if part)
        for name in _NODE_NAME.findall(task.command)
    ]
    ros = task.alive.check.ros if task.alive is not None else None
    return tuple(dict.fromkeys([*names, *([ros.node] if ros is not None and ros.node else [])]))
