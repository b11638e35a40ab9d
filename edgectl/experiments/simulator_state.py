# SPDX-License-Identifier: Apache-2.0
"""State of a simulation: what runs, what events change, what hosts and links give, usage meters."""

from collections.abc import Callable, Container, Hashable, Iterable, Mapping
from dataclasses import dataclass, field

import simpy

from edgectl.experiments.model.mission_event import EventRecord, HostLoad, MissionEvent
from edgectl.experiments.model.scenario import Radio, Scenario, SimHostUsage, SimJob
from edgectl.experiments.simulator_cycles import Flow
from edgectl.experiments.simulator_memory import HostUse, KnownShares, SimMemory, SimSample
from edgectl.model.demand import ZERO
from edgectl.model.inventory import Inventory
from edgectl.model.link_reading import LinkHistory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Step
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.resource import MEMORY
from edgectl.model.task import Task, Tasks

# A draw from the standard normal distribution.
NormalDraw = Callable[[], float]
# A draw from 0 to 1, out of the stream of this name.
UniformDraw = Callable[[str], float]
# Capacity of a link without one in the inventory: 54 Mbit/s, the default of the gateway.
_DEFAULT_LINK_BYTES_PER_S = 6.75e6


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
    """A job that is worked on: its speed ``since`` then, and the robot that it serves alone.

    ``changed`` happens when the speed becomes another; None while nothing waits for it.
    """

    job: SimJob
    robot: str | None
    since: float
    speed: float = 0.0
    left: float = 0.0
    changed: simpy.Event | None = None


@dataclass(slots=True, kw_only=True)
class SimState:
    """The mutable state of one run.

    By task: ``cores`` and ``rates`` (bytes/s by robot) are its current shares, ``speeds`` its current speed,
    0..1; ``flows`` has the last known one of tasks with cycles; ``left`` counts its unfinished jobs.
    ``done``: jobs that are over, where links or events depend on them.
    ``histories``: readings of links by (edge, robot). ``reference``: the first edge, whose capacity scales
    relative demands. ``tasks``: those that have entered, of ``all_tasks``. ``starting``: tasks that a step of
    the plan is about to start. ``happening``: events of which the change holds, by name, as ``overlay`` has
    them; ``happened``: all that ever did. ``working``: jobs in progress; ``robot_work`` and ``robot_done``:
    work by robot, in s, of all its jobs and of those parts of them that are done. ``courses``: with events,
    by task with work, its speed over time from its entry or first job up to ``course_ends``. ``samples``:
    what a probe of each host shows until the next change, but for noise; ``standing``: the plan until then.
    ``memory``: of states that runs of the mission have in common; None where they have none. ``shared``: the
    present state as `describe_shares` has it, ``known``: what is known of it.
    """

    env: simpy.Environment
    inventory: Inventory
    tasks: Tasks
    scenario: Scenario
    policy: Policy
    draw_normal: NormalDraw
    changed: simpy.Event
    read: simpy.Event
    reference: str
    services: dict[str, SimTask] = field(default_factory=dict)
    cores: dict[str, float] = field(default_factory=dict)
    rates: dict[str, dict[str, float]] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    flows: dict[str, Flow] = field(default_factory=dict)
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
    standing: tuple[Step, ...] | None = None
    memory: SimMemory | None = None
    shared: Hashable = None
    known: KnownShares | None = None


def list_external_placements(state: SimState) -> Iterable[tuple[str, str]]:
    """(task, host) of unmanaged tasks: as in the scenario, or on the robot under local execution."""
    for name, host in state.scenario.placed.items():
        if name in state.tasks.tasks:
            robots = state.tasks.tasks[name].robots
            yield name, robots[0] if state.policy.name is PolicyName.LOCAL and robots else host


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


def do_hosts_share(scenario: Scenario) -> bool:
    """Whether tasks of one host slow those of others: they share the air time of one channel."""
    return scenario.radio is Radio.SHARED


def describe_links(state: SimState) -> Hashable:
    """Equal where links carry the same, in a mission without events."""
    return tuple([state.done.issuperset(change.after) for change in state.scenario.links])


def compute_demand_bytes(state: SimState, service: SimTask) -> float:
    """Memory that the task uses, in bytes."""
    changed = state.overlay.demands.get(service.task.name)
    if changed is not None and MEMORY.name in changed:
        return changed[MEMORY.name]
    return (service.task.demand["memory"] or ZERO).of(state.scenario.hosts[state.reference].memory)


def integrate_loads(state: SimState) -> None:
    """Add the loads since the last event to the meters."""
    seconds = state.env.now - state.metered_at
    state.metered_at = state.env.now
    if seconds <= 0:
        return
    used = state.known.used if state.known is not None else measure_hosts(state)
    for host, meter in state.meters.items():
        cpu, memory, network, rated = used[host]
        machine = state.scenario.hosts[host]
        meter.cpu += seconds * cpu / machine.cores
        meter.cpu_peak = max(meter.cpu_peak, cpu / machine.cores)
        meter.memory += seconds * memory / machine.memory
        meter.network += seconds * network
        for speed, rate in rated:
            meter.rate += seconds * speed * rate
            meter.rated_s += seconds


def group_services(state: SimState, without: Container[str] = ()) -> dict[str, dict[str, SimTask]]:
    """The services of each host, in the order of the hosts."""
    found: dict[str, dict[str, SimTask]] = {host: {} for host in state.scenario.hosts}
    for name, service in state.services.items():
        if name not in without:
            found[service.host][name] = service
    return found


def measure_hosts(state: SimState) -> dict[str, HostUse]:
    """What is in use now, by host."""
    return {host: measure_host(state, host, services) for host, services in group_services(state).items()}


def measure_host(state: SimState, host: str, services: Mapping[str, SimTask]) -> HostUse:
    """What is in use now on one host, which has these services."""
    rates = state.scenario.rate
    rated = [
        (state.speeds.get(name, 0.0), rates[name])
        for name, service in services.items()
        if service.ready and name in rates
    ]
    return HostUse(*compute_host_load(state, host, services), tuple(rated))


def forget_probe(state: SimState) -> None:
    """Something changed: a probe shows something else, and a plan may decide something else."""
    state.samples.clear()
    state.standing = None


def compute_host_load(
    state: SimState, host: str, services: Mapping[str, SimTask]
) -> tuple[float, float, float]:
    """Cores, bytes and bytes/s in use now on one host, which has these services."""
    machine = state.scenario.hosts[host]
    if host in state.overlay.lost:
        return 0.0, 0.0, 0.0
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
