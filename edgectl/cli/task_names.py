# SPDX-License-Identifier: Apache-2.0
"""Tasks as they are named on the command line: by name, by their entry with for_each, or by labels."""

from collections.abc import Iterable, Sequence

from edgectl.cli.selector import Labels, matches_selector
from edgectl.errors import UsageError
from edgectl.model.task import Task, Tasks
from edgectl.names import check_known_names, format_name_list


def expand_task_names(names: Iterable[str], tasks: Tasks) -> list[str]:
    """``names``, where the name of an entry with for_each stands for all of its tasks, each once."""
    found: dict[str, None] = {}
    for name in names:
        members = () if name in tasks.tasks else _list_entry_tasks(name, tasks)
        found |= dict.fromkeys(members or (name,))
    return list(found)


def resolve_task_name(name: str, tasks: Tasks) -> str:
    """The task ``name``, or the only one of the entry ``name``; an unknown name stays as it is.

    Raises:
        UsageError: the entry has several tasks.
    """
    members = () if name in tasks.tasks else _list_entry_tasks(name, tasks)
    if len(members) > 1:
        raise UsageError(
            f"{name} stands for {len(members)} tasks", hint=f"name one: {format_name_list(members)}"
        )
    return members[0] if members else name


def select_task_names(names: Sequence[str], selector: str | None, tasks: Tasks) -> list[str]:
    """The tasks of ``names`` and those that ``selector`` matches.

    Raises:
        UsageError: neither is given, the selector cannot be parsed, or it matches nothing.
    """
    if not names and selector is None:
        raise UsageError("name a task, or pass -l LABELS", hint="list tasks: edgectl get tasks")
    chosen = expand_task_names(names, tasks)
    if selector is not None:
        matching = [
            task.name for task in tasks.tasks.values() if matches_selector(selector, label_task(task))
        ]
        if not matching:
            raise UsageError(f"no task matches -l {selector}", hint="show labels: edgectl get tasks -o json")
        chosen += [name for name in matching if name not in chosen]
    return chosen


def check_task_names(names: Iterable[str], tasks: Tasks) -> None:
    """Check that each name is a task of the files, or an entry.

    Raises:
        UsageError: one is neither.
    """
    entries = (task.template for task in tasks.tasks.values())
    check_known_names(names, [*tasks.tasks, *entries], "task")


def label_task(task: Task) -> Labels:
    """The labels of a task, and those that follow from its file: task (its entry), kind, robot.

    Its own win.
    """
    implied: Labels = {"task": task.template, "kind": task.kind.value, "robot": tuple(task.robots)}
    return {**implied, **task.labels}


def _list_entry_tasks(name: str, tasks: Tasks) -> list[str]:
    return [task.name for task in tasks.tasks.values() if task.template == name]
