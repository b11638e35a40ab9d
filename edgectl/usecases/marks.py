"""done, reopen, cordon, uncordon, fence, unfence: what the manager is told to remember, under the fleet's lock."""

import dataclasses
from collections.abc import Collection, Iterable, Sequence

from edgectl.errors import UsageError
from edgectl.gateway.find import ended
from edgectl.model.memory import Memory
from edgectl.state import contacts
from edgectl.state.lock import FleetLock
from edgectl.state.memory import load_memory, save_memory
from edgectl.state.reopened import load_reopened, save_reopened
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.touch import in_touch

_TIMEOUT_S = 15.0


def done(fleet: Fleet, names: Sequence[str]) -> Memory:
    """Mark tasks completed: the next apply stops them, and none starts them until ``reopen`` or a changed spec."""
    _check(names, fleet.tasks.tasks, "task")
    with FleetLock(fleet.state, verb="done", clock=fleet.clock):
        memory = load_memory(fleet.state, fleet.warn)
        marked = {name: fleet.tasks.tasks[name].spec_hash for name in names}
        return _saved(fleet, dataclasses.replace(memory, done={**memory.done, **marked}))


def reopen(fleet: Fleet, names: Sequence[str]) -> Memory:
    """Take the marks of completed tasks away, and forget that their hosts saw them complete, or gave them up."""
    _check(names, fleet.tasks.tasks, "task")
    with FleetLock(fleet.state, verb="reopen", clock=fleet.clock):
        _forget_ended(fleet, names)
        memory = load_memory(fleet.state, fleet.warn)
        kept = {name: spec for name, spec in memory.done.items() if name not in names}
        return _saved(fleet, dataclasses.replace(memory, done=kept))


def _forget_ended(fleet: Fleet, names: Sequence[str]) -> None:
    """Note which ended instances count no longer; a host that does not answer may bring one back."""
    known = load_reopened(fleet.state, fleet.warn)
    for name in names:
        with in_touch(fleet) as near:
            instances, silent = ended(name, fleet.inventory, near.transport, timeout=_TIMEOUT_S)
        known = (*known, *sorted(instances - set(known)))
        if silent:
            fleet.warn(f"{', '.join(silent)} did not answer: if {name} ended there, reopen it again")
    save_reopened(fleet.state, known)


def cordon(fleet: Fleet, names: Sequence[str], *, drain: bool = False) -> Memory:
    """Close hosts to new tasks; with ``drain`` their tasks leave at the next apply."""
    check_hosts(fleet, names)
    with FleetLock(fleet.state, verb="cordon", clock=fleet.clock):
        memory = load_memory(fleet.state, fleet.warn)
        draining = memory.draining | set(names) if drain else memory.draining
        return _saved(fleet, dataclasses.replace(memory, cordons=memory.cordons | set(names), draining=draining))


def uncordon(fleet: Fleet, names: Sequence[str]) -> Memory:
    """Open cordoned hosts again."""
    check_hosts(fleet, names)
    with FleetLock(fleet.state, verb="uncordon", clock=fleet.clock):
        memory = load_memory(fleet.state, fleet.warn)
        return _saved(fleet, dataclasses.replace(memory, cordons=memory.cordons - set(names), draining=memory.draining - set(names)))


def fence(fleet: Fleet, names: Sequence[str]) -> frozenset[str]:
    """Take the operator's word that hosts are switched off: their tasks are no longer waited for. All hosts that count as off."""
    check_hosts(fleet, names)
    with FleetLock(fleet.state, verb="fence", clock=fleet.clock):
        return contacts.fence(fleet.state, names).fenced


def unfence(fleet: Fleet, names: Sequence[str]) -> frozenset[str]:
    """Take that back. All hosts that still count as off."""
    check_hosts(fleet, names)
    with FleetLock(fleet.state, verb="unfence", clock=fleet.clock):
        return contacts.unfence(fleet.state, names).fenced


def check_hosts(fleet: Fleet, names: Iterable[str]) -> None:
    """Refuse hosts that do not exist.

    Raises:
        UsageError: there is none of this name.
    """
    _check(names, fleet.inventory.hosts, "host")


def _saved(fleet: Fleet, memory: Memory) -> Memory:
    save_memory(fleet.state, memory)
    return memory


def _check(names: Iterable[str], known: Collection[str], kind: str) -> None:
    for name in names:
        if name not in known:
            raise UsageError(f"no {kind} {name}", hint=f"{kind}s: " + ", ".join(known))
