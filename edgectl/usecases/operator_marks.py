# SPDX-License-Identifier: Apache-2.0
"""Marks that operators set on tasks and hosts (done, cordon, fence), changed under the fleet's lock."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence

from edgectl.gateway.task_lookup import list_ended_instances
from edgectl.model.manager_state import ManagerState
from edgectl.names import check_known_names
from edgectl.rules.lost_places import list_fence_marks
from edgectl.state import heartbeats
from edgectl.state.lock import FleetLock
from edgectl.state.manager_state import (
    load_ignored_instances,
    load_manager_state,
    save_ignored_instances,
    save_manager_state,
)
from edgectl.state.uptime import compute_elapsed_s
from edgectl.usecases.coordination import hold_in_etcd, share_state
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import track_heartbeats

_TIMEOUT_S = 15.0


@contextlib.contextmanager
def change_marks(fleet: Fleet, verb: str) -> Iterator[None]:
    """The lock of the fleet, and with ``coordination`` its lease in etcd, where the marks are saved, too.

    Raises:
        LockBusyError: another edgectl is changing this fleet.
        CoordinationError: etcd does not answer: nothing is changed, or it is changed on this machine only.
    """
    with (
        FleetLock(fleet.state, verb=verb, timeout=None, clock=fleet.clock),
        hold_in_etcd(fleet, verb) as lease,
    ):
        yield
        share_state(fleet, lease)


def mark_tasks_done(fleet: Fleet, names: Sequence[str], *, dry_run: bool = False) -> frozenset[str]:
    """Mark tasks as completed: the next apply stops them, and none starts them until ``reopen`` or a changed
    spec. Returns those that were marked before. ``dry_run``: only check.
    """
    check_known_names(names, fleet.tasks.tasks, "task")
    marked = {name: fleet.tasks.tasks[name].spec_hash for name in names}

    def mark(state: ManagerState) -> ManagerState:
        return dataclasses.replace(state, done={**state.done, **marked})

    before = _change_manager_state(fleet, "done", mark, dry_run=dry_run)
    return frozenset(name for name, spec in marked.items() if before.done.get(name) == spec)


def reopen_tasks(fleet: Fleet, names: Sequence[str]) -> tuple[frozenset[str], frozenset[str]]:
    """Remove the marks of completed tasks, and forget their recorded completion or failure. Returns the hosts
    that did not answer, where one may be recorded still; and the tasks that were open before.
    """
    check_known_names(names, fleet.tasks.tasks, "task")
    with change_marks(fleet, "reopen"):
        unanswered, ended = _ignore_ended_instances(fleet, names)
        manager = load_manager_state(fleet.state, fleet.warn)
        kept = {name: spec for name, spec in manager.done.items() if name not in names}
        save_manager_state(fleet.state, dataclasses.replace(manager, done=kept))
    changed = ended | manager.done.keys() | (frozenset(names) if unanswered else frozenset())
    return unanswered, frozenset(names) - changed


def _ignore_ended_instances(fleet: Fleet, names: Sequence[str]) -> tuple[frozenset[str], frozenset[str]]:
    """Record which ended instances are ignored; a host that does not answer may report one later. Returns
    those hosts, and the tasks that had any.
    """
    unanswered: frozenset[str] = frozenset()
    ended: frozenset[str] = frozenset()
    reopened = load_ignored_instances(fleet.state, fleet.warn)
    for name in names:
        with track_heartbeats(fleet) as tracked:
            instances, silent = list_ended_instances(
                name, fleet.inventory, tracked.transport, timeout=_TIMEOUT_S
            )
        found = sorted(instances - set(reopened))
        reopened = (*reopened, *found)
        ended |= {name} if found else frozenset()
        unanswered |= frozenset(silent)
        if silent:
            fleet.warn(f"{', '.join(silent)} did not answer: if {name} ended there, run reopen again")
    save_ignored_instances(fleet.state, reopened)
    return unanswered, ended


def cordon_hosts(
    fleet: Fleet, names: Sequence[str], *, drain: bool = False, dry_run: bool = False
) -> frozenset[str]:
    """Mark hosts as unschedulable; with ``drain`` their tasks move away at the next apply. Returns those that
    were marked so before. ``dry_run``: only check.
    """
    check_known_names(names, fleet.inventory.hosts, "host")

    def mark(state: ManagerState) -> ManagerState:
        draining = state.draining | set(names) if drain else state.draining
        return dataclasses.replace(state, cordons=state.cordons | set(names), draining=draining)

    before = _change_manager_state(fleet, "cordon", mark, dry_run=dry_run)
    return frozenset(names) & (before.draining if drain else before.cordons | before.draining)


def uncordon_hosts(fleet: Fleet, names: Sequence[str], *, dry_run: bool = False) -> frozenset[str]:
    """Mark hosts as schedulable. Returns those that were so before. ``dry_run``: only check."""
    check_known_names(names, fleet.inventory.hosts, "host")

    def open_hosts(state: ManagerState) -> ManagerState:
        return dataclasses.replace(
            state, cordons=state.cordons - set(names), draining=state.draining - set(names)
        )

    before = _change_manager_state(fleet, "uncordon", open_hosts, dry_run=dry_run)
    return frozenset(names) - before.cordons - before.draining


def fence_hosts(fleet: Fleet, names: Sequence[str]) -> frozenset[str]:
    """Declare hosts powered off: their tasks can be rescheduled. Returns all fenced hosts.

    A host that left the inventory is known as long as a task was last placed there; of one whose address
    changed, the former address is fenced (ADR 0040).
    """
    marks = _list_fence_marks(fleet, names)
    with change_marks(fleet, "fence"):
        return heartbeats.add_fences(fleet.state, marks).fenced


def is_fenced(fleet: Fleet, host: str) -> bool:
    """Whether a host is declared powered off; the fence ends when it answers.

    Raises:
        UsageError: the host is unknown.
    """
    return _list_fence_marks(fleet, [host]) <= heartbeats.load_heartbeats(fleet.state, fleet.warn).fenced


def _list_fence_marks(fleet: Fleet, names: Sequence[str]) -> frozenset[str]:
    manager = load_manager_state(fleet.state, fleet.warn)
    check_known_names(names, list_fenceable_hosts(fleet, manager), "host")
    return frozenset(mark for name in names for mark in list_fence_marks(name, fleet.inventory, manager))


def compute_silence_s(fleet: Fleet, host: str) -> float | None:
    """Time in s since a host last answered; None if that is not known."""
    last = heartbeats.load_heartbeats(fleet.state, fleet.warn).last.get(host)
    return None if last is None else compute_elapsed_s(last, fleet.uptime())


def list_fenceable_hosts(fleet: Fleet, manager: ManagerState | None = None) -> list[str]:
    """The hosts of the inventory, and those where a task was last placed."""
    manager = manager or load_manager_state(fleet.state, fleet.warn)
    return [*fleet.inventory.hosts, *(placement.host for placement in manager.placements.values())]


def unfence_hosts(fleet: Fleet, names: Sequence[str], *, dry_run: bool = False) -> frozenset[str]:
    """Clear the fence of hosts. Returns those that had none before. ``dry_run``: only check."""
    fenced = heartbeats.load_heartbeats(fleet.state, fleet.warn).fenced
    check_known_names(names, [*fleet.inventory.hosts, *sorted(fenced)], "host")
    if not dry_run:
        with change_marks(fleet, "unfence"):
            heartbeats.remove_fences(fleet.state, names)
    return frozenset(names) - fenced


def _change_manager_state(
    fleet: Fleet, verb: str, change: Callable[[ManagerState], ManagerState], *, dry_run: bool
) -> ManagerState:
    """Save what ``change`` makes of the manager's state; the state before. ``dry_run``: nothing is saved."""
    if dry_run:
        return load_manager_state(fleet.state, fleet.warn)
    with change_marks(fleet, verb):
        before = load_manager_state(fleet.state, fleet.warn)
        save_manager_state(fleet.state, change(before))
    return before
