# SPDX-License-Identifier: Apache-2.0
"""Simulated probes: the snapshot that the scheduler sees of a simulation."""

import math
from collections.abc import Mapping
from dataclasses import replace

from edgectl.experiments.simulator_flows import is_filled_at_times
from edgectl.experiments.simulator_memory import SimSample
from edgectl.experiments.simulator_state import (
    SimState,
    SimTask,
    compute_demand_bytes,
    compute_host_load,
    describe_links,
    do_hosts_share,
    get_link_bytes_per_s,
    get_nominal_bytes_per_s,
    measure_hosts,
)
from edgectl.model.inventory import Role
from edgectl.model.link_reading import LinkHistory, LinkObservation, LinkSampleResult
from edgectl.model.resource import CPU, MEMORY, Usage
from edgectl.model.snapshot import (
    HostSample,
    HostStatus,
    LinkSample,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.rules.link_turns import choose_links_to_probe, find_link_use
from edgectl.rules.live_links import add_sample, apply_live_capacities, forget_former_readings, observe_link

# Standard deviation of the logarithm of what a probe of an idle link reads.
_PROBE_SPREAD = 0.05


def simulate_probe(state: SimState) -> Snapshot:
    """The snapshot of a probe now, with noise on its CPU readings and on probes of idle links."""
    if state.scenario.events:
        answering = {host: state.env.now for host in state.scenario.hosts if host not in state.overlay.lost}
        state.manager = replace(state.manager, contact={**state.manager.contact, **answering})
    snapshot = Snapshot(
        taken_at=state.env.now,
        hosts={host: _simulate_host_sample(state, host) for host in state.scenario.hosts},
        manager=state.manager,
    )
    return _read_live_links(state, snapshot) if do_links_change(state) else snapshot


def pass_probe(state: SimState) -> None:
    """A probe of which nobody reads the snapshot: what else it leaves behind, the draws included."""
    if state.scenario.events or do_links_change(state):
        simulate_probe(state)
        return
    for _ in state.scenario.hosts:
        state.draw_normal()


def do_links_change(state: SimState) -> bool:
    """Whether live capacities of links are read in this scenario."""
    scenario = state.scenario
    return scenario.live_links and (
        bool(scenario.links)
        or any(event.link is not None or event.lost is not None for event in scenario.events)
    )


def _read_live_links(state: SimState, snapshot: Snapshot) -> Snapshot:
    """The snapshot with live capacities, by the rules of ``watch``: read from traffic, probed where idle."""
    now = snapshot.taken_at
    seen = {
        (edge, robot): _observe_link(state, edge, robot, link.used_bytes_per_s)
        for edge, sample in snapshot.hosts.items()
        for robot, link in sample.links.items()
    }
    observed = {
        pair: observe_link(
            state.histories.get(pair, LinkHistory()), link, now, get_nominal_bytes_per_s(state, *pair)
        )
        for pair, link in seen.items()
    }
    known = forget_former_readings(observed, now)
    live = apply_live_capacities(snapshot, known, seen, now)
    use = find_link_use(live, {name: each.task.robots for name, each in state.services.items()})
    for edge, robot in choose_links_to_probe(state.inventory, live, known, seen, now, use):
        nominal = get_nominal_bytes_per_s(state, edge, robot)
        known[edge, robot] = add_sample(
            known[edge, robot], _probe_link(state, edge, robot), None, now, nominal
        )
    state.histories = known
    return apply_live_capacities(snapshot, known, seen, now)


def _observe_link(state: SimState, edge: str, robot: str, used: float) -> LinkObservation:
    carries = get_link_bytes_per_s(state, edge, robot)
    full = used if used >= carries * (1 - 1e-9) else None
    filled = is_filled_at_times(state, edge, robot, carries) and _is_burst_read(state, edge, robot)
    return LinkObservation(
        used_bytes_per_s=used,
        carries_bytes_per_s=carries if filled else full,
        interface="wlan0",
        answered=carries > 0.0,
    )


def _is_burst_read(state: SimState, edge: str, robot: str) -> bool:
    """Whether this window meets the middle of a burst (ADR 126)."""
    share = state.scenario.timing.bursts
    return share >= 1.0 or state.draw_uniform(f"burst {edge} {robot}") < share


def _probe_link(state: SimState, edge: str, robot: str) -> LinkSampleResult:
    nominal, carries = get_nominal_bytes_per_s(state, edge, robot), get_link_bytes_per_s(state, edge, robot)
    if carries >= nominal:
        return LinkSampleResult(bytes_per_s=nominal)
    return LinkSampleResult(bytes_per_s=carries * math.exp(_PROBE_SPREAD * state.draw_normal()), full=True)


def _simulate_host_sample(state: SimState, host: str) -> HostSample:
    machine, role = state.scenario.hosts[host], state.inventory.hosts[host].role
    sample = state.samples.get(host)
    if sample is None:
        sample = state.samples[host] = _build_sample(state, host)
    used = _add_noise(state, host, sample.cpu)
    if host in state.overlay.lost:
        return HostSample(role=role, status=HostStatus.UNREACHABLE, error="lost")
    return HostSample(
        role=role,
        status=HostStatus.OK,
        usage={
            CPU.name: ResourceUsage(capacity=machine.cores, used=used),
            MEMORY.name: ResourceUsage(capacity=machine.memory, used=sample.memory),
        },
        links=sample.links,
        tasks=sample.tasks,
    )


def read_cpu(state: SimState) -> dict[str, float]:
    """The CPU in use by host, as a probe of a known state shows it now: with the same draws."""
    used = state.known.used if state.known is not None else measure_hosts(state)
    return {host: _add_noise(state, host, used[host].cpu) for host in state.scenario.hosts}


def _add_noise(state: SimState, host: str, cpu: float) -> float:
    """A reading (cores) of a host that uses ``cpu``."""
    cores = state.scenario.hosts[host].cores
    noise = state.draw_normal() * state.scenario.timing.noise * cores
    return min(cores, max(0.0, cpu + noise))


def _build_sample(state: SimState, host: str) -> SimSample:
    """What the probe shows until something changes: known where the host was in this state before."""
    services = {name: service for name, service in state.services.items() if service.host == host}
    if state.memory is None or do_hosts_share(state.scenario):
        return _measure_sample(state, host, services)
    over = tuple([(name, each.ready, state.left.get(name) == 0) for name, each in services.items()])
    key = host, describe_links(state), over
    known = state.memory.samples.get(key)
    if known is None:
        known = _measure_sample(state, host, services)
        state.memory.add_sample(key, known)
    return known._replace(
        tasks={
            name: _date_task_sample(known.tasks[name], service.since) for name, service in services.items()
        }
    )


def _measure_sample(state: SimState, host: str, services: Mapping[str, SimTask]) -> SimSample:
    cpu, memory, *_ = (
        compute_host_load(state, host, services) if state.known is None else state.known.used[host]
    )
    on_edge = state.inventory.hosts[host].role is Role.EDGE
    robots = [robot.name for robot in state.inventory.robots] if on_edge else []
    return SimSample(
        cpu=cpu,
        memory=memory,
        links={
            robot: LinkSample(
                capacity_bytes_per_s=get_nominal_bytes_per_s(state, host, robot),
                used_bytes_per_s=sum(state.rates.get(name, {}).get(robot, 0.0) for name in services),
                rtt_ms=1000.0 * state.overlay.delays[host, robot]
                if (host, robot) in state.overlay.delays
                else None,
            )
            for robot in robots
        },
        tasks={name: _measure_task_sample(state, service) for name, service in services.items()},
    )


def _measure_task_sample(state: SimState, service: SimTask) -> TaskSample:
    name = service.task.name
    over = state.left.get(name) == 0
    task_state = TaskState.COMPLETED if over else TaskState.READY if service.ready else TaskState.STARTING
    rates = state.rates.get(name, {})
    return TaskSample(
        state=task_state,
        pid=1,
        started_at=service.since,
        used=Usage(
            cpu=state.cores.get(name, 0.0),
            memory=compute_demand_bytes(state, service),
            network=sum(rates.values()),
        ),
        links=dict(rates),
        instance=name,
        spec_hash=service.task.spec_hash,
        managed=service.task.managed,
    )


def _date_task_sample(known: TaskSample, since: float) -> TaskSample:
    """The same of an instance that was started then. `dataclasses.replace` takes three times as long."""
    return TaskSample(
        state=known.state,
        pid=known.pid,
        started_at=since,
        used=known.used,
        links=known.links,
        instance=known.instance,
        spec_hash=known.spec_hash,
        managed=known.managed,
    )
