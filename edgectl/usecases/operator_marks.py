"""done, reopen, cordon, uncordon, fence, unfence: what the manager is told to remember, under the fleet's lock."""

import dataclasses
from collections.abc import Sequence

from edgectl.gateway.task_lookup import list_ended_instances
from edgectl.model.manager_state import ManagerState
from edgectl.names import check_known_names
from edgectl.state import heartbeats
from edgectl.state.lock import FleetLock
from edgectl.state.manager_state import (
    load_ignored_instances,
    load_manager_state,
    save_ignored_instances,
    save_manager_state,
)
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import track_heartbeats

_TIMEOUT_S = 15.0


def mark_tasks_done(fleet: Fleet, names: Sequence[str]) -> ManagerState:
    """Mark tasks completed: the next apply stops them, and none starts them until ``reopen`` or a changed spec."""
    check_known_names(names, fleet.tasks.tasks, "task")
    with FleetLock(fleet.state, verb="done", clock=fleet.clock):
        memory = load_manager_state(fleet.state, fleet.warn)
        marked = {name: fleet.tasks.tasks[name].spec_hash for name in names}
        return _save_and_return(fleet, dataclasses.replace(memory, done={**memory.done, **marked}))


def reopen_tasks(fleet: Fleet, names: Sequence[str]) -> ManagerState:
    """Take the marks of completed tasks away, and forget that their hosts saw them complete, or gave them up."""
    check_known_names(names, fleet.tasks.tasks, "task")
    with FleetLock(fleet.state, verb="reopen", clock=fleet.clock):
        _ignore_ended_instances(fleet, names)
        memory = load_manager_state(fleet.state, fleet.warn)
        kept = {name: spec for name, spec in memory.done.items() if name not in names}
        return _save_and_return(fleet, dataclasses.replace(memory, done=kept))


def _ignore_ended_instances(fleet: Fleet, names: Sequence[str]) -> None:
    """Note which ended instances count no longer; a host that does not answer may bring one back."""
    reopened = load_ignored_instances(fleet.state, fleet.warn)
    for name in names:
        with track_heartbeats(fleet) as near:
            instances, silent = list_ended_instances(
                name, fleet.inventory, near.transport, timeout=_TIMEOUT_S
            )
        reopened = (*reopened, *sorted(instances - set(reopened)))
        if silent:
            fleet.warn(f"{', '.join(silent)} did not answer: if {name} ended there, reopen it again")
    save_ignored_instances(fleet.state, reopened)


def cordon_hosts(fleet: Fleet, names: Sequence[str], *, drain: bool = False) -> ManagerState:
    """Close hosts to new tasks; with ``drain`` their tasks leave at the next apply."""
    check_known_names(names, fleet.inventory.hosts, "host")
    with FleetLock(fleet.state, verb="cordon", clock=fleet.clock):
        memory = load_manager_state(fleet.state, fleet.warn)
        draining = memory.draining | set(names) if drain else memory.draining
        return _save_and_return(
            fleet, dataclasses.replace(memory, cordons=memory.cordons | set(names), draining=draining)
        )


def uncordon_hosts(fleet: Fleet, names: Sequence[str]) -> ManagerState:
    """Open cordoned hosts again."""
    check_known_names(names, fleet.inventory.hosts, "host")
    with FleetLock(fleet.state, verb="uncordon", clock=fleet.clock):
        memory = load_manager_state(fleet.state, fleet.warn)
        return _save_and_return(
            fleet,
            dataclasses.replace(
                memory, cordons=memory.cordons - set(names), draining=memory.draining - set(names)
            ),
        )


def fence_hosts(fleet: Fleet, names: Sequence[str]) -> frozenset[str]:
    """Take the operator's word that hosts are switched off: their tasks are no longer waited for. All hosts that count as off."""
    check_known_names(names, fleet.inventory.hosts, "host")
    with FleetLock(fleet.state, verb="fence", clock=fleet.clock):
        return heartbeats.add_fences(fleet.state, names).fenced


def unfence_hosts(fleet: Fleet, names: Sequence[str]) -> frozenset[str]:
    """Take that back. All hosts that still count as off."""
    check_known_names(names, fleet.inventory.hosts, "host")
    with FleetLock(fleet.state, verb="unfence", clock=fleet.clock):
        return heartbeats.remove_fences(fleet.state, names).fenced


def _save_and_return(fleet: Fleet, memory: ManagerState) -> ManagerState:
    save_manager_state(fleet.state, memory)
    return memory
