# SPDX-License-Identifier: Apache-2.0
"""The state of the fleet as statuses of diagnostic_msgs: one for the fleet, each host and each task."""

from edgectl.formats.document import Document
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState, find_doubled_tasks
from edgectl.model.task import Task, Tasks
from edgectl.rules.lost_places import describe_lost_place
from edgectl.views.encoder import flatten_row, round_numbers
from edgectl.views.notes import join_words
from edgectl.views.rows import encode_absent_row, encode_host_row, encode_run_row, find_task_demand
from edgectl.views.state import (
    find_failed_tasks,
    format_operator_mark,
    format_silence,
    format_task_state,
    resolve_absent_task,
)

# The levels of diagnostic_msgs/DiagnosticStatus.
OK, WARN, ERROR, STALE = range(4)
_LEVELS = {TaskState.UNHEALTHY: WARN, TaskState.FAILED: ERROR, TaskState.CRASHLOOP: ERROR}


def encode_diagnostics(snapshot: Snapshot, inventory: Inventory, tasks: Tasks) -> list[Document]:
    """The statuses: ``name``, ``level``, ``message``, ``hardware_id`` and ``values`` (texts by key)."""
    fleet = inventory.fleet
    hosts = [_encode_host(fleet, name, snapshot, inventory) for name in snapshot.hosts]
    seen = {task for each in snapshot.hosts.values() for task in each.tasks}
    found = [
        _encode_task(fleet, name, snapshot, inventory, tasks) for name in sorted(seen | tasks.tasks.keys())
    ]
    return [_encode_fleet(fleet, [*hosts, *found]), *hosts, *found]


def _encode_fleet(fleet: str, parts: list[Document]) -> Document:
    """The worst of all; what is not known is a warning here."""
    levels = [each["level"] for each in parts]
    level = ERROR if ERROR in levels else WARN if WARN in levels or STALE in levels else OK
    counted = {"ok": OK, "warnings": WARN, "errors": ERROR, "unknown": STALE}
    text = ", ".join(f"{levels.count(number)} {word}" for word, number in counted.items() if number in levels)
    return _build_status(fleet, "fleet", level, text, fleet, {})


def _encode_host(fleet: str, name: str, snapshot: Snapshot, inventory: Inventory) -> Document:
    sample = snapshot.hosts[name]
    mark = format_operator_mark(name, snapshot.manager)
    if sample.ok:
        level, text = (WARN, mark) if mark else (OK, "ok")
    else:
        level, text = ERROR, ": ".join(part for part in (mark or "unreachable", sample.error) if part)
    row = encode_host_row(name, snapshot, inventory.hosts.get(name))
    return _build_status(fleet, f"host {name}", level, text, name, row)


def _encode_task(fleet: str, name: str, snapshot: Snapshot, inventory: Inventory, tasks: Tasks) -> Document:
    runs = [(host, each.tasks[name]) for host, each in snapshot.hosts.items() if name in each.tasks]
    if not runs:
        return _encode_absent_task(fleet, tasks.tasks[name], snapshot)
    host, sample = max(runs, key=lambda run: (run[1].state.alive, run[1].generation))
    level, text = _judge_run(name, host, sample, snapshot, tasks)
    demand = find_task_demand(name, host, snapshot, inventory, tasks)
    row = encode_run_row(name, host, sample, demand, snapshot)
    return _build_status(fleet, f"task {name}", level, text, host, row)


def _judge_run(name: str, host: str, sample: TaskSample, snapshot: Snapshot, tasks: Tasks) -> tuple[int, str]:
    text = f"{format_task_state(sample)} on {host}"
    doubled = find_doubled_tasks(snapshot).get(name)
    if doubled:
        return ERROR, f"runs twice: on {join_words(doubled)}"
    placed = (snapshot.manager or ManagerState()).placements.get(name)
    unseen = placed is not None and placed.host in snapshot.silent_hosts
    if unseen and not sample.state.alive and placed is not None:
        return STALE, f"unknown: {placed.host} does not answer"
    if sample.state in (TaskState.FAILED, TaskState.CRASHLOOP) and name not in find_failed_tasks(
        tasks, snapshot
    ):
        return OK, text
    if sample.orphaned:
        return WARN, f"{text}; its supervisor was lost"
    return _LEVELS.get(sample.state, OK), text


def _encode_absent_task(fleet: str, task: Task, snapshot: Snapshot) -> Document:
    known = resolve_absent_task(task, snapshot)
    text, level = known.state, {"completed": OK, "unknown": STALE}.get(known.state, WARN)
    if known.lost is not None:
        text = f"{text}: {describe_lost_place(known.lost)}"
    elif known.host is not None:
        text = f"{text}: {known.host} does not answer" + format_silence(known.contact, snapshot.taken_at)
    row = encode_absent_row(task, snapshot)
    return _build_status(fleet, f"task {task.name}", level, text, known.host or "", row)


def _build_status(fleet: str, what: str, level: int, message: str, hardware: str, row: Document) -> Document:
    rounded = {key: round_numbers(value) for key, value in row.items()}
    return {
        "name": f"edgectl {fleet}: {what}",
        "level": level,
        "message": message,
        "hardware_id": hardware,
        "values": flatten_row(rounded),
    }
