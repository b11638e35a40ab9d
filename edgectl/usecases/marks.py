"""done, reopen, cordon, uncordon, fence, unfence: what the manager is told to remember, under the fleet's lock."""

import dataclasses
from collections.abc import Sequence

from edgectl.gateway.find import ended
from edgectl.model.memory import Memory
from edgectl.model.names import known
from edgectl.state import contacts
from edgectl.state.lock import FleetLock
from edgectl.state.memory import load_memory, save_memory
from edgectl.state.reopened import load_reopened, save_reopened
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.touch import in_touch

_TIMEOUT_S = 15.0


def done(fleet: Fleet, names: Sequence[str]) -> Memory:
    """Mark tasks completed: the next apply stops them, and none starts them until ``reopen`` or a changed spec."""
    known(names, fleet.tasks.tasks, "task")
    with FleetLock(fleet.state, verb="done", clock=fleet.clock):
        memory = load_memory(fleet.state, fleet.warn)
        marked = {name: fleet.tasks.tasks[name].spec_hash for name in names}
        return _saved(fleet, dataclasses.replace(memory, done={**memory.done, **marked}))


def reopen(fleet: Fleet, names: Sequence[str]) -> Memory:
    """Take the marks of completed tasks away, and forget that their hosts saw them complete, or gave them up."""
    known(names, fleet.tasks.tasks, "task")
    with FleetLock(fleet.state, verb="reopen", clock=fleet.clock):
        _forget_ended(fleet, names)
        memory = load_memory(fleet.state, fleet.warn)
        kept = {name: spec for name, spec in memory.done.items() if name not in names}
        return _saved(fleet, dataclasses.replace(memory, done=kept))


def _forget_ended(fleet: Fleet, names: Sequence[str]) -> None:
    """Note which ended instances count no longer; a host that does not answer may bring one back."""
    reopened = load_reopened(fleet.state, fleet.warn)
    for name in names:
        with in_touch(fleet) as near:
            instances, silent = ended(name, fleet.inventory, near.transport, timeout=_TIMEOUT_S)
        reopened = (*reopened, *sorted(instances - set(reopened)))
        if silent:
            fleet.warn(f"{', '.join(silent)} did not answer: if {name} ended there, reopen it again")
    save_reopened(fleet.state, reopened)


def cordon(fleet: Fleet, names: Sequence[str], *, drain: bool = False) -> Memory:
    """Close hosts to new tasks; with ``drain`` their tasks leave at the next apply."""
    known(names, fleet.inventory.hosts, "host")
    with FleetLock(fleet.state, verb="cordon", clock=fleet.clock):
        memory = load_memory(fleet.state, fleet.warn)
        draining = memory.draining | set(names) if drain else memory.draining
        return _saved(fleet, dataclasses.replace(memory, cordons=memory.cordons | set(names), draining=draining))


def uncordon(fleet: Fleet, names: Sequence[str]) -> Memory:
    """Open cordoned hosts again."""
    known(names, fleet.inventory.hosts, "host")
    with FleetLock(fleet.state, verb="uncordon", clock=fleet.clock):
        memory = load_memory(fleet.state, fleet.warn)
        return _saved(fleet, dataclasses.replace(memory, cordons=memory.cordons - set(names), draining=memory.draining - set(names)))


def fence(fleet: Fleet, names: Sequence[str]) -> frozenset[str]:
    """Take the operator's word that hosts are switched off: their tasks are no longer waited for. All hosts that count as off."""
    known(names, fleet.inventory.hosts, "host")
    with FleetLock(fleet.state, verb="fence", clock=fleet.clock):
        return contacts.fence(fleet.state, names).fenced


def unfence(fleet: Fleet, names: Sequence[str]) -> frozenset[str]:
    """Take that back. All hosts that still count as off."""
    known(names, fleet.inventory.hosts, "host")
    with FleetLock(fleet.state, verb="unfence", clock=fleet.clock):
        return contacts.unfence(fleet.state, names).fenced


def _saved(fleet: Fleet, memory: Memory) -> Memory:
    save_memory(fleet.state, memory)
    return memory
