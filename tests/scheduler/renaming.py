# SPDX-License-Identifier: Apache-2.0
"""Other names for hosts, robots and tasks, everywhere in the input of a decision."""

from collections.abc import Mapping
from dataclasses import replace

from edgectl.model.assignment import Assignment
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample
from edgectl.model.task import HostRules, Task
from tests.builders import an_inventory, some_tasks
from tests.scheduler.tight_fleets import TightFleet

Names = Mapping[str, str]


def rename_everywhere(fleet: TightFleet, names: Names) -> TightFleet:
    """``fleet`` with ``names`` for its hosts, robots and tasks; others keep theirs."""

    def get(name: str) -> str:
        return names.get(name, name)

    links = {(get(edge), get(robot)): rate for (edge, robot), rate in fleet.inventory.links.items()}
    hosts = [replace(host, name=get(host.name)) for host in fleet.inventory.hosts.values()]
    return replace(
        fleet,
        inventory=an_inventory(*hosts, links=links),
        tasks=some_tasks(*(_rename_task(task, names) for task in fleet.tasks.tasks.values())),
        snapshot=_rename_snapshot(fleet.snapshot, names),
        memory=_rename_manager_state(fleet.memory, names),
    )


def list_renamed_hosts(found: Assignment, names: Names) -> dict[str, str | None]:
    """The host of each task, by ``names``."""
    return {
        names.get(each.task, each.task): None if each.host is None else names.get(each.host, each.host)
        for each in found.decisions
    }


def _rename_task(task: Task, names: Names) -> Task:
    def get(name: str) -> str:
        return names.get(name, name)

    rules = task.hosts
    return replace(
        task,
        name=get(task.name),
        robots=tuple(map(get, task.robots)),
        needs=tuple(replace(need, task=get(need.task)) for need in task.needs),
        apart=tuple(map(get, task.apart)),
        together=tuple(map(get, task.together)),
        hosts=HostRules(
            only=tuple(map(get, rules.only)),
            never=tuple(map(get, rules.never)),
            labels=rules.labels,
            pin=None if rules.pin is None else get(rules.pin),
        ),
    )


def _rename_snapshot(snapshot: Snapshot, names: Names) -> Snapshot:
    hosts = {names.get(name, name): _rename_sample(host, names) for name, host in snapshot.hosts.items()}
    return replace(snapshot, hosts=hosts)


def _rename_sample(sample: HostSample, names: Names) -> HostSample:
    return replace(
        sample,
        links={names.get(robot, robot): link for robot, link in sample.links.items()},
        tasks={names.get(task, task): _rename_run(run, names) for task, run in sample.tasks.items()},
    )


def _rename_run(run: TaskSample, names: Names) -> TaskSample:
    if run.links is None:
        return run
    return replace(run, links={names.get(robot, robot): rate for robot, rate in run.links.items()})


def _rename_manager_state(memory: ManagerState, names: Names) -> ManagerState:
    def get(name: str) -> str:
        return names.get(name, name)

    return replace(
        memory,
        placements={get(t): replace(each, host=get(each.host)) for t, each in memory.placements.items()},
        first={get(task): get(host) for task, host in memory.first.items()},
        cordons=frozenset(map(get, memory.cordons)),
        draining=frozenset(map(get, memory.draining)),
        done={get(task): spec for task, spec in memory.done.items()},
        downtimes={(get(task), get(host)): known for (task, host), known in memory.downtimes.items()},
        stays={get(task): known for task, known in memory.stays.items()},
        measured={(get(task), kind): known for (task, kind), known in memory.measured.items()},
    )
