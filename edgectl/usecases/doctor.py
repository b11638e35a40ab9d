# SPDX-License-Identifier: Apache-2.0
"""Diagnose this machine and the hosts. Nothing is changed."""

import contextlib
import dataclasses
from collections.abc import Sequence

from edgectl.doctor.diagnosis import diagnose_fleet
from edgectl.errors import PluginError
from edgectl.gateway.fanout import fan_out
from edgectl.gateway.host_facts import HostFactsOptions, collect_host_facts
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.diagnosis import (
    Diagnosis,
    Disk,
    EtcdEndpoint,
    FactsByHost,
    Finding,
    HostFacts,
    ManagerFacts,
    Severity,
    UnreachableHost,
)
from edgectl.model.image import ContainerEngine
from edgectl.model.inventory import Connection, Coordination, Host, Inventory
from edgectl.model.snapshot import Snapshot
from edgectl.names import check_known_names
from edgectl.plugins import PluginGroup, load_plugins
from edgectl.rules.lost_places import list_shared_machines
from edgectl.rules.ros import list_ros_packages
from edgectl.state.manager_state import load_link_capacities
from edgectl.transport.connections import BackoffTransport, SessionPool
from edgectl.transport.preflight import has_ssh_program, list_known_hosts_files
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import track_heartbeats
from edgectl.usecases.plan import find_fleet_shortages
from edgectl.usecases.probe import probe_fleet

_WORKERS = 16


def run_doctor(fleet: Fleet, state: Disk, names: Sequence[str] = (), *, timeout: float = 15.0) -> Diagnosis:
    """Examine this machine and every host, or only those of ``names``. ``state`` is the condition of the
    fleet's state directory. Of all hosts also what the edges lack for the tasks of the files.

    Raises:
        UsageError: a host is unknown.
    """
    check_known_names(names, fleet.inventory.hosts, "host")
    hosts = [
        host for host in fleet.inventory.hosts.values() if host.probe and (not names or host.name in names)
    ]
    manager = _collect_manager_facts(hosts, state, fleet.inventory.coordination)
    with SessionPool(fleet.transport) as pool:
        near = dataclasses.replace(fleet, transport=BackoffTransport(pool))
        answers = _collect_answers(near, hosts, state, timeout)
        whole = not names and bool(fleet.tasks.tasks) and not state.obstacle
        snapshot = _probe_edges(near, answers, timeout) if whole else None
    shortages = None if snapshot is None else find_fleet_shortages(fleet, snapshot)
    shared = _list_shared_machines(fleet.inventory, answers)
    found = diagnose_fleet(fleet.inventory, manager, answers, shortages, snapshot, shared)
    return Diagnosis(findings=(*found.findings, *_run_plugin_checks(fleet.inventory, answers, snapshot)))


def _list_shared_machines(inventory: Inventory, answers: FactsByHost) -> list[tuple[str, str]]:
    found = ((name, answers.get(name)) for name in inventory.hosts)
    identities = {name: facts.machine for name, facts in found if isinstance(facts, HostFacts)}
    return list(list_shared_machines(inventory, identities))


def _run_plugin_checks(
    inventory: Inventory, answers: FactsByHost, snapshot: Snapshot | None
) -> tuple[Finding, ...]:
    """The findings of checks of other packages (ADR 67). One that fails is a finding itself, for the others
    are still worth knowing.
    """
    try:
        plugins = load_plugins(PluginGroup.CHECKS)
    except PluginError as error:
        return (_describe_broken_check(error),)
    findings: list[Finding] = []
    for plugin in plugins:
        try:
            found = tuple(plugin.call(inventory, answers, snapshot))
        except PluginError as error:
            found = (_describe_broken_check(error),)
        if any(not isinstance(each, Finding) for each in found):
            found = (_describe_broken_check(plugin.fail(TypeError("it gave something that is no Finding"))),)
        findings += found
    return tuple(findings)


def _describe_broken_check(error: PluginError) -> Finding:
    return Finding(
        host=None, check="plugins", level=Severity.FAILED, message=error.message, remedy=error.hint
    )


def _probe_edges(fleet: Fleet, answers: FactsByHost, timeout: float) -> Snapshot | None:
    """Probe the hosts; None if no edge answers. Silent hosts are not asked again."""
    if not any(isinstance(answers.get(edge.name), HostFacts) for edge in fleet.inventory.edges):
        return None
    return probe_fleet(fleet, ProbeOptions(timeout=timeout))


def _collect_manager_facts(
    hosts: Sequence[Host], state: Disk, coordination: Coordination | None
) -> ManagerFacts:
    """Collect the facts of this machine; ``ssh -G`` costs one process per host, so all run at once."""
    remote = [host for host in hosts if host.connection is not Connection.LOCAL]
    files = [found for _, found in fan_out(list_known_hosts_files, remote, workers=_WORKERS)]
    return ManagerFacts(
        state=state,
        known_hosts={path: why for found in files for path, why in sorted(found.items())},
        ssh=has_ssh_program(),
        etcd=() if coordination is None else _ask_etcd(coordination),
    )


def _ask_etcd(coordination: Coordination) -> tuple[EtcdEndpoint, ...]:
    """Ask each endpoint alone for a value, which takes a majority of the members."""
    from edgectl.transport.etcd_client import EtcdClient, format_endpoint

    return tuple(
        EtcdEndpoint(
            address=format_endpoint(endpoint),
            **{"version" if isinstance(found, str) else "error": str(found)},
        )
        for endpoint, found in EtcdClient(coordination).read_versions().items()
    )


def _collect_answers(fleet: Fleet, hosts: Sequence[Host], state: Disk, timeout: float) -> FactsByHost:
    """Ask every host for its facts.

    Each request renews the heartbeat of tasks with ``self_fence``, so none is sent where it cannot be
    recorded.
    """
    if state.obstacle and any(task.self_fence is not None for task in fleet.tasks.tasks.values()):
        hint = f"first repair the state directory {state.path}"
        return {
            host.name: UnreachableHost(
                kind="failed",
                error="not asked: a task has self_fence, and heartbeats cannot be recorded",
                hint=hint,
            )
            for host in hosts
        }
    measured = {} if state.obstacle else load_link_capacities(fleet.state, fleet.warn)
    with contextlib.nullcontext(fleet) if state.obstacle else track_heartbeats(fleet) as near:
        packages = {host.name: tuple(list_ros_packages(fleet.tasks.tasks, host)) for host in hosts}
        images = [task.image for task in fleet.tasks.tasks.values() if task.image is not None]
        options = HostFactsOptions(
            timeout=timeout,
            measured=measured,
            packages=packages,
            engines=bool(images),
            swarm=any(image.engine is ContainerEngine.SWARM for image in images),
        )
        return collect_host_facts(fleet.inventory, hosts, near.transport, options, clock=fleet.clock)
