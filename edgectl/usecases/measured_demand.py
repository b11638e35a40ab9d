# SPDX-License-Identifier: Apache-2.0
"""Measured demand of tasks from the history, for plans and for the operator."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from edgectl.model.inventory import Inventory
from edgectl.model.point import HostPoint
from edgectl.model.predicted_latency import ServiceTime
from edgectl.model.profile import ClassProfile, ClassService, UsageProfile
from edgectl.model.resource import CPU, MEMORY
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task
from edgectl.rules.measured_demand import (
    WARM_UP_S,
    MeasuredDemands,
    classify_host,
    follows_history,
    has_enough_samples,
    is_of_current_spec,
    prefer_own_demands,
    select_shared_demands,
)
from edgectl.scheduler.profile import build_usage_profile, compute_percentile, measured_demand_from_profile
from edgectl.state.shared_demands import load_shared_demands
from edgectl.usecases.fleet import Fleet

if TYPE_CHECKING:
    from edgectl.state.store import Store

# At most this many samples of a task on a class of hosts are read.
MAX_SAMPLES = 1000
# A host of which others use no more of the CPU counts as idle: waiting adds little then.
LOW_LOAD = 0.10
_HISTORY_FILE = "history.db"


def load_measured_demands(fleet: Fleet, snapshot: Snapshot) -> MeasuredDemands:
    """Measured demand by task and class of hosts, of the tasks whose demand follows it. Nothing is read where
    there are none. With ``coordination`` also what another machine has measured.
    """
    tasks = [task for task in fleet.tasks.tasks.values() if task.managed and follows_history(task.demand)]
    if not tasks:
        return {}
    own = _load_own_demands(fleet, tasks, snapshot)
    if fleet.inventory.coordination is None:
        return own
    known = {task.name: task for task in tasks}
    return prefer_own_demands(
        own,
        {
            key: found
            for key, found in load_shared_demands(fleet.state, fleet.warn).items()
            if key[0] in known and is_of_current_spec(known[key[0]], found)
        },
    )


def find_news_of_demands(fleet: Fleet, measured: MeasuredDemands) -> MeasuredDemands | None:
    """The demands to share once ``measured`` are known; None where those that are shared will do."""
    shared = load_shared_demands(fleet.state, fleet.warn)
    selected = select_shared_demands(shared, measured, fleet.tasks.tasks)
    return None if selected == shared else selected


def _load_own_demands(fleet: Fleet, tasks: Iterable[Task], snapshot: Snapshot) -> MeasuredDemands:
    if not (fleet.state / _HISTORY_FILE).exists():
        return {}

    def read(store: "Store") -> MeasuredDemands:
        classes = _group_hosts_by_class(
            _classify_answering_hosts(fleet.inventory, snapshot)
            | _classify_by_last_sample(fleet.inventory, snapshot, store)
        )
        return {
            (task.name, kind): measured_demand_from_profile(found, task.spec_hash)
            for task in tasks
            for kind, _, found in _compute_class_profiles(store, task, classes)
        }

    return fleet.history.use(fleet.state, fleet.warn, read)


def load_class_profiles(fleet: Fleet, tasks: Iterable[Task]) -> list[ClassProfile]:
    """The usage history of ``tasks`` by class of hosts; no host is contacted."""
    if not (fleet.state / _HISTORY_FILE).exists():
        return []

    def read(store: "Store") -> list[ClassProfile]:
        classes = _group_hosts_by_class(_classify_by_last_sample(fleet.inventory, None, store))
        return [
            ClassProfile(
                task=task,
                kind=kind,
                hosts=tuple(hosts),
                profile=found,
                enough=has_enough_samples(measured_demand_from_profile(found)),
            )
            for task in tasks
            for kind, hosts, found in _compute_class_profiles(store, task, classes)
        ]

    return fleet.history.use(fleet.state, fleet.warn, read)


def load_service_times(fleet: Fleet, tasks: Iterable[Task], metric: str) -> list[ClassService]:
    """Service times of ``tasks`` by class of hosts, out of their application metric ``metric`` in ms.

    Only what they reported while others left the host nearly idle counts; no host is contacted.
    """
    if not (fleet.state / _HISTORY_FILE).exists():
        return []

    def read(store: "Store") -> list[ClassService]:
        classes = _group_hosts_by_class(_classify_by_last_sample(fleet.inventory, None, store))
        return [
            found
            for task in tasks
            for kind, hosts in classes.items()
            if (found := _find_service_time(store, task, kind, hosts, metric)) is not None
        ]

    return fleet.history.use(fleet.state, fleet.warn, read)


def _find_service_time(
    store: "Store", task: Task, kind: str, hosts: Collection[str], metric: str
) -> ClassService | None:
    found: list[float] = []
    for host in hosts:
        found += store.service_samples(
            task.name,
            host,
            task.spec_hash if task.managed else "",
            metric,
            min_age_s=WARM_UP_S,
            max_load=LOW_LOAD,
            limit=MAX_SAMPLES,
        )
    values = sorted(value / 1000.0 for value in found if value > 0.0)
    if not values:
        return None
    p50, p95 = (compute_percentile(values, share) for share in (0.50, 0.95))
    return ClassService(task=task, kind=kind, samples=len(values), service=ServiceTime(p50=p50, p95=p95))


def _compute_class_profiles(
    store: "Store", task: Task, classes: Mapping[str, Collection[str]]
) -> Iterator[tuple[str, Collection[str], UsageProfile]]:
    for kind, hosts in classes.items():
        uses = store.steady_usages(
            task.name, hosts, task.spec_hash if task.managed else "", min_age_s=WARM_UP_S, limit=MAX_SAMPLES
        )
        found = build_usage_profile(uses, len(task.robots))
        if found is not None:
            yield kind, hosts, found


def _classify_answering_hosts(inventory: Inventory, snapshot: Snapshot) -> dict[str, str]:
    """The class of every host that answered."""
    found = {}
    for name, sample in snapshot.hosts.items():
        if name in inventory.hosts and sample.measured:
            found[name] = classify_host(
                inventory.hosts[name], sample.usage[CPU.name].capacity, sample.usage[MEMORY.name].capacity
            )
    return found


def _classify_by_last_sample(
    inventory: Inventory, snapshot: Snapshot | None, store: "Store"
) -> dict[str, str]:
    """The class of every other host, by its last sample with values."""
    found = {}
    for name, host in inventory.hosts.items():
        if snapshot is not None and name in snapshot.hosts and snapshot.hosts[name].measured:
            continue
        point = _find_last_answer(store, name)
        if point is not None and point.usage.keys() >= {CPU.name, MEMORY.name}:
            found[name] = classify_host(
                host, point.usage[CPU.name].capacity, point.usage[MEMORY.name].capacity
            )
    return found


def _find_last_answer(store: "Store", host: str) -> HostPoint | None:
    """The last sample with values; a host that has been unreachable for very long has none."""
    for limit in (1, MAX_SAMPLES):
        for point in reversed(store.host_points(host, limit=limit)):
            if point.usage:
                return point
    return None


def _group_hosts_by_class(classes: Mapping[str, str]) -> dict[str, list[str]]:
    """Hosts by class, in order."""
    grouped: dict[str, list[str]] = {}
    for host in sorted(classes):
        grouped.setdefault(classes[host], []).append(host)
    return dict(sorted(grouped.items()))
