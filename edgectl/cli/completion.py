# SPDX-License-Identifier: Apache-2.0
"""Shell completion from local files; no host is contacted."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from edgectl.errors import EdgectlError

if TYPE_CHECKING:
    from edgectl.cli.project import ChosenFiles
    from edgectl.cli.selector import Labels
    from edgectl.model.task import Task

# The kinds of which get lists hosts, in all their forms.
_HOST_KINDS = frozenset(("hosts", "host", "h", "edges", "edge", "e", "robots", "robot", "r", "all"))


def complete_hosts(incomplete: str) -> list[str]:
    """Names of hosts in the inventory."""
    from edgectl.config.load import load_inventory

    try:
        names = list(load_inventory(_choose_named_files().inventories).hosts)
    except EdgectlError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def complete_tasks(incomplete: str) -> list[str]:
    """Names of tasks in the task files."""
    return [name for name in _load_named_tasks() if name.startswith(incomplete)]


def complete_entries(incomplete: str) -> list[str]:
    """Names of tasks, and of entries with for_each, which stand for all of their tasks."""
    tasks = _load_named_tasks()
    names = dict.fromkeys([*tasks, *(task.template for task in tasks.values())])
    return [name for name in names if name.startswith(incomplete)]


def complete_labels(incomplete: str) -> list[str]:
    """Labels of the tasks, or of the hosts that get lists, and those that follow from the files, as
    key=value; after a comma, one more.
    """
    done, comma, begun = incomplete.rpartition(",")
    words = _split_completed_line()
    hosts = "get" in words and not _HOST_KINDS.isdisjoint(words)
    labels = list(_list_host_labels()) if hosts else []
    if not hosts or "all" in words:
        labels += _list_task_labels()
    found = {
        f"{key}={value}"
        for each in labels
        for key, values in each.items()
        for value in ([values] if isinstance(values, str) else values)
    }
    return [done + comma + label for label in sorted(found) if label.startswith(begun)]


def _list_task_labels() -> "Iterable[Labels]":
    from edgectl.cli.task_names import label_task

    return map(label_task, _load_named_tasks().values())


def _list_host_labels() -> "Iterator[Labels]":
    from edgectl.config.load import load_inventory

    try:
        inventory = load_inventory(_choose_named_files().inventories)
    except EdgectlError:
        return
    for host in inventory.hosts.values():
        yield {"host": host.name, "kind": host.role.value, **host.labels}


def complete_weights(incomplete: str) -> list[str]:
    """Presets of weights."""
    from edgectl.model.policy import WEIGHT_PRESETS

    return [name for name in WEIGHT_PRESETS if name.startswith(incomplete)]


def complete_revisions(incomplete: str) -> list[str]:
    """Numbers of applied revisions, newest first."""
    from edgectl.config.load import load_inventory
    from edgectl.state.paths import get_fleet_path
    from edgectl.state.revisions import load_revisions

    try:
        fleet = load_inventory(_choose_named_files().inventories).fleet
        numbers = [str(revision.number) for revision in load_revisions(get_fleet_path(fleet))]
    except EdgectlError:
        return []
    return [number for number in reversed(numbers) if number.startswith(incomplete)]


def _load_named_tasks() -> "Mapping[str, Task]":
    """The tasks of the files; none where they cannot be read."""
    from edgectl.cli.user_files import list_task_files
    from edgectl.config.load import load_inventory_and_tasks

    try:
        chosen = _choose_named_files()
        return load_inventory_and_tasks(chosen.inventories, list_task_files(chosen))[1].tasks
    except EdgectlError:
        return {}


def complete_policies(incomplete: str) -> list[str]:
    """Names of policies, also of plugins."""
    from edgectl.model.policy import PolicyName
    from edgectl.usecases.ratings import list_policy_plugins

    names = [*PolicyName, *list_policy_plugins()]
    return [str(name) for name in names if name.startswith(incomplete)]


def complete_contexts(incomplete: str) -> list[str]:
    """Names of contexts in the project file and the user's configuration."""
    from edgectl.cli.project import load_settings

    try:
        names = load_settings().contexts
    except EdgectlError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def _choose_named_files() -> "ChosenFiles":
    """The files that the line being completed, or what stands behind it, names."""
    from edgectl.cli.project import choose_files

    context = _find_named_words("--context")
    return choose_files(
        [Path(word) for word in _find_named_words("-i", "--inventory")],
        [Path(word) for word in _find_named_words("-t", "--tasks")],
        context[-1] if context else None,
    )


def _find_named_words(*options: str) -> list[str]:
    """The values of an option on the line being completed."""
    words = _split_completed_line()
    long = [word.partition("=")[2] for word in words if word.partition("=")[0] in options and "=" in word]
    return [after for word, after in pairwise(words) if word in options] + long


def _split_completed_line() -> Sequence[str]:
    return (os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS") or "").split()
