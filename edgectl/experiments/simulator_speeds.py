# SPDX-License-Identifier: Apache-2.0
"""Speeds of simulated tasks: fair shares of processors and links, or the flow of items through both."""

from collections.abc import Hashable, Mapping

from edgectl.experiments.simulator_flows import get_job_speed, select_ready_cycles, share_by_cycles
from edgectl.experiments.simulator_memory import KnownShares, SimMemory, join_shares
from edgectl.experiments.simulator_state import (
    SimState,
    SimTask,
    describe_links,
    do_hosts_share,
    forget_probe,
    get_link_bytes_per_s,
    get_nominal_bytes_per_s,
    group_services,
    measure_host,
    measure_hosts,
)
from edgectl.model.demand import ZERO
from edgectl.model.inventory import Role
from edgectl.model.resource import CPU, NETWORK

# No name of a task begins so.
_BASE_LOAD_NAME = " "


def compute_fair_shares(capacity: float, demands: Mapping[str, float]) -> dict[str, float]:
    """Max-min fair shares of ``capacity`` by name; both in the same unit, >= 0.

    No share exceeds its demand, no unsatisfied name gets less than another, and nothing is left while a name
    is unsatisfied. A kernel's fair scheduler, and flows over one bottleneck, come close to this.
    """
    shares = dict.fromkeys(demands, 0.0)
    left, unsatisfied = capacity, sorted(demands, key=lambda name: (demands[name], name))
    while unsatisfied:
        share = left / len(unsatisfied)
        name = unsatisfied[0]
        if demands[name] >= share:
            return shares | dict.fromkeys(unsatisfied, share)
        shares[name] = demands[name]
        left -= demands[name]
        unsatisfied.pop(0)
    return shares


def update_speeds(state: SimState) -> None:
    """Recompute all speeds. Before a service changes, `integrate_loads` has to meter the time until then."""
    forget_probe(state)
    if state.memory is None:
        _compute_speeds(state)
    else:
        _recall_speeds(state, state.memory)
    notify_change(state)


def _recall_speeds(state: SimState, memory: SimMemory) -> None:
    """The speeds as they were the last time when the same tasks were on the same hosts."""
    state.shared = describe_shares(state)
    known = memory.shares.get(state.shared)
    if known is None:
        known = _recall_hosts(state, memory)
        memory.add_shares(state.shared, known)
    state.cores, state.rates, state.speeds, state.known = known.cores, known.rates, known.speeds, known


def _recall_hosts(state: SimState, memory: SimMemory) -> KnownShares:
    """The speeds from those of each host, which its own tasks and links decide, unless a radio is shared."""
    if do_hosts_share(state.scenario):
        _compute_speeds(state)
        return KnownShares(state.cores, state.rates, state.speeds, measure_hosts(state))
    links, parts = describe_links(state), list[KnownShares]()
    for host, services in group_services(state).items():
        key = host, links, tuple([(name, each.ready) for name, each in services.items()])
        part = memory.hosts.get(key)
        if part is None:
            part = _compute_host_shares(state, host, services)
            memory.add_host(key, part)
        parts.append(part)
    return join_shares(parts)


def _compute_host_shares(state: SimState, host: str, services: Mapping[str, SimTask]) -> KnownShares:
    state.cores, state.rates, state.speeds = {}, {}, {}
    _share_host_resources(state, host, services)
    for name, service in services.items():
        _set_speed(state, name, service)
    return KnownShares(state.cores, state.rates, state.speeds, {host: measure_host(state, host, services)})


def describe_shares(state: SimState) -> Hashable:
    """Equal where speeds and loads are, in a mission without events and cycles. Sums depend on the order."""
    services = [(name, each.host, each.ready) for name, each in state.services.items()]
    return describe_links(state), tuple(services)


def _compute_speeds(state: SimState) -> None:
    state.cores, state.rates, state.speeds = {}, {}, {}
    cycles = select_ready_cycles(state)
    for host, services in group_services(state, cycles).items():
        if services:
            _share_host_resources(state, host, services)
    if do_hosts_share(state.scenario):
        _share_air_time(state)
    for name, service in state.services.items():
        if name not in cycles:
            _set_speed(state, name, service)
    if cycles:
        share_by_cycles(state, cycles)


def _set_speed(state: SimState, name: str, service: SimTask) -> None:
    """The least of the shares of its demands that a task gets."""
    demand = _compute_demand_cores(state, service)
    shares = [state.cores[name] / demand] if demand > 0 else []
    shares += [
        rate / _compute_demand_bytes_per_s(state, service, robot) for robot, rate in state.rates[name].items()
    ]
    state.speeds[name] = min(shares, default=1.0) if service.ready else 0.0


def notify_change(state: SimState) -> None:
    """Wake what waits for a change, and the jobs whose speed is another; with events, note how well each task
    does that has work.
    """
    if state.scenario.events:
        _record_courses(state)
    for part in state.working.values():
        if part.changed is not None and get_job_speed(state, part.job) != part.speed:
            part.changed.succeed()
            part.changed = None
    if state.changed.callbacks:
        state.changed.succeed()
        state.changed = state.env.event()


def _record_courses(state: SimState) -> None:
    """The speed of each task from its entry or its first job to the end of its last one; None while it does
    not run.
    """
    now = state.env.now
    for part in state.working.values():
        state.courses.setdefault(part.job.task, [])
    for name, points in state.courses.items():
        if state.left[name] == 0:
            state.course_ends.setdefault(name, now)
            continue
        service = state.services.get(name)
        value = state.speeds[name] if service is not None and service.ready else None
        if points and points[-1][0] == now:
            points.pop()
        if not points or points[-1][1] != value:
            points.append((now, value))


def _share_host_resources(state: SimState, host: str, services: Mapping[str, SimTask]) -> None:
    """Share the CPU and the links of one host. A starting task uses CPU already, but no link."""
    machine = state.scenario.hosts[host]
    demands = {name: _compute_demand_cores(state, service) for name, service in services.items()}
    others = {
        f"{_BASE_LOAD_NAME}{number}": load.cpu
        for number, load in enumerate(state.overlay.loads.get(host, ()), start=1)
    }
    shares_by_name = compute_fair_shares(
        machine.cores, {**demands, **others, _BASE_LOAD_NAME: machine.base_cores}
    )
    state.cores.update((name, shares_by_name[name]) for name in demands)
    state.rates.update((name, {}) for name in services)
    if state.inventory.hosts[host].role is Role.ROBOT:
        return  # a task on a robot needs no link
    for robot in dict.fromkeys(robot for service in services.values() for robot in service.task.robots):
        rates = {
            name: _compute_demand_bytes_per_s(state, service, robot)
            for name, service in services.items()
            if service.ready and robot in service.task.robots
        }
        for name, rate in compute_fair_shares(get_link_bytes_per_s(state, host, robot), rates).items():
            if rates[name] > 0:
                state.rates[name][robot] = rate


def _share_air_time(state: SimState) -> None:
    """Lower the rates to what one channel carries: each flow takes the share of the time that it takes of its
    link, and the channel divides its time fairly (max-min).
    """
    times = {
        f"{name} {robot}": rate / get_link_bytes_per_s(state, state.services[name].host, robot)
        for name, rates in state.rates.items()
        for robot, rate in rates.items()
        if rate > 0
    }
    shares = compute_fair_shares(1.0, times)
    for name, rates in state.rates.items():
        for robot in rates:
            time = times.get(f"{name} {robot}")
            if time is not None:
                rates[robot] *= shares[f"{name} {robot}"] / time


def _compute_demand_cores(state: SimState, service: SimTask) -> float:
    """CPU demand in cores.

    A relative demand is a share of the first edge, where it was measured, on every host.
    """
    changed = state.overlay.demands.get(service.task.name)
    if changed is not None and CPU.name in changed:
        return changed[CPU.name]
    return (service.task.demand["cpu"] or ZERO).of(state.scenario.hosts[state.reference].cores)


def _compute_demand_bytes_per_s(state: SimState, service: SimTask, robot: str) -> float:
    changed = state.overlay.demands.get(service.task.name)
    if changed is not None and NETWORK.name in changed:
        return changed[NETWORK.name]
    return (service.task.demand["network"] or ZERO).of(get_nominal_bytes_per_s(state, state.reference, robot))
