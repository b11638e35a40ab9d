# SPDX-License-Identifier: Apache-2.0
"""Speeds of simulated tasks that work on one item after the other, and of jobs that need their results."""

import math
from collections.abc import Mapping

from edgectl.experiments.model.scenario import Radio, SimCycle, SimJob
from edgectl.experiments.simulator_cycles import Customer, Flow, Station, compute_flows
from edgectl.experiments.simulator_state import SimState, get_link_bytes_per_s
from edgectl.model.resource import CPU, NETWORK

# A program uses one core at a time.
_PROGRAM_CORES = 1.0
# However little the others leave of a host, work on it ends one day.
_LEAST_CORES = 1e-3
# A link is read from traffic that fills it in this share of the time.
_FILLED_SHARE = 0.1
# The one station of all links that share the air time of a channel.
_AIR = " air"


def select_ready_cycles(state: SimState) -> Mapping[str, SimCycle]:
    """The cycle, as events have changed it, of each task that runs and is ready."""
    return {
        name: _change_cycle(state, name, cycle)
        for name, cycle in state.scenario.cycles.items()
        if name in state.services and state.services[name].ready
    }


def _change_cycle(state: SimState, name: str, cycle: SimCycle) -> SimCycle:
    changed = state.overlay.demands.get(name)
    if changed is None:
        return cycle
    return SimCycle(
        rate=cycle.rate,
        cpu=changed.get(CPU.name, cycle.cpu * cycle.rate) / cycle.rate,
        transfer=changed.get(NETWORK.name, cycle.transfer * cycle.rate) / cycle.rate,
        source=cycle.source,
        source_cpu=cycle.source_cpu,
    )


def share_by_cycles(state: SimState, cycles: Mapping[str, SimCycle]) -> None:
    """Set what tasks with cycles use and achieve, of what all others leave, which are shared before."""
    stations: dict[str, Station] = {}
    customers: dict[str, Customer] = {}
    places: dict[str, int] = {}
    for name, cycle in cycles.items():
        state.cores[name], state.rates[name], state.speeds[name] = 0.0, {}, 0.0
        work = _list_work(state, name, cycle, stations)
        if work is not None:
            customers[name] = Customer(
                rate=cycle.rate,
                work=tuple((places.setdefault(at, len(places)), amount) for at, amount in work),
            )
    flows = compute_flows(tuple(stations[at] for at in places), tuple(customers.values()))
    for name, flow in zip(customers, flows, strict=True):
        _note_flow(state, name, cycles[name], flow)


def _list_work(
    state: SimState, name: str, cycle: SimCycle, stations: dict[str, Station]
) -> list[tuple[str, float]] | None:
    """What an item needs of each station, which is added to ``stations``; None: no item gets through."""
    host, work = state.services[name].host, list[tuple[str, float]]()
    if cycle.source:
        source = state.services.get(cycle.source)
        if source is None or not source.ready:
            return None
        work.append((_add_host(state, source.host, stations), cycle.source_cpu))
    for robot in state.services[name].task.robots:
        if robot != host and cycle.transfer > 0:
            carries = get_link_bytes_per_s(state, host, robot)
            if carries <= 0:
                return None
            shared = state.scenario.radio is Radio.SHARED
            at = _AIR if shared else f"{host} {robot}"
            stations[at] = Station(capacity=1.0 if shared else carries)
            work.append((at, cycle.transfer / carries if shared else cycle.transfer))
    work.append((_add_host(state, host, stations), cycle.cpu))
    return [(at, amount) for at, amount in work if amount > 0]


def _add_host(state: SimState, host: str, stations: dict[str, Station]) -> str:
    if host not in stations:
        machine = state.scenario.hosts[host]
        taken = sum(
            cores
            for name, cores in state.cores.items()
            if state.services[name].host == host and name not in state.scenario.cycles
        )
        stations[host] = Station(
            capacity=max(_LEAST_CORES, machine.cores - machine.base_cores - taken),
            width=_PROGRAM_CORES,
            period=machine.period,
            rivals=sum(math.ceil(load.cpu) for load in state.overlay.loads.get(host, ())),
        )
    return host


def _note_flow(state: SimState, name: str, cycle: SimCycle, flow: Flow) -> None:
    state.flows[name] = flow
    state.speeds[name] = min(1.0, flow.rate / cycle.rate)
    state.cores[name] += flow.rate * cycle.cpu
    if cycle.source:
        state.cores[cycle.source] += flow.rate * cycle.source_cpu
    host = state.services[name].host
    for robot in state.services[name].task.robots:
        if robot != host and cycle.transfer > 0:
            state.rates[name][robot] = flow.rate * cycle.transfer


def is_filled_at_times(state: SimState, edge: str, robot: str, carries: float) -> bool:
    """Whether a task with cycles fills the link while it fetches items, so that TCP can tell its rate."""
    return any(
        name in state.services
        and state.services[name].host == edge
        and state.rates.get(name, {}).get(robot, 0.0) >= _FILLED_SHARE * carries
        for name in state.scenario.cycles
    )


def get_job_speed(state: SimState, job: SimJob) -> float:
    """The speed of a job now: that of its task, less where results of its senses are old."""
    speed = state.speeds.get(job.task, 0.0)
    return speed * min((_compute_sight(state, job, sense) for sense in job.senses), default=1.0)


def _compute_sight(state: SimState, job: SimJob, sense: str) -> float:
    """The share of full speed at the mean age of the newest result of a sense. While it moves, none comes."""
    flow = state.flows.get(sense)
    if flow is None or flow.rate <= 0:
        return 0.0
    service = state.services.get(sense)
    timing = state.scenario.timing
    gap = 0.0 if service is not None and service.ready else timing.stop + timing.start
    return job.fresh / compute_mean_age_s(flow.age, flow.age + gap + 1.0 / flow.rate, job.fresh)


def compute_mean_age_s(youngest: float, oldest: float, least: float) -> float:
    """Mean of an age (s) that grows evenly between these two; below ``least`` it counts as that."""
    if oldest <= least:
        return least
    begin = max(youngest, least)
    grown = (oldest * oldest - begin * begin) / 2.0
    return (least * (begin - youngest) + grown) / (oldest - youngest)
