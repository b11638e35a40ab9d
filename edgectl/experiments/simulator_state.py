"""State of a simulation: fair shares of processors and links, task speeds, usage meters, simulated probes."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import simpy

from edgectl.experiments.model.scenario import Scenario, SimHostUsage
from edgectl.model.demand import ZERO
from edgectl.model.inventory import Inventory, Role
from edgectl.model.link_reading import LinkHistory, LinkObservation, LinkSampleResult
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
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
from edgectl.model.task import Task, Tasks
from edgectl.rules.live_links import add_sample, apply_live_capacities, choose_links_to_probe, observe_link


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


# A draw from the standard normal distribution.
NormalDraw = Callable[[], float]
# Capacity of a link without one in the inventory: 54 Mbit/s, the default of the gateway.
_DEFAULT_LINK_BYTES_PER_S = 6.75e6
_BASE_LOAD_NAME = ""
# Standard deviation of the logarithm of what a probe of an idle link reads.
_PROBE_SPREAD = 0.05


@dataclass(slots=True, kw_only=True)
class SimTask:
    """One task on one host."""

    task: Task
    host: str
    since: float
    ready: bool = False


@dataclass(slots=True, kw_only=True)
class HostMeter:
    """Integrals over the time of one run, for one host."""

    cpu: float = 0.0
    cpu_peak: float = 0.0
    memory: float = 0.0
    network: float = 0.0
    rate: float = 0.0
    rated_s: float = 0.0


@dataclass(slots=True, kw_only=True)
class SimState:
    """The mutable state of one run.

    By task: ``cores`` and ``rates`` (bytes/s by robot) are its current shares, ``speeds`` its current speed,
    0..1; ``left`` counts its unfinished jobs. ``done``: jobs that are over, where links depend on them.
    ``histories``: readings of links by (edge, robot). ``reference``: the first edge, whose capacity scales
    relative demands.
    """

    env: simpy.Environment
    inventory: Inventory
    tasks: Tasks
    scenario: Scenario
    policy: Policy
    draw_normal: NormalDraw
    changed: simpy.Event
    reference: str
    services: dict[str, SimTask] = field(default_factory=dict)
    cores: dict[str, float] = field(default_factory=dict)
    rates: dict[str, dict[str, float]] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    meters: dict[str, HostMeter] = field(default_factory=dict)
    left: dict[str, int] = field(default_factory=dict)
    manager: ManagerState = field(default_factory=lambda: ManagerState(managed=True))
    done: set[str] = field(default_factory=set)
    histories: dict[tuple[str, str], LinkHistory] = field(default_factory=dict)
    metered_at: float = 0.0
    handoffs: int = 0
    unplaced: int = 0


def update_speeds(state: SimState) -> None:
    """Recompute all speeds. Before a service changes, `integrate_loads` has to meter the time until then."""
    state.cores, state.rates, state.speeds = {}, {}, {}
    for host in state.scenario.hosts:
        services = {name: service for name, service in state.services.items() if service.host == host}
        _share_host_resources(state, host, services)
    for name, service in state.services.items():
        demand = _compute_demand_cores(state, service)
        shares = [state.cores[name] / demand] if demand > 0 else []
        shares += [
            rate / _compute_demand_bytes_per_s(state, service, robot)
            for robot, rate in state.rates[name].items()
        ]
        state.speeds[name] = min(shares, default=1.0) if service.ready else 0.0
    state.changed.succeed()
    state.changed = state.env.event()


def _share_host_resources(state: SimState, host: str, services: Mapping[str, SimTask]) -> None:
    """Share the CPU and the links of one host. A starting task uses CPU already, but no link."""
    machine = state.scenario.hosts[host]
    demands = {name: _compute_demand_cores(state, service) for name, service in services.items()}
    shares_by_name = compute_fair_shares(machine.cores, {**demands, _BASE_LOAD_NAME: machine.base_cores})
    state.cores |= {name: shares_by_name[name] for name in demands}
    state.rates |= {name: {} for name in services}
    for robot in dict.fromkeys(
        robot for service in services.values() for robot in _list_remote_robots(state, service)
    ):
        rates = {
            name: _compute_demand_bytes_per_s(state, service, robot)
            for name, service in services.items()
            if service.ready and robot in _list_remote_robots(state, service)
        }
        for name, rate in compute_fair_shares(_get_link_bytes_per_s(state, host, robot), rates).items():
            if rates[name] > 0:
                state.rates[name][robot] = rate


def _list_remote_robots(state: SimState, service: SimTask) -> tuple[str, ...]:
    """Robots that the task reaches over a link; none for a task on a robot."""
    return () if state.inventory.hosts[service.host].role is Role.ROBOT else service.task.robots


def _get_nominal_bytes_per_s(state: SimState, host: str, robot: str) -> float:
    return state.inventory.links.get((host, robot), _DEFAULT_LINK_BYTES_PER_S)


def _get_link_bytes_per_s(state: SimState, host: str, robot: str) -> float:
    """What the link carries now."""
    found = _get_nominal_bytes_per_s(state, host, robot)
    for change in state.scenario.links:
        if (change.edge, change.robot) == (host, robot) and state.done.issuperset(change.after):
            found = change.throughput
    return found


def _compute_demand_cores(state: SimState, service: SimTask) -> float:
    """CPU demand in cores.

    A relative demand is a share of the first edge, where it was measured, on every host.
    """
    return (service.task.demand["cpu"] or ZERO).of(state.scenario.hosts[state.reference].cores)


def _compute_demand_bytes(state: SimState, service: SimTask) -> float:
    return (service.task.demand["memory"] or ZERO).of(state.scenario.hosts[state.reference].memory)


def _compute_demand_bytes_per_s(state: SimState, service: SimTask, robot: str) -> float:
    return (service.task.demand["network"] or ZERO).of(
        _get_nominal_bytes_per_s(state, state.reference, robot)
    )


def integrate_loads(state: SimState) -> None:
    """Add the loads since the last event to the meters."""
    seconds = state.env.now - state.metered_at
    state.metered_at = state.env.now
    if seconds <= 0:
        return
    for host, meter in state.meters.items():
        cpu, memory, network = _compute_host_load(state, host)
        machine = state.scenario.hosts[host]
        meter.cpu += seconds * cpu / machine.cores
        meter.cpu_peak = max(meter.cpu_peak, cpu / machine.cores)
        meter.memory += seconds * memory / machine.memory
        meter.network += seconds * network
        for name, service in state.services.items():
            if service.host == host and service.ready and name in state.scenario.rate:
                meter.rate += seconds * state.speeds.get(name, 0.0) * state.scenario.rate[name]
                meter.rated_s += seconds


def _compute_host_load(state: SimState, host: str) -> tuple[float, float, float]:
    """Cores, bytes and bytes/s in use now."""
    machine = state.scenario.hosts[host]
    services = {name: service for name, service in state.services.items() if service.host == host}
    used = sum(state.cores.get(name, 0.0) for name in services)
    memory = machine.base_memory + sum(_compute_demand_bytes(state, service) for service in services.values())
    network = sum(rate for name in services for rate in state.rates.get(name, {}).values())
    return used + min(machine.base_cores, machine.cores - used), min(memory, machine.memory), network


def compute_host_usage(state: SimState, host: str) -> SimHostUsage:
    """Usage of one host since the start of the run; call `integrate_loads` before."""
    meter, seconds = state.meters[host], max(state.env.now, 1e-9)
    return SimHostUsage(
        cpu=meter.cpu / seconds,
        cpu_peak=meter.cpu_peak,
        memory=meter.memory / seconds,
        network_bytes_per_s=meter.network / seconds,
        rate=meter.rate / meter.rated_s if meter.rated_s else None,
    )


def simulate_probe(state: SimState) -> Snapshot:
    """The snapshot of a probe now, with noise on its CPU readings and on probes of idle links."""
    snapshot = Snapshot(
        taken_at=state.env.now,
        hosts={host: _simulate_host_sample(state, host) for host in state.scenario.hosts},
        manager=state.manager,
    )
    return (
        _read_live_links(state, snapshot) if state.scenario.links and state.scenario.live_links else snapshot
    )


def _read_live_links(state: SimState, snapshot: Snapshot) -> Snapshot:
    """The snapshot with live capacities, by the rules of ``watch``: read from traffic, probed where idle."""
    now = snapshot.taken_at
    seen = {
        (edge, robot): _observe_link(state, edge, robot, link.used_bytes_per_s)
        for edge, sample in snapshot.hosts.items()
        for robot, link in sample.links.items()
    }
    known = {
        pair: observe_link(state.histories.get(pair, LinkHistory()), link, now) for pair, link in seen.items()
    }
    live = apply_live_capacities(snapshot, known, seen, now)
    for edge, robot in choose_links_to_probe(state.inventory, live, known, seen, now):
        known[edge, robot] = add_sample(known[edge, robot], _probe_link(state, edge, robot), None, now)
    state.histories = known
    return apply_live_capacities(snapshot, known, seen, now)


def _observe_link(state: SimState, edge: str, robot: str, used: float) -> LinkObservation:
    full = used >= _get_link_bytes_per_s(state, edge, robot) * (1 - 1e-9)
    return LinkObservation(
        used_bytes_per_s=used, carries_bytes_per_s=used if full else None, interface="wlan0"
    )


def _probe_link(state: SimState, edge: str, robot: str) -> LinkSampleResult:
    nominal, carries = _get_nominal_bytes_per_s(state, edge, robot), _get_link_bytes_per_s(state, edge, robot)
    if carries >= nominal:
        return LinkSampleResult(bytes_per_s=nominal)
    return LinkSampleResult(bytes_per_s=carries * math.exp(_PROBE_SPREAD * state.draw_normal()), full=True)


def _simulate_host_sample(state: SimState, host: str) -> HostSample:
    machine, role = state.scenario.hosts[host], state.inventory.hosts[host].role
    cpu, memory, _ = _compute_host_load(state, host)
    noise = state.draw_normal() * state.scenario.timing.noise * machine.cores
    services = {name: service for name, service in state.services.items() if service.host == host}
    robots = [robot.name for robot in state.inventory.robots] if role is Role.EDGE else []
    return HostSample(
        role=role,
        status=HostStatus.OK,
        usage={
            CPU.name: ResourceUsage(capacity=machine.cores, used=min(machine.cores, max(0.0, cpu + noise))),
            MEMORY.name: ResourceUsage(capacity=machine.memory, used=memory),
        },
        links={
            robot: LinkSample(
                capacity_bytes_per_s=_get_nominal_bytes_per_s(state, host, robot),
                used_bytes_per_s=sum(state.rates.get(name, {}).get(robot, 0.0) for name in services),
            )
            for robot in robots
        },
        tasks={name: _simulate_task_sample(state, service) for name, service in services.items()},
    )


def _simulate_task_sample(state: SimState, service: SimTask) -> TaskSample:
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
            memory=_compute_demand_bytes(state, service),
            network=sum(rates.values()),
        ),
        links=dict(rates),
        instance=name,
        spec_hash=service.task.spec_hash,
        managed=service.task.managed,
    )
