"""A closed-loop model of a fleet: computers and links that are shared fairly, a mission of jobs, and the real scheduler and diff in charge.

An event (a job ends, a task is started or gone) makes all speeds anew.
"""

import math
from collections.abc import Generator, Iterable
from dataclasses import replace
from typing import Any

import simpy

from edgectl.evidence.simulate_world import Dice, Meter, Service, World, meter, share_out, snapshot_of, usage_of
from edgectl.executor.diff import plan_of
from edgectl.model.inventory import Inventory
from edgectl.model.memory import Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.scenario import Job, Scenario, SimRun
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.assign import assign


def simulate(inventory: Inventory, tasks: Tasks, scenario: Scenario, policy: Policy, dice: Dice) -> SimRun:
    """One run of the mission under ``policy``; the same draws give the same run."""
    env = simpy.Environment()
    world = World(
        env=env, inventory=inventory, tasks=tasks, scenario=scenario, policy=replace(policy, attended=False), dice=dice,
        changed=env.event(), reference=inventory.edges[0].name, meters={host: Meter() for host in scenario.hosts},
    )  # fmt: skip
    for job in scenario.jobs:
        world.left[job.task] = world.left.get(job.task, 0) + 1
    for name, host in _beforehand(world):
        world.services[name] = Service(task=tasks.tasks[name], host=host, since=0.0, ready=True)
    share_out(world)
    done: dict[str, simpy.Process] = {}
    ends: dict[str, float] = {}
    for job in _in_order(scenario.jobs):
        work = job.work * math.exp(dice() * job.spread) if job.spread else job.work
        done[job.name] = env.process(_work(world, job, work, [done[name] for name in job.after], ends))
    env.process(_control(world))
    env.run(until=simpy.AnyOf(env, [simpy.AllOf(env, list(done.values())), env.timeout(scenario.timing.limit)]))
    meter(world)
    finished = len(ends) == len(scenario.jobs)
    return SimRun(
        latency=max(ends.values()) if finished else scenario.timing.limit, finished=finished, handoffs=world.handoffs,
        unplaced=world.unplaced, usage={host: usage_of(world, host) for host in scenario.hosts}, jobs=ends,
    )  # fmt: skip


def _beforehand(world: World) -> Iterable[tuple[str, str]]:
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


def _work(world: World, job: Job, work: float, before: list[simpy.Process], ends: dict[str, float]) -> Generator[Any, Any, None]:
    """One job: as fast as its task runs, whatever that is at each moment."""
    yield simpy.AllOf(world.env, before)
    while work > 1e-9:
        speed, began = world.speeds.get(job.task, 0.0), world.env.now
        changed = world.changed
        yield simpy.AnyOf(world.env, [changed, world.env.timeout(work / speed)]) if speed > 0 else changed
        work -= speed * (world.env.now - began)
    ends[job.name] = world.env.now
    world.left[job.task] -= 1


def _control(world: World) -> Generator[Any, Any, None]:
    """The manager: probe, decide, carry out, wait; for ever."""
    while True:
        plan = _plan(world)
        world.unplaced += plan.summary.get(Action.UNPLACED, 0)
        acts = [world.env.process(_act(world, step)) for step in plan.steps if step.action.changes]
        yield simpy.AllOf(world.env, acts)
        yield world.env.timeout(world.scenario.timing.every)


def _plan(world: World) -> Plan:
    snapshot = snapshot_of(world)
    assignment = assign(world.inventory, world.tasks, snapshot, world.memory, world.policy, world.env.now)
    return plan_of(world.inventory, world.tasks, snapshot, world.memory, assignment)


def _act(world: World, step: Step) -> Generator[Any, Any, None]:
    """One action of the plan: stop first, start when everything it needs is there."""
    timing, began = world.scenario.timing, world.env.now
    old = world.services.get(step.task)
    if old is not None:
        meter(world)
        old.ready = False
        share_out(world)
        yield world.env.timeout(timing.stop)
        meter(world)
        del world.services[step.task]
        share_out(world)
    if step.action in (Action.STOP, Action.COMPLETE) or step.decision.host is None:
        _forget(world, step.task, completed=step.action is Action.COMPLETE)
        return
    task = world.tasks.tasks[step.task]
    while not all(_there(world, need.task) for need in task.needs):
        yield world.changed
    meter(world)
    world.services[step.task] = Service(task=task, host=step.decision.host, since=world.env.now)
    _remember(world, task, step.decision.host)
    share_out(world)
    yield world.env.timeout(timing.start)
    meter(world)
    world.services[step.task].ready = True
    if old is not None:
        world.handoffs += old.host != step.decision.host
        _downtime(world, step.task, step.decision.host, world.env.now - began)
    share_out(world)


def _there(world: World, need: str) -> bool:
    service = world.services.get(need)
    return need in world.memory.done or (service is not None and service.ready)


def _remember(world: World, task: Task, host: str) -> None:
    placements = {**world.memory.placements, task.name: Placement(host=host, since=world.env.now, spec_hash=task.spec_hash)}
    world.memory = replace(world.memory, placements=placements, first={task.name: host, **world.memory.first})


def _forget(world: World, name: str, *, completed: bool) -> None:
    placements = {task: there for task, there in world.memory.placements.items() if task != name}
    done = {**world.memory.done, name: world.tasks.tasks[name].spec_hash} if completed else world.memory.done
    world.memory = replace(world.memory, placements=placements, done=done)


def _downtime(world: World, task: str, host: str, seconds: float) -> None:
    known = world.memory.downtimes.get((task, host), ())
    world.memory = replace(world.memory, downtimes={**world.memory.downtimes, (task, host): (*known, seconds)[-20:]})
