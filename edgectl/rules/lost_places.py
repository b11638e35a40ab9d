# SPDX-License-Identifier: Apache-2.0
"""Places of tasks that the inventory no longer reaches: hosts that left it, or have another address or user
(ADR 0040). What runs there cannot be seen, so it counts as running.
"""

from collections.abc import Iterator, Mapping

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import HostSample, MachineIdentity, Snapshot
from edgectl.names import natural_key


@dataclass(frozen=True, slots=True, kw_only=True)
class LostPlace:
    """The last place of a task: ``address`` of ``host`` as it was, where the host is in the inventory with
    another one; None where the host is not in the inventory.

    ``fenced``: the operator declared it powered off.
    """

    host: str
    address: str | None = None
    fenced: bool = False


def describe_lost_place(lost: LostPlace) -> str:
    """Where a task ran that the inventory no longer reaches, and what to do about it."""
    back = "put it back and drain it" if lost.address is None else "put that back and drain it"
    where = (
        f"{lost.host}, which is no longer in the inventory"
        if lost.address is None
        else f"{lost.host} at {lost.address}, which the inventory no longer states"
    )
    return f"ran on {where}: {back}, or edgectl fence {lost.host}"


def build_lost_place_decision(task: str, lost: LostPlace, verdict: Verdict) -> Decision:
    """The decision on ``task`` because its last place is lost."""
    return Decision(
        task=task,
        verdict=verdict,
        reason=Reason.HOST_LEFT if lost.address is None else Reason.HOST_READDRESSED,
        previous_host=lost.host,
        subject=lost.host if lost.address is None else f"{lost.host} ({lost.address})",
    )


def get_lost_place(decision: Decision) -> LostPlace | None:
    """The lost place because of which it was decided; None for another reason."""
    if decision.reason not in (Reason.HOST_LEFT, Reason.HOST_READDRESSED):
        return None
    host, _, address = (decision.subject or "its host").rstrip(")").partition(" (")
    return LostPlace(host=host, address=address or None)


def find_lost_place(
    task: str, placement: Placement, hosts: Mapping[str, HostSample], manager: ManagerState
) -> LostPlace | None:
    """The place of ``task``, placed by ``placement``, where ``hosts`` (all of the inventory) do not reach it.

    An address that changed is the same place where the host answers from the directories of the task.
    """
    host = hosts.get(placement.host)
    if host is None and any(_is_same_place(task, placement, sample) for sample in hosts.values()):
        return None
    if host is None:
        return LostPlace(host=placement.host, fenced=placement.host in manager.fenced)
    if "" in (placement.address, host.address) or placement.address == host.address:
        return None
    if _is_same_place(task, placement, host):
        return None
    return LostPlace(
        host=placement.host, address=placement.address, fenced=placement.address in manager.fenced
    )


def _is_same_place(task: str, placement: Placement, host: HostSample) -> bool:
    """Whether the host reads the directories of the placement, which it lists under every name.

    Copied images have one machine id, so it is not enough: only the place itself was given the generation.
    """
    if not host.ok or not placement.machine or placement.machine != host.machine:
        return False
    own = host.tasks.get(task)
    known = max(host.generations.get(task, 0), own.generation if own is not None else 0)
    return known >= max(1, placement.generation)


def list_lost_tasks(snapshot: Snapshot) -> dict[str, LostPlace]:
    """The tasks that no host shows and whose last place is lost and not fenced, by name in natural order."""
    manager = snapshot.manager or ManagerState()
    seen = {name for host in snapshot.hosts.values() for name, run in host.tasks.items() if run.state.alive}
    lost = {
        name: find_lost_place(name, manager.placements[name], snapshot.hosts, manager)
        for name in sorted(manager.placements.keys() - seen, key=natural_key)
    }
    return {name: place for name, place in lost.items() if place is not None and not place.fenced}


def list_fence_marks(host: str, inventory: Inventory, manager: ManagerState) -> frozenset[str]:
    """What a fence of ``host`` marks: its former addresses, where tasks were placed under one that it no
    longer has, else its name.
    """
    now = inventory.hosts.get(host)
    former = {
        placement.address
        for placement in manager.placements.values()
        if now is not None and placement.host == host and placement.address not in ("", now.address)
    }
    return frozenset(former or {host})


def find_shared_machine(inventory: Inventory, snapshot: Snapshot) -> tuple[str, str] | None:
    """Two hosts that answered from one machine, and are not both slices of it; None: there are none."""
    identities = {
        name: MachineIdentity(
            boot_id=sample.device.boot_id,
            machine_id=sample.machine.partition("/")[0],
            pid_namespace=sample.device.pid_namespace,
        )
        for name, sample in snapshot.hosts.items()
    }
    return next(list_shared_machines(inventory, identities), None)


def list_shared_machines(
    inventory: Inventory, identities: Mapping[str, MachineIdentity]
) -> Iterator[tuple[str, str]]:
    """Each host whose machine an earlier one of ``identities`` is, too, after that one; but for slices.

    The same machine has the same boot and the same machine id: images that were copied share only the second,
    containers only the first. Where one of two has no machine id, they are one if they see the same processes
    (ADR 168).
    """
    found: dict[str, list[tuple[str, MachineIdentity]]] = {}
    for name, identity in identities.items():
        host = inventory.hosts.get(name)
        if host is None or host.shares_machine or not identity.boot_id:
            continue
        booted = found.setdefault(identity.boot_id, [])
        first = next((other for other, seen in booted if _is_same_machine(seen, identity)), None)
        if first is not None:
            yield first, name
        booted.append((name, identity))


def _is_same_machine(one: MachineIdentity, other: MachineIdentity) -> bool:
    """Whether two hosts with the same boot are one machine."""
    if one.machine_id and other.machine_id:
        return one.machine_id == other.machine_id
    return one.pid_namespace == other.pid_namespace != ""
