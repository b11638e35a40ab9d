"""A closed-loop model of a fleet: computers and links that are shared fairly, a mission of jobs, and the real scheduler and diff in charge.

Fluid: between two events every task runs at a constant speed, the least of the shares that its processor and its links give it of what it
demands. An event (a job ends, a task is started or gone) makes all speeds anew. Loads are integrated exactly over time.
"""

import math
from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import simpy

from edgectl.evidence.share import fair
from edgectl.executor.diff import plan_of
from edgectl.model.inventory import Inventory, Role
from edgectl.model.memory import Memory, Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.scenario import Job, Scenario, SimRun, Usage
from edgectl.model.snapshot import Cpu, HostSample, HostStatus, LinkSample, MemoryUse, Snapshot, TaskSample, TaskState
from edgectl.model.task import ZERO, Task, Tasks
from edgectl.scheduler.assign import assign

# A draw from the standard normal distribution.
Dice = Callable[[], float]
# The links carry so much in bytes/s where the inventory does not say: 54 Mbit/s, as the gateway assumes.
_ASSUMED_BYTES_PER_S = 6.75e6
_BASE = ""


@dataclass(slots=True, kw_only=True)
class _Service:
    """One task on one host."""

    task: Task
    host: str
    since: float
    ready: bool = False


@dataclass(slots=True, kw_only=True)
class _Meter:
    """Integrals over the time of one run, for one host."""

    cpu: float = 0.0
    cpu_peak: float = 0.0
    memory: float = 0.0
    network: float = 0.0
    rate: float = 0.0
    rated_s: float = 0.0


@dataclass(slots=True, kw_only=True)
class _World:
    """Everything that changes. ``cores`` and ``rates``: what each task gets now, in cores, and in bytes/s by robot; ``speeds`` in 0..1.

    ``reference``: the first edge, of which the shares that tasks demand count.
    """

    env: simpy.Environment
    inventory: Inventory
    tasks: Tasks
    scenario: Scenario
    policy: Policy
    dice: Dice
    changed: simpy.Event
    reference: str
    services: dict[str, _Service] = field(default_factory=dict)
    cores: dict[str, float] = field(default_factory=dict)
    rates: dict[str, dict[str, float]] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    meters: dict[str, _Meter] = field(default_factory=dict)
    left: dict[str, int] = field(default_factory=dict)
    memory: Memory = field(default_factory=lambda: Memory(managed=True))
    metered_at: float = 0.0
    handoffs: int = 0
    unplaced: int = 0


def simulate(inventory: Inventory, tasks: Tasks, scenario: Scenario, policy: Policy, dice: Dice) -> SimRun:
    """One run of the mission under ``policy``; the same draws give the same run."""
    env = simpy.Environment()
    world = _World(
        env=env, inventory=inventory, tasks=tasks, scenario=scenario, policy=replace(policy, attended=False), dice=dice,
        changed=env.event(), reference=inventory.edges[0].name, meters={host: _Meter() for host in scenario.hosts},
    )  # fmt: skip
    for job in scenario.jobs:
        world.left[job.task] = world.left.get(job.task, 0) + 1
    for name, host in _beforehand(world):
        world.services[name] = _Service(task=tasks.tasks[name], host=host, since=0.0, ready=True)
    _share_out(world)
    done: dict[str, simpy.Process] = {}
    ends: dict[str, float] = {}
    for job in _in_order(scenario.jobs):
        work = job.work * math.exp(dice() * job.spread) if job.spread else job.work
        done[job.name] = env.process(_work(world, job, work, [done[name] for name in job.after], ends))
    env.process(_control(world))
    env.run(until=simpy.AnyOf(env, [simpy.AllOf(env, list(done.values())), env.timeout(scenario.timing.limit)]))
    _meter(world)
    finished = len(ends) == len(scenario.jobs)
    return SimRun(
        latency=max(ends.values()) if finished else scenario.timing.limit, finished=finished, handoffs=world.handoffs,
        unplaced=world.unplaced, usage={host: _usage(world, host) for host in scenario.hosts}, jobs=ends,
    )  # fmt: skip


def _beforehand(world: _World) -> Iterable[tuple[str, str]]:
    """Tasks that somebody else started: where the scenario says, and on their robot where everything runs locally."""
    for name, host in world.scenario.placed.items():
        robots = world.tasks.tasks[name].robots
        yield name, robots[0] if world.policy.name is PolicyName.LOCAL and robots else host


def _in_order(jobs: Iterable[Job]) -> list[Job]:
    """Jobs after all that they wait for; the reader of the file has refused cycles."""
    left, ordered = list(jobs), list[Job]()
    placed = set[str]()
    while left:
        ready = [job for job in left if placed.issuperset(job.after)]
        ordered += ready
        placed |= {job.name for job in ready}
        left = [job for job in left if job.name not in placed]
    return ordered


def _work(world: _World, job: Job, work: float, before: list[simpy.Process], ends: dict[str, float]) -> Generator[Any, Any, None]:
    """One job: as fast as its task runs, whatever that is at each moment."""
    yield simpy.AllOf(world.env, before)
    while work > 1e-9:
        speed, began = world.speeds.get(job.task, 0.0), world.env.now
        changed = world.changed
        yield simpy.AnyOf(world.env, [changed, world.env.timeout(work / speed)]) if speed > 0 else changed
        work -= speed * (world.env.now - began)
    ends[job.name] = world.env.now
    world.left[job.task] -= 1


def _control(world: _World) -> Generator[Any, Any, None]:
    """The manager: probe, decide, carry out, wait; for ever."""
    while True:
        plan = _plan(world)
        world.unplaced += plan.summary.get(Action.UNPLACED, 0)
        acts = [world.env.process(_act(world, step)) for step in plan.steps if step.action.changes]
        yield simpy.AllOf(world.env, acts)
        yield world.env.timeout(world.scenario.timing.every)


def _plan(world: _World) -> Plan:
    snapshot = _snapshot(world)
    assignment = assign(world.inventory, world.tasks, snapshot, world.memory, world.policy, world.env.now)
    return plan_of(world.inventory, world.tasks, snapshot, world.memory, assignment)


def _act(world: _World, step: Step) -> Generator[Any, Any, None]:
    """One action of the plan: stop first, start when everything it needs is there."""
    timing, began = world.scenario.timing, world.env.now
    old = world.services.get(step.task)
    if old is not None:
        _meter(world)
        old.ready = False
        _share_out(world)
        yield world.env.timeout(timing.stop)
        _meter(world)
        del world.services[step.task]
        _share_out(world)
    if step.action in (Action.STOP, Action.COMPLETE) or step.decision.host is None:
        _forget(world, step.task, completed=step.action is Action.COMPLETE)
        return
    task = world.tasks.tasks[step.task]
    while not all(_there(world, need.task) for need in task.needs):
        yield world.changed
    _meter(world)
    world.services[step.task] = _Service(task=task, host=step.decision.host, since=world.env.now)
    _remember(world, task, step.decision.host)
    _share_out(world)
    yield world.env.timeout(timing.start)
    _meter(world)
    world.services[step.task].ready = True
    if old is not None:
        world.handoffs += old.host != step.decision.host
        _downtime(world, step.task, step.decision.host, world.env.now - began)
    _share_out(world)


def _there(world: _World, need: str) -> bool:
    service = world.services.get(need)
    return need in world.memory.done or (service is not None and service.ready)


def _remember(world: _World, task: Task, host: str) -> None:
    placements = {**world.memory.placements, task.name: Placement(host=host, since=world.env.now, spec_hash=task.spec_hash)}
    world.memory = replace(world.memory, placements=placements, first={task.name: host, **world.memory.first})


def _forget(world: _World, name: str, *, completed: bool) -> None:
    placements = {task: there for task, there in world.memory.placements.items() if task != name}
    done = {**world.memory.done, name: world.tasks.tasks[name].spec_hash} if completed else world.memory.done
    world.memory = replace(world.memory, placements=placements, done=done)


def _downtime(world: _World, task: str, host: str, seconds: float) -> None:
    known = world.memory.downtimes.get((task, host), ())
    world.memory = replace(world.memory, downtimes={**world.memory.downtimes, (task, host): (*known, seconds)[-20:]})


def _share_out(world: _World) -> None:
    """Every speed anew. Whoever changes a service meters first what was until then."""
    world.cores, world.rates, world.speeds = {}, {}, {}
    for host in world.scenario.hosts:
        here = {name: service for name, service in world.services.items() if service.host == host}
        _share_host(world, host, here)
    for name, service in world.services.items():
        wanted = _cores(world, service)
        shares = [world.cores[name] / wanted] if wanted > 0 else []
        shares += [rate / _rate(world, service, robot) for robot, rate in world.rates[name].items()]
        world.speeds[name] = min(shares, default=1.0) if service.ready else 0.0
    world.changed.succeed()
    world.changed = world.env.event()


def _share_host(world: _World, host: str, here: Mapping[str, _Service]) -> None:
    """Processor and links of one host. A task that starts takes its processor already."""
    machine = world.scenario.hosts[host]
    wanted = {name: _cores(world, service) for name, service in here.items()}
    got = fair(machine.cores, {**wanted, _BASE: machine.base_cores})
    world.cores |= {name: got[name] for name in wanted}
    world.rates |= {name: {} for name in here}
    for robot in {robot for service in here.values() for robot in _links(world, service)}:
        rates = {name: _rate(world, service, robot) for name, service in here.items() if service.ready and robot in _links(world, service)}
        for name, rate in fair(_capacity(world, host, robot), rates).items():
            if rates[name] > 0:
                world.rates[name][robot] = rate


def _links(world: _World, service: _Service) -> tuple[str, ...]:
    """The robots that the task reaches over a link; its own computer needs none."""
    return () if world.inventory.hosts[service.host].role is Role.ROBOT else service.task.robots


def _capacity(world: _World, host: str, robot: str) -> float:
    return world.inventory.links.get((host, robot), _ASSUMED_BYTES_PER_S)


def _cores(world: _World, service: _Service) -> float:
    """What the task wants, in cores: a share counts of the first edge, on which it was measured, wherever the task runs."""
    return (service.task.demand.cpu or ZERO).of(world.scenario.hosts[world.reference].cores)


def _bytes(world: _World, service: _Service) -> float:
    return (service.task.demand.memory or ZERO).of(world.scenario.hosts[world.reference].memory)


def _rate(world: _World, service: _Service, robot: str) -> float:
    return (service.task.demand.throughput or ZERO).of(_capacity(world, world.reference, robot))


def _meter(world: _World) -> None:
    """Add what was since the last event."""
    seconds = world.env.now - world.metered_at
    world.metered_at = world.env.now
    if seconds <= 0:
        return
    for host, meter in world.meters.items():
        cpu, memory, network = _load(world, host)
        machine = world.scenario.hosts[host]
        meter.cpu += seconds * cpu / machine.cores
        meter.cpu_peak = max(meter.cpu_peak, cpu / machine.cores)
        meter.memory += seconds * memory / machine.memory
        meter.network += seconds * network
        for name, service in world.services.items():
            if service.host == host and service.ready and name in world.scenario.rate:
                meter.rate += seconds * world.speeds.get(name, 0.0) * world.scenario.rate[name]
                meter.rated_s += seconds


def _load(world: _World, host: str) -> tuple[float, float, float]:
    """Cores, bytes and bytes/s in use now."""
    machine = world.scenario.hosts[host]
    here = {name: service for name, service in world.services.items() if service.host == host}
    used = sum(world.cores.get(name, 0.0) for name in here)
    memory = machine.base_memory + sum(_bytes(world, service) for service in here.values())
    network = sum(rate for name in here for rate in world.rates.get(name, {}).values())
    return used + min(machine.base_cores, machine.cores - used), min(memory, machine.memory), network


def _usage(world: _World, host: str) -> Usage:
    meter, seconds = world.meters[host], max(world.env.now, 1e-9)
    return Usage(
        cpu=meter.cpu / seconds, cpu_peak=meter.cpu_peak, memory=meter.memory / seconds, network_bytes_per_s=meter.network / seconds,
        rate=meter.rate / meter.rated_s if meter.rated_s else None,
    )  # fmt: skip


def _snapshot(world: _World) -> Snapshot:
    """What a probe would say now, its CPU readings off by the noise."""
    return Snapshot(taken_at=world.env.now, hosts={host: _sample(world, host) for host in world.scenario.hosts}, memory=world.memory)


def _sample(world: _World, host: str) -> HostSample:
    machine, role = world.scenario.hosts[host], world.inventory.hosts[host].role
    cpu, memory, _ = _load(world, host)
    noise = world.dice() * world.scenario.timing.noise * machine.cores
    here = {name: service for name, service in world.services.items() if service.host == host}
    robots = [robot.name for robot in world.inventory.robots] if role is Role.EDGE else []
    return HostSample(
        role=role,
        status=HostStatus.OK,
        cpu=Cpu(cores=machine.cores, used_cores=min(machine.cores, max(0.0, cpu + noise))),
        memory=MemoryUse(total_bytes=machine.memory, used_bytes=memory),
        links={
            robot: LinkSample(
                capacity_bytes_per_s=_capacity(world, host, robot),
                used_bytes_per_s=sum(world.rates.get(name, {}).get(robot, 0.0) for name in here),
            )
            for robot in robots
        },
        tasks={name: _found(world, service) for name, service in here.items()},
    )


def _found(world: _World, service: _Service) -> TaskSample:
    name = service.task.name
    over = world.left.get(name) == 0
    state = TaskState.COMPLETED if over else TaskState.READY if service.ready else TaskState.STARTING
    rates = world.rates.get(name, {})
    return TaskSample(
        state=state, pid=1, started_at=service.since, used_cores=world.cores.get(name, 0.0), used_bytes=_bytes(world, service),
        used_bytes_per_s=sum(rates.values()), links=dict(rates), instance=name, spec_hash=service.task.spec_hash,
        managed=service.task.managed,
    )  # fmt: skip
