# SPDX-License-Identifier: Apache-2.0
"""Readers of ``events:`` in scenario and experiment files: what its keys say together, and of which fleet."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any

from edgectl.config.fields import Fields, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import Mark, ProblemCode, Problems
from edgectl.config.scalars import INVALID, NodeReader, check_name, report_wrong_type
from edgectl.experiments.files.event_keys import EXPERIMENT_EVENT_KEYS, SCENARIO_EVENT_KEYS
from edgectl.experiments.files.fleet_files import check_name_exists
from edgectl.experiments.model.mission_event import (
    ACT_CHANGE_KEYS,
    CHANGE_KEYS,
    MODEL_CHANGE_KEYS,
    TASK_CHANGE_KEYS,
    DemandChange,
    EventCommand,
    EventCondition,
    EventPrompt,
    HostLoad,
    LinkChange,
    MissionEvent,
    match_tasks,
)
from edgectl.experiments.model.scenario import SimJob
from edgectl.model.inventory import Inventory
from edgectl.model.resource import TASK_RESOURCES
from edgectl.model.task import Task, TaskKind, Tasks


def read_scenario_events(
    node: Node, inventory: Inventory, tasks: Tasks, jobs: Collection[SimJob], problems: Problems
) -> tuple[MissionEvent, ...]:
    """The events of a scenario, which change its model."""
    worked = {job.task for job in jobs}
    reader = _EventReader(
        inventory=inventory,
        tasks=tasks,
        problems=problems,
        table=SCENARIO_EVENT_KEYS,
        foreign=("run", "on", "undo", "deadline", "ask", "kind"),
        foreign_hint="a scenario has load, link, lost, demand, join and add",
        jobs=[job.name for job in jobs],
        completes=lambda task: task.name in worked,
        cannot_complete="has no job",
        progressing={tasks.tasks[name].robots[0] for name in worked if len(tasks.tasks[name].robots) == 1},
    )
    return tuple(reader.read_events(node))


def read_experiment_events(
    node: Node, inventory: Inventory, tasks: Tasks, problems: Problems
) -> tuple[MissionEvent, ...]:
    """The events of an experiment: commands, requests to a person, and tasks that enter."""
    reader = _EventReader(
        inventory=inventory,
        tasks=tasks,
        problems=problems,
        table=EXPERIMENT_EVENT_KEYS,
        foreign=MODEL_CHANGE_KEYS,
        foreign_hint="an experiment changes it by a command: run: [..], with kind: {key}",
        completes=can_complete,
        cannot_complete="never completes",
        progressing={robot.name for robot in inventory.robots},
    )
    return tuple(reader.read_events(node))


def can_complete(task: Task) -> bool:
    """Whether a real task ever completes, as edgectl sees it."""
    return task.managed and (task.kind is TaskKind.JOB or task.done_when is not None)


class _EventReader:
    """The events of one file, and the checks that need the fleet."""

    def __init__(
        self,
        *,
        inventory: Inventory,
        tasks: Tasks,
        problems: Problems,
        table: Mapping[str, NodeReader],
        foreign: Iterable[str],
        foreign_hint: str,
        completes: Callable[[Task], bool],
        cannot_complete: str,
        progressing: Collection[str],
        jobs: Collection[str] = (),
    ) -> None:
        self.inventory, self.tasks, self.problems = inventory, tasks, problems
        self.table, self.foreign_hint = table, foreign_hint
        self.reading_table = {**table, **{key: self._refuse_foreign(key) for key in foreign}}
        self.completes, self.cannot_complete = completes, cannot_complete
        self.progressing, self.jobs = progressing, jobs

    def _refuse_foreign(self, key: str) -> NodeReader:
        def refuse(node: Node, problems: Problems) -> Any:  # noqa: ANN401
            hint = self.foreign_hint.format(key=key)
            problems.add(node.mark, ProblemCode.UNKNOWN_KEY, f"{key} does not belong in this file", hint)
            return INVALID

        return refuse

    def read_events(self, node: Node) -> Iterator[MissionEvent]:
        """The events without faults."""
        if not isinstance(node.value, dict):
            hint = "write far: {at: 30s, join: robot1}"
            report_wrong_type(node, self.problems, "events must be a mapping by name", hint)
            return
        for name, inner in node.value.items():
            before = len(self.problems.errors)
            check_name(name, node, self.problems, "an event")
            fields = read_fields(inner, self.problems, self.reading_table, what="an event")
            if not isinstance(inner.value, dict):
                continue
            change = self._check_form(fields, node.key_mark(name))
            condition = self._read_condition(fields.values["when"]) if "when" in fields.values else None
            if change is None or change not in fields.values:
                continue
            value = _CHANGE_BUILDERS[change](self, fields)
            if len(self.problems.errors) == before:
                yield _build_event(name, fields, condition, change, value)

    def _check_form(self, fields: Fields, mark: Mark) -> str | None:
        """Check what the keys say together; the key of the change."""
        given = fields.node.value if isinstance(fields.node.value, dict) else {}
        add = self.problems.add
        if "at" not in given and "when" not in given:
            add(mark, ProblemCode.MISSING, "an event needs at or when", "add at: 30s, or when: {..}")
        if "at" in given and "when" in given:
            self._contradict(fields, "when", "an event has at or when, not both", "remove one of them")
        known = [key for key in CHANGE_KEYS if key in self.table]
        changes = [key for key in given if key in known]
        if not changes and all(key in self.table for key in given):
            add(mark, ProblemCode.MISSING, "an event needs a change", f"add one of {', '.join(known)}")
        for key in changes[1:]:
            self._contradict(
                fields, key, f"an event has one change, not {changes[0]} and {key}", "make two events"
            )
        self._check_repetition(fields)
        if changes:
            self._check_undo(fields, changes[0])
        return changes[0] if len(changes) == 1 else None

    def _contradict(self, fields: Fields, key: str, message: str, hint: str) -> None:
        self.problems.add(fields.node.key_mark(key), ProblemCode.CONTRADICTION, message, hint)

    def _check_repetition(self, fields: Fields) -> None:
        values = fields.values
        if "times" in fields and "every" not in fields:
            self._contradict(fields, "times", "times without every", "add every: 60s")
        lasts = values.get("for", 0.0) + values.get("jitter", 0.0)
        if "every" in values and values.get("times") != 1 and lasts > values["every"]:
            message = "for and jitter together are longer than every, so that it would happen twice at once"
            self._contradict(fields, "every", message, "lengthen every, or shorten for or jitter")

    def _check_undo(self, fields: Fields, change: str) -> None:
        """What cannot be undone is neither ended nor repeated; a command can if its undo is stated."""
        if change in TASK_CHANGE_KEYS:
            for key in ("for", "every"):
                if key in fields:
                    self._contradict(fields, key, f"{change} happens once and is not undone", f"remove {key}")
        if change == "ask" and "for" in fields:
            self._contradict(
                fields, "for", "a request to a person has no end", "add a second event that asks"
            )
        if change == "run" and "for" in fields and "undo" not in fields:
            self._contradict(fields, "for", "nothing ends this change", 'add undo: ["program", "argument"]')
        for key, of in (
            ("on", ("run",)),
            ("undo", ("run",)),
            ("kind", ACT_CHANGE_KEYS),
            ("deadline", ACT_CHANGE_KEYS),
        ):
            if key in self.table and key in fields and change not in of:
                self._contradict(fields, key, f"{key} belongs to {' or '.join(of)}", f"remove {key}")

    def _read_condition(self, fields: Fields) -> EventCondition:
        values = fields.values
        if isinstance(fields.node.value, dict) and not fields.node.value:
            hint = "write completed: [TASK], placed: [TASK] or progress: {robot: .., reaches: 50%}"
            self.problems.add(fields.node.mark, ProblemCode.MISSING, "when needs a condition", hint)
        progress = values.get("progress")
        if progress is not None:
            at = fields.at("progress").inner("robot")
            robots = [robot.name for robot in self.inventory.robots]
            if self._check(at, progress.robot, robots, "robot") and progress.robot not in self.progressing:
                hint = "name a robot with a job of a task that serves it alone"
                self.problems.add(
                    at.mark, ProblemCode.CONTRADICTION, f"{progress.robot} has no job, so no progress", hint
                )
        for name, node in values.get("jobs", ()):
            self._check(node, name, self.jobs, "job")
        return EventCondition(
            completed=tuple(self._expand(values.get("completed", ()), completing=True)),
            placed=tuple(self._expand(values.get("placed", ()))),
            jobs=tuple(name for name, _ in values.get("jobs", ())),
            progress=progress,
        )

    def _expand(self, entries: Iterable[tuple[str, Node]], *, completing: bool = False) -> Iterator[str]:
        for name, node in entries:
            for task in self.find_tasks(node, name):
                if completing and not self.completes(self.tasks.tasks[task]):
                    message = f"{task} {self.cannot_complete}, so that this never holds"
                    self.problems.add(
                        node.mark, ProblemCode.CONTRADICTION, message, "name a task that completes"
                    )
                yield task

    def find_tasks(self, node: Node, name: str) -> list[str]:
        """The tasks of a name or template; a problem where there are none."""
        found = match_tasks(name, self.tasks)
        return found if found or self._check(node, name, self.tasks.tasks, "task") else []

    def _check(self, node: Node, word: str, known: Collection[str], what: str) -> bool:
        return check_name_exists(node, word, known, what, self.problems)

    def build_load(self, fields: Fields) -> HostLoad:
        """Build the value of ``load``."""
        load: Fields = fields.values["load"]
        self._check(load.at("host"), load.values["host"], self.inventory.hosts, "host")
        self._require_amount(load, ("cpu", "memory"), "a load needs cpu or memory", "add cpu: 1")
        return HostLoad(**load.values)

    def build_link(self, fields: Fields) -> LinkChange:
        """Build the value of ``link``."""
        link: Fields = fields.values["link"]
        edges = [host.name for host in self.inventory.edges]
        robots = [host.name for host in self.inventory.robots]
        self._check(link.at("edge"), link.values["edge"], edges, "edge")
        self._check(link.at("robot"), link.values["robot"], robots, "robot")
        self._require_amount(
            link,
            ("throughput", "delay"),
            "a change of a link needs throughput or delay",
            "add throughput: 1.6Mbit/s",
        )
        return LinkChange(**link.values)

    def build_demand(self, fields: Fields) -> DemandChange:
        """Build the value of ``demand``."""
        demand: Fields = fields.values["demand"]
        self._check(demand.at("task"), demand.values["task"], self.tasks.tasks, "task")
        keys = [resource.demand_key for resource in TASK_RESOURCES]
        self._require_amount(demand, keys, f"a demand needs {', '.join(keys)}, or one of them", "add cpu: 1")
        return DemandChange(
            task=demand.values["task"],
            demand={
                resource.name: demand.values[resource.demand_key]
                for resource in TASK_RESOURCES
                if resource.demand_key in demand.values
            },
        )

    def _require_amount(self, fields: Fields, keys: Iterable[str], message: str, hint: str) -> None:
        given = fields.node.value if isinstance(fields.node.value, dict) else {}
        if not any(key in given for key in keys) and all(key in fields.values for key in given):
            self.problems.add(fields.node.mark, ProblemCode.MISSING, message, hint)

    def build_lost(self, fields: Fields) -> str:
        """Build the value of ``lost``."""
        return self._name_of(fields, "lost", self.inventory.hosts, "host")

    def build_join(self, fields: Fields) -> str:
        """Build the value of ``join``."""
        return self._name_of(fields, "join", [robot.name for robot in self.inventory.robots], "robot")

    def _name_of(self, fields: Fields, key: str, known: Collection[str], what: str) -> str:
        name: str = fields.values[key]
        self._check(fields.at(key), name, known, what)
        return name

    def build_addition(self, fields: Fields) -> str:
        """Build the value of ``add``."""
        name: str = fields.values["add"]
        self.find_tasks(fields.at("add"), name)
        return name

    def build_command(self, fields: Fields) -> EventCommand:
        """Build the value of ``run``."""
        values = fields.values
        if "on" in values:
            self._name_of(fields, "on", self.inventory.hosts, "host")
        given = {key: values[key] for key in ("on", "undo", "deadline") if key in values}
        return EventCommand(argv=values["run"], **given)

    def build_prompt(self, fields: Fields) -> EventPrompt:
        """Build the value of ``ask``."""
        given = {key: fields.values[key] for key in ("deadline",) if key in fields.values}
        return EventPrompt(text=fields.values["ask"], **given)


_CHANGE_BUILDERS: Mapping[str, Callable[[_EventReader, Fields], Any]] = {
    "load": _EventReader.build_load,
    "link": _EventReader.build_link,
    "lost": _EventReader.build_lost,
    "demand": _EventReader.build_demand,
    "join": _EventReader.build_join,
    "add": _EventReader.build_addition,
    "run": _EventReader.build_command,
    "ask": _EventReader.build_prompt,
}


def _build_event(
    name: str,
    fields: Fields,
    condition: EventCondition | None,
    change: str,
    value: Any,  # noqa: ANN401
) -> MissionEvent:
    values = fields.values
    given = {key: values[key] for key in ("at", "every", "times", "jitter", "kind") if key in values}
    return MissionEvent(name=name, when=condition, duration=values.get("for"), **given, **{change: value})
