# SPDX-License-Identifier: Apache-2.0
"""Tasks on a machine that are not those of its host: of another fleet, or filed under another host name."""

from collections.abc import Collection, Iterable

from edgectl.formats.document import Document, without_none
from edgectl.model.snapshot import HostSample, OtherTask, Snapshot
from edgectl.names import natural_key
from edgectl.units import format_duration
from edgectl.views.glossary import head
from edgectl.views.notes import join_first_words, join_words
from edgectl.views.text import Cell, Row

_HEAD = head("fleet", "started_by", "host", "task", "state", "age_s")


def list_foreign_notes(value: Snapshot, names: Collection[str] | None = None) -> list[str]:
    """One line for each other fleet with living tasks on the hosts ``names`` (None: on any host).

    Several host names may be one machine, so a task is counted once.
    """
    found: dict[tuple[str, str], dict[OtherTask, None]] = {}
    hosts: dict[tuple[str, str], set[str]] = {}
    for name, host in value.hosts.items():
        for task in host.foreign_tasks if names is None or name in names else ():
            owner = task.fleet, task.started_by
            found.setdefault(owner, {})[_without_age(task)] = None
            hosts.setdefault(owner, set()).add(name)
    return [
        f"{join_words(sorted(hosts[owner], key=natural_key))}: {_describe_owner(*owner)} runs "
        f"{_name_tasks(found[owner])}; it is left alone, and counts as load except on a slice"
        for owner in sorted(found)
    ]


def describe_absence(task: str, value: Snapshot) -> str:
    """Note that no host that answers runs ``task``, with the other fleets that run one of this name."""
    unseen = f" that answers; no answer from {', '.join(value.silent_hosts)}" if value.silent_hosts else ""
    others = {
        f"that of fleet {each.fleet} on {host} is left alone"
        for host, sample in value.hosts.items()
        for each in sample.foreign_tasks
        if each.task == task and each.fleet
    }
    return "; ".join([f"{task} runs on no host{unseen}", *sorted(others)])


def _without_age(task: OtherTask) -> OtherTask:
    """``task`` as every host name of its machine reports it."""
    return OtherTask(
        fleet=task.fleet, host=task.host, task=task.task, state=task.state, instance=task.instance
    )


def _describe_owner(fleet: str, started_by: str) -> str:
    if not fleet:
        return "an edgectl before fleets"
    return f"fleet {fleet}" + (f" ({started_by})" if started_by else "")


def _name_tasks(tasks: Iterable[OtherTask]) -> str:
    return join_first_words(sorted({task.task for task in tasks}, key=natural_key))


def render_other_task_rows(host: HostSample) -> list[Row]:
    """A table of both kinds, without rows where there are none."""
    rows: list[Row] = [
        (
            Cell(each.fleet or "-", "name"),
            each.started_by or "-",
            each.host,
            each.task,
            each.state.value,
            format_duration(each.age_s),
        )
        for each in (*host.other_tasks, *host.foreign_tasks)
    ]
    return [_HEAD, *rows] if rows else []


def encode_other_tasks(tasks: tuple[OtherTask, ...]) -> list[Document] | None:
    """The tasks as JSON types; None where there are none."""
    return [
        without_none(
            fleet=each.fleet,
            host=each.host,
            task=each.task,
            state=each.state.value,
            started_by=each.started_by or None,
            age_s=each.age_s,
            instance=each.instance or None,
            spec_hash=each.spec_hash or None,
            generation=each.generation or None,
        )
        for each in tasks
    ] or None
