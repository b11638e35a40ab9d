"""Who gets how much of something that is shared: a processor or a link."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import simpy

from edgectl.experiments.model.scenario import Scenario, SimHostUsage
from edgectl.model.inventory import Inventory, Role
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.snapshot import (
    CpuUsage,
    HostSample,
    HostStatus,
    LinkSample,
    MemoryUsage,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.model.task import ZERO, Task, Tasks


def compute_fair_shares(capacity: float, wanted: Mapping[str, float]) -> dict[str, float]:
    """Max-min fair shares: nobody gets more than wanted, nobody who wants more gets less than another, nothing is left while one wants.

    This is processor sharing, as a kernel's fair scheduler or flows on one bottleneck come close to it. ``capacity`` and ``wanted`` >= 0,
    in one unit.
    """
    shares = dict.fromkeys(wanted, 0.0)
    left, hungry = capacity, sorted(wanted, key=lambda name: (wanted[name], name))
    while hungry:
        share = left / len(hungry)
        name = hungry[0]
        if wanted[name] >= share:
            return shares | dict.fromkeys(hungry, share)
        shares[name] = wanted[name]
        left -= wanted[name]
        hungry.pop(0)
    return shares


# A draw from the standard normal distribution.
NormalDraw = Callable[[], float]
# The links carry so much in bytes/s where the inventory does not say: 54 Mbit/s, as the gateway assumes.
_DEFAULT_LINK_BYTES_PER_S = 6.75e6
_BASE_LOAD_NAME = ""


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
    """Everything that changes. ``cores`` and ``rates``: what each task gets now, in cores, and in bytes/s by robot; ``speeds`` in 0..1.

    ``reference``: the first edge, of which the shares that tasks demand count.
    """

    env: simpy.Environment
    inventory: Inventory
    tasks: Tasks
    scenario: Scenario
    policy: Policy
    dice: NormalDraw
    changed: simpy.Event
    reference: str
    services: dict[str, SimTask] = field(default_factory=dict)
    cores: dict[str, float] = field(default_factory=dict)
    rates: dict[str, dict[str, float]] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    meters: dict[str, HostMeter] = field(default_factory=dict)
    left: dict[str, int] = field(default_factory=dict)
    manager: ManagerState = field(default_factory=lambda: ManagerState(managed=True))
    metered_at: float = 0.0
    handoffs: int = 0
    unplaced: int = 0


def update_speeds(world: SimState) -> None:
    """Every speed anew. Whoever changes a service meters first what was until then."""
    world.cores, world.rates, world.speeds = {}, {}, {}
    for host in world.scenario.hosts:
        here = {name: service for name, service in world.services.items() if service.host == host}
        _share_host_resources(world, host, here)
    for name, service in world.services.items():
        wanted = _compute_demand_cores(world, service)
        shares = [world.cores[name] / wanted] if wanted > 0 else []
        shares += [
            rate / _compute_demand_bytes_per_s(world, service, robot)
            for robot, rate in world.rates[name].items()
        ]
        world.speeds[name] = min(shares, default=1.0) if service.ready else 0.0
    world.changed.succeed()
    world.changed = world.env.event()


def _share_host_resources(world: SimState, host: str, here: Mapping[str, SimTask]) -> None:
    """Processor and links of one host. A task that starts takes its processor already."""
    machine = world.scenario.hosts[host]
    wanted = {name: _compute_demand_cores(world, service) for name, service in here.items()}
    got = compute_fair_shares(machine.cores, {**wanted, _BASE_LOAD_NAME: machine.base_cores})
    world.cores |= {name: got[name] for name in wanted}
    world.rates |= {name: {} for name in here}
    for robot in dict.fromkeys(
        robot for service in here.values() for robot in _list_remote_robots(world, service)
    ):
        rates = {
            name: _compute_demand_bytes_per_s(world, service, robot)
            for name, service in here.items()
            if service.ready and robot in _list_remote_robots(world, service)
        }
        for name, rate in compute_fair_shares(_get_link_bytes_per_s(world, host, robot), rates).items():
            if rates[name] > 0:
                world.rates[name][robot] = rate


def _list_remote_robots(world: SimState, service: SimTask) -> tuple[str, ...]:
    """The robots that the task reaches over a link; its own computer needs none."""
    return () if world.inventory.hosts[service.host].role is Role.ROBOT else service.task.robots


def _get_link_bytes_per_s(world: SimState, host: str, robot: str) -> float:
    return world.inventory.links.get((host, robot), _DEFAULT_LINK_BYTES_PER_S)


def _compute_demand_cores(world: SimState, service: SimTask) -> float:
    """What the task wants, in cores: a share counts of the first edge, on which it was measured, wherever the task runs."""
    return (service.task.demand.cpu or ZERO).of(world.scenario.hosts[world.reference].cores)


def _compute_demand_bytes(world: SimState, service: SimTask) -> float:
    return (service.task.demand.memory or ZERO).of(world.scenario.hosts[world.reference].memory)


def _compute_demand_bytes_per_s(world: SimState, service: SimTask, robot: str) -> float:
    return (service.task.demand.throughput or ZERO).of(_get_link_bytes_per_s(world, world.reference, robot))


def integrate_loads(world: SimState) -> None:
    """Add what was since the last event."""
    seconds = world.env.now - world.metered_at
    world.metered_at = world.env.now
    if seconds <= 0:
        return
    for host, found in world.meters.items():
        cpu, memory, network = _compute_host_load(world, host)
        machine = world.scenario.hosts[host]
        found.cpu += seconds * cpu / machine.cores
        found.cpu_peak = max(found.cpu_peak, cpu / machine.cores)
        found.memory += seconds * memory / machine.memory
        found.network += seconds * network
        for name, service in world.services.items():
            if service.host == host and service.ready and name in world.scenario.rate:
                found.rate += seconds * world.speeds.get(name, 0.0) * world.scenario.rate[name]
                found.rated_s += seconds


def _compute_host_load(world: SimState, host: str) -> tuple[float, float, float]:
    """Cores, bytes and bytes/s in use now."""
    machine = world.scenario.hosts[host]
    here = {name: service for name, service in world.services.items() if service.host == host}
    used = sum(world.cores.get(name, 0.0) for name in here)
    memory = machine.base_memory + sum(_compute_demand_bytes(world, service) for service in here.values())
    network = sum(rate for name in here for rate in world.rates.get(name, {}).values())
    return used + min(machine.base_cores, machine.cores - used), min(memory, machine.memory), network


def compute_host_usage(world: SimState, host: str) -> SimHostUsage:
    """What one host used since the beginning; whoever asks meters first."""
    found, seconds = world.meters[host], max(world.env.now, 1e-9)
    return SimHostUsage(
        cpu=found.cpu / seconds, cpu_peak=found.cpu_peak, memory=found.memory / seconds, network_bytes_per_s=found.network / seconds,
        rate=found.rate / found.rated_s if found.rated_s else None,
    )  # fmt: skip


def simulate_probe(world: SimState) -> Snapshot:
    """What a probe would say now, its CPU readings off by the noise."""
    return Snapshot(
        taken_at=world.env.now,
        hosts={host: _simulate_host_sample(world, host) for host in world.scenario.hosts},
        manager=world.manager,
    )


def _simulate_host_sample(world: SimState, host: str) -> HostSample:
    machine, role = world.scenario.hosts[host], world.inventory.hosts[host].role
    cpu, memory, _ = _compute_host_load(world, host)
    noise = world.dice() * world.scenario.timing.noise * machine.cores
    here = {name: service for name, service in world.services.items() if service.host == host}
    robots = [robot.name for robot in world.inventory.robots] if role is Role.EDGE else []
    return HostSample(
        role=role,
        status=HostStatus.OK,
        cpu=CpuUsage(cores=machine.cores, used_cores=min(machine.cores, max(0.0, cpu + noise))),
        memory=MemoryUsage(total_bytes=machine.memory, used_bytes=memory),
        links={
            robot: LinkSample(
                capacity_bytes_per_s=_get_link_bytes_per_s(world, host, robot),
                used_bytes_per_s=sum(world.rates.get(name, {}).get(robot, 0.0) for name in here),
            )
            for robot in robots
        },
        tasks={name: _simulate_task_sample(world, service) for name, service in here.items()},
    )


def _simulate_task_sample(world: SimState, service: SimTask) -> TaskSample:
    name = service.task.name
    over = world.left.get(name) == 0
    state = TaskState.COMPLETED if over else TaskState.READY if service.ready else TaskState.STARTING
    rates = world.rates.get(name, {})
    return TaskSample(
        state=state, pid=1, started_at=service.since, used_cores=world.cores.get(name, 0.0), used_bytes=_compute_demand_bytes(world, service),
        used_bytes_per_s=sum(rates.values()), links=dict(rates), instance=name, spec_hash=service.task.spec_hash,
        managed=service.task.managed,
    )  # fmt: skip
