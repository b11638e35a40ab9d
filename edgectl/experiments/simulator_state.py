# SPDX-License-Identifier: Apache-2.0
"""State of a simulation: fair shares of processors and links, task speeds, usage meters."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import simpy

from edgectl.experiments.model.mission_event import EventRecord, HostLoad, MissionEvent
from edgectl.experiments.model.scenario import Radio, Scenario, SimHostUsage
from edgectl.model.demand import ZERO
from edgectl.model.inventory import Inventory, Role
from edgectl.model.link_reading import LinkHistory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.resource import CPU, MEMORY, NETWORK
from edgectl.model.snapshot import LinkSample, TaskSample
from edgectl.model.task import Task, Tasks


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
# A draw from 0 to 1, out of the stream of this name.
UniformDraw = Callable[[str], float]
# Capacity of a link without one in the inventory: 54 Mbit/s, the default of the gateway.
_DEFAULT_LINK_BYTES_PER_S = 6.75e6
# No name of a task begins so.
_BASE_LOAD_NAME = " "


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
class Overlay:
    """What the events of now change: loads by host, bytes/s and added round trips (s) by (edge, robot), hosts
    that do not answer, demands by task and resource.
    """

    loads: dict[str, list[HostLoad]] = field(default_factory=dict)
    throughputs: dict[tuple[str, str], float] = field(default_factory=dict)
    delays: dict[tuple[str, str], float] = field(default_factory=dict)
    lost: set[str] = field(default_factory=set)
    demands: dict[str, dict[str, float]] = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class SimWork:
    """A job that is worked on: the speed of its task ``since`` then, and the robot that it serves alone."""

    task: str
    robot: str | None
    since: float
    speed: float = 0.0
    left: float = 0.0


class SimSample(NamedTuple):
    """What a probe of one host shows: cores and bytes in use, and samples of links and tasks."""

    cpu: float
    memory: float
    links: Mapping[str, LinkSample]
    tasks: Mapping[str, TaskSample]


@dataclass(slots=True, kw_only=True)
class SimState:
    """The mutable state of one run.

    By task: ``cores`` and ``rates`` (bytes/s by robot) are its current shares, ``speeds`` its current speed,
    0..1; ``left`` counts its unfinished jobs. ``done``: jobs that are over, where links or events depend on
    them.
    ``histories``: readings of links by (edge, robot). ``reference``: the first edge, whose capacity scales
    relative demands. ``tasks``: those that have entered, of ``all_tasks``. ``starting``: tasks that a step of
    the plan is about to start. ``happening``: events of which the change holds, by name, as ``overlay`` has
    them; ``happened``: all that ever did. ``working``: jobs in progress; ``robot_work`` and ``robot_done``:
    work by robot, in s, of all its jobs and of those parts of them that are done. ``courses``: with events,
    by task with work, its speed over time, from its entry or its first job up to ``course_ends``.
    ``samples``: what a probe of each host shows until the next change, but for noise.
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
    all_tasks: Tasks = Tasks(tasks={})
    draw_uniform: UniformDraw = lambda _: 0.0
    starting: set[str] = field(default_factory=set)
    overlay: Overlay = field(default_factory=Overlay)
    happening: dict[str, MissionEvent] = field(default_factory=dict)
    happened: set[str] = field(default_factory=set)
    records: list[EventRecord] = field(default_factory=list)
    working: dict[str, SimWork] = field(default_factory=dict)
    ends: set[str] = field(default_factory=set)
    oracle: bool = False
    robot_work: dict[str, float] = field(default_factory=dict)
    robot_done: dict[str, float] = field(default_factory=dict)
    courses: dict[str, list[tuple[float, float | None]]] = field(default_factory=dict)
    course_ends: dict[str, float] = field(default_factory=dict)
    samples: dict[str, SimSample] = field(default_factory=dict)


def list_external_placements(state: SimState) -> Iterable[tuple[str, str]]:
    """(task, host) of unmanaged tasks: as in the scenario, or on the robot under local execution."""
    for name, host in state.scenario.placed.items():
        if name in state.tasks.tasks:
            robots = state.tasks.tasks[name].robots
            yield name, robots[0] if state.policy.name is PolicyName.LOCAL and robots else host


def update_speeds(state: SimState) -> None:
    """Recompute all speeds. Before a service changes, `integrate_loads` has to meter the time until then."""
    state.cores, state.rates, state.speeds = {}, {}, {}
    state.samples.clear()
    for host, services in _group_services(state).items():
        _share_host_resources(state, host, services)
    if state.scenario.radio is Radio.SHARED:
        _share_air_time(state)
    for name, service in state.services.items():
        demand = _compute_demand_cores(state, service)
        shares = [state.cores[name] / demand] if demand > 0 else []
        shares += [
            rate / _compute_demand_bytes_per_s(state, service, robot)
            for robot, rate in state.rates[name].items()
        ]
        state.speeds[name] = min(shares, default=1.0) if service.ready else 0.0
    notify_change(state)


def _group_services(state: SimState) -> dict[str, dict[str, SimTask]]:
    """The services of each host that has some, in the order of the hosts."""
    found: dict[str, dict[str, SimTask]] = {host: {} for host in state.scenario.hosts}
    for name, service in state.services.items():
        found[service.host][name] = service
    return {host: services for host, services in found.items() if services}


def notify_change(state: SimState) -> None:
    """Wake what waits for a change; with events, note how well each task does that has work."""
    if state.scenario.events:
        _record_courses(state)
    state.changed.succeed()
    state.changed = state.env.event()


def _record_courses(state: SimState) -> None:
    """The speed of each task from its entry or its first job to the end of its last one; None while it does
    not run.
    """
    now = state.env.now
    for part in state.working.values():
        state.courses.setdefault(part.task, [])
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


def get_nominal_bytes_per_s(state: SimState, host: str, robot: str) -> float:
    """What the link carries by the inventory, bytes/s."""
    return state.inventory.links.get((host, robot), _DEFAULT_LINK_BYTES_PER_S)


def get_link_bytes_per_s(state: SimState, host: str, robot: str) -> float:
    """What the link carries now; nothing where one of its ends is off."""
    overlay = state.overlay
    if overlay.lost and not overlay.lost.isdisjoint((host, robot)):
        return 0.0
    if (host, robot) in overlay.throughputs:
        return overlay.throughputs[host, robot]
    found = get_nominal_bytes_per_s(state, host, robot)
    for change in state.scenario.links:
        if (change.edge, change.robot) == (host, robot) and state.done.issuperset(change.after):
            found = change.throughput
    return found


def _compute_demand_cores(state: SimState, service: SimTask) -> float:
    """CPU demand in cores.

    A relative demand is a share of the first edge, where it was measured, on every host.
    """
    changed = state.overlay.demands.get(service.task.name)
    if changed is not None and CPU.name in changed:
        return changed[CPU.name]
    return (service.task.demand["cpu"] or ZERO).of(state.scenario.hosts[state.reference].cores)


def compute_demand_bytes(state: SimState, service: SimTask) -> float:
    """Memory that the task uses, in bytes."""
    changed = state.overlay.demands.get(service.task.name)
    if changed is not None and MEMORY.name in changed:
        return changed[MEMORY.name]
    return (service.task.demand["memory"] or ZERO).of(state.scenario.hosts[state.reference].memory)


def _compute_demand_bytes_per_s(state: SimState, service: SimTask, robot: str) -> float:
    changed = state.overlay.demands.get(service.task.name)
    if changed is not None and NETWORK.name in changed:
        return changed[NETWORK.name]
    return (service.task.demand["network"] or ZERO).of(get_nominal_bytes_per_s(state, state.reference, robot))


def integrate_loads(state: SimState) -> None:
    """Add the loads since the last event to the meters."""
    seconds = state.env.now - state.metered_at
    state.metered_at = state.env.now
    if seconds <= 0:
        return
    for host, meter in state.meters.items():
        cpu, memory, network = compute_host_load(state, host)
        machine = state.scenario.hosts[host]
        meter.cpu += seconds * cpu / machine.cores
        meter.cpu_peak = max(meter.cpu_peak, cpu / machine.cores)
        meter.memory += seconds * memory / machine.memory
        meter.network += seconds * network
        for name, service in state.services.items():
            if service.host == host and service.ready and name in state.scenario.rate:
                meter.rate += seconds * state.speeds.get(name, 0.0) * state.scenario.rate[name]
                meter.rated_s += seconds


def compute_host_load(state: SimState, host: str) -> tuple[float, float, float]:
    """Cores, bytes and bytes/s in use now."""
    machine = state.scenario.hosts[host]
    if host in state.overlay.lost:
        return 0.0, 0.0, 0.0
    services = {name: service for name, service in state.services.items() if service.host == host}
    used = sum(state.cores.get(name, 0.0) for name in services)
    memory = machine.base_memory + sum(compute_demand_bytes(state, service) for service in services.values())
    base_cores = machine.base_cores
    for load in state.overlay.loads.get(host, ()):
        base_cores += load.cpu
        memory += load.memory
    network = sum(rate for name in services for rate in state.rates.get(name, {}).values())
    return used + min(base_cores, machine.cores - used), min(memory, machine.memory), network


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
