# SPDX-License-Identifier: Apache-2.0
"""Reports of hosts about tasks, judged against the manager's own record (ADR 0047). Pure."""

from collections.abc import Collection, Iterator, Mapping
from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.feasibility import find_rule_against


class Standing(StrEnum):
    """Weight of a host's report about one task.

    ``placed``: the record names this host for the task. ``adopted``: no record contradicts the report, and
    the rules of the task allow the host. ``refused``: the report decides nothing.
    """

    PLACED = "placed"
    ADOPTED = "adopted"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """What the manager itself knows of a task: its ``placement``, and how the host named there answered.

    ``holder``: the sample of that host; None while it is silent.
    """

    placement: Placement
    holder: HostSample | None


def find_record(
    task: str, manager: ManagerState, hosts: Collection[str], samples: Mapping[str, HostSample]
) -> Record | None:
    """The record of ``task``; None where it was never placed, or its host left the inventory (``hosts``)."""
    placement = manager.placements.get(task)
    if placement is None or placement.host not in hosts:
        return None
    holder = samples.get(placement.host)
    return Record(placement=placement, holder=holder if holder is not None and holder.ok else None)


def judge_report(task: Task, host: Host, found: TaskSample, record: Record | None) -> Standing:
    """The standing of what ``host`` reports about ``task``.

    An end (completed or given up) counts only with the specification of now, and of the instance that was
    placed. A copy elsewhere counts only while the placed one is silent, or where its host was given a newer
    generation by another manager since and no longer runs it.
    """
    ended = found.state is TaskState.COMPLETED or found.given_up
    if record is not None and record.placement.host == host.name:
        return (
            Standing.REFUSED if ended and not _is_end_of(task, found, record.placement) else Standing.PLACED
        )
    if not _is_host_allowed(task, host) or (ended and found.spec_hash != task.spec_hash):
        return Standing.REFUSED
    if record is None:
        return Standing.ADOPTED
    if record.holder is None:
        return Standing.REFUSED if ended else Standing.ADOPTED
    return Standing.ADOPTED if _is_superseded(task, record) else Standing.REFUSED


def _is_end_of(task: Task, found: TaskSample, placement: Placement) -> bool:
    """Whether an end is that of the placed instance, or of a start as new, with the specification of now.

    A failed move starts the old instance anew, under the generation of the move.
    """
    same = placement.instance in ("", found.instance) or found.generation >= placement.generation
    known = (task.spec_hash,) if found.state is TaskState.COMPLETED else ("", task.spec_hash)
    return same and found.spec_hash in known


def _is_host_allowed(task: Task, host: Host) -> bool:
    robot = host.role is Role.ROBOT
    if robot and task.robots != (host.name,):
        return False
    return find_rule_against(host, task, robot=robot) is None


def _is_superseded(task: Task, record: Record) -> bool:
    """Whether the placed host answers, does not run the task, and was given a newer generation of it."""
    holder = record.holder
    if holder is None:
        return False
    own = holder.tasks.get(task.name)
    if own is not None and own.managed and own.state.alive:
        return False
    newest = max(holder.generations.get(task.name, 0), own.generation if own is not None else 0)
    return newest > record.placement.generation


def describe_claims(
    inventory: Inventory, tasks: Tasks, snapshot: Snapshot, manager: ManagerState
) -> Iterator[str]:
    """One line for each report that does not count, or that counts although no record names it."""
    for name, sample in snapshot.hosts.items():
        host = inventory.hosts.get(name)
        for found_task, found in sample.tasks.items() if sample.ok and host is not None else ():
            task = tasks.tasks.get(found_task)
            if task is None or host is None or not (task.managed and found.managed):
                continue
            record = find_record(found_task, manager, inventory.hosts, snapshot.hosts)
            line = _describe_claim(task, name, found, record, judge_report(task, host, found, record))
            if line:
                yield line


def _describe_claim(
    task: Task, host: str, found: TaskSample, record: Record | None, standing: Standing
) -> str:
    ended = found.state is TaskState.COMPLETED
    if standing is Standing.PLACED or not (found.state.alive or ended):
        return ""
    if ended and record is not None and found.generation < record.placement.generation:
        return ""  # an earlier run, whose host still remembers it
    if standing is Standing.ADOPTED:
        return (
            "" if ended else f"{host} runs {task.name}, but no record here places it there: it is taken over"
        )
    if ended and found.spec_hash not in ("", task.spec_hash):
        return ""
    where = f"is placed on {record.placement.host}" if record is not None else "may not run there"
    what = "is ignored" if ended else "does not count, and the copy is stopped"
    return f"{host} reports {task.name} as {found.state.value}, but it {where}: the report {what}"
