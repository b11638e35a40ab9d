"""A closed-loop model of a fleet: computers and links that are shared fairly, a mission of jobs, and the real scheduler and diff in charge.

An event (a job ends, a task is started or gone) makes all speeds anew.
"""

import math
from collections.abc import Generator, Iterable
from dataclasses import replace
from typing import Any

import simpy

from edgectl.executor.diff import plan_from_assignment
from edgectl.experiments.model.scenario import Scenario, SimJob, SimRun
from edgectl.experiments.simulator_state import (
    HostMeter,
    NormalDraw,
    SimState,
    SimTask,
    compute_host_usage,
    integrate_loads,
    simulate_probe,
    update_speeds,
)
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.assign import assign


def simulate_mission(
    inventory: Inventory, tasks: Tasks, scenario: Scenario, policy: Policy, dice: NormalDraw
) -> SimRun:
    """One run of the mission under ``policy``; the same draws give the same run."""
    env = simpy.Environment()
    world = SimState(
        env=env, inventory=inventory, tasks=tasks, scenario=scenario, policy=replace(policy, attended=False), dice=dice,
        changed=env.event(), reference=inventory.edges[0].name, meters={host: HostMeter() for host in scenario.hosts},
    )  # fmt: skip
    for job in scenario.jobs:
        world.left[job.task] = world.left.get(job.task, 0) + 1
    for name, host in _list_external_placements(world):
        world.services[name] = SimTask(task=tasks.tasks[name], host=host, since=0.0, ready=True)
    update_speeds(world)
    done: dict[str, simpy.Process] = {}
    ends: dict[str, float] = {}
    for job in _sort_jobs(scenario.jobs):
        work = job.work * math.exp(dice() * job.spread) if job.spread else job.work
        done[job.name] = env.process(_run_job(world, job, work, [done[name] for name in job.after], ends))
    env.process(_run_manager(world))
    env.run(
        until=simpy.AnyOf(env, [simpy.AllOf(env, list(done.values())), env.timeout(scenario.timing.limit)])
    )
    integrate_loads(world)
    finished = len(ends) == len(scenario.jobs)
    return SimRun(
        latency=max(ends.values()) if finished else scenario.timing.limit, finished=finished, handoffs=world.handoffs,
        unplaced=world.unplaced, usage={host: compute_host_usage(world, host) for host in scenario.hosts}, jobs=ends,
    )  # fmt: skip


def _list_external_placements(world: SimState) -> Iterable[tuple[str, str]]:
    """Tasks that somebody else started: where the scenario says, and on their robot where everything runs locally."""
    for name, host in world.scenario.placed.items():
        robots = world.tasks.tasks[name].robots
        yield name, robots[0] if world.policy.name is PolicyName.LOCAL and robots else host


def _sort_jobs(jobs: Iterable[SimJob]) -> list[SimJob]:
    """Jobs after all that they wait for; the reader of the file has refused cycles."""
    left, ordered = list(jobs), list[SimJob]()
    placed = set[str]()
    while left:
        ready = [job for job in left if placed.issuperset(job.after)]
        ordered += ready
        placed |= {job.name for job in ready}
        left = [job for job in left if job.name not in placed]
    return ordered


def _run_job(
    world: SimState, job: SimJob, work: float, before: list[simpy.Process], ends: dict[str, float]
) -> Generator[Any, Any, None]:
    """One job: as fast as its task runs, whatever that is at each moment."""
    yield simpy.AllOf(world.env, before)
    while work > 1e-9:
        speed, began = world.speeds.get(job.task, 0.0), world.env.now
        changed = world.changed
        yield simpy.AnyOf(world.env, [changed, world.env.timeout(work / speed)]) if speed > 0 else changed
        work -= speed * (world.env.now - began)
    ends[job.name] = world.env.now
    world.left[job.task] -= 1


def _run_manager(world: SimState) -> Generator[Any, Any, None]:
    """The manager: probe, decide, carry out, wait; for ever."""
    while True:
        plan = _plan_cycle(world)
        world.unplaced += plan.summary.get(Action.UNPLACED, 0)
        acts = [world.env.process(_run_step(world, step)) for step in plan.steps if step.action.changes]
        yield simpy.AllOf(world.env, acts)
        yield world.env.timeout(world.scenario.timing.every)


def _plan_cycle(world: SimState) -> Plan:
    snapshot = simulate_probe(world)
    assignment = assign(world.inventory, world.tasks, snapshot, world.manager, world.policy, world.env.now)
    return plan_from_assignment(world.inventory, world.tasks, snapshot, world.manager, assignment)


def _run_step(world: SimState, step: Step) -> Generator[Any, Any, None]:
    """One action of the plan: stop first, start when everything it needs is there."""
    timing, began = world.scenario.timing, world.env.now
    old = world.services.get(step.task)
    if old is not None:
        integrate_loads(world)
        old.ready = False
        update_speeds(world)
        yield world.env.timeout(timing.stop)
        integrate_loads(world)
        del world.services[step.task]
        update_speeds(world)
    if step.action in (Action.STOP, Action.COMPLETE) or step.decision.host is None:
        _remove_placement(world, step.task, completed=step.action is Action.COMPLETE)
        return
    task = world.tasks.tasks[step.task]
    while not all(_is_need_ready(world, need.task) for need in task.needs):
        yield world.changed
    integrate_loads(world)
    world.services[step.task] = SimTask(task=task, host=step.decision.host, since=world.env.now)
    _record_placement(world, task, step.decision.host)
    update_speeds(world)
    yield world.env.timeout(timing.start)
    integrate_loads(world)
    world.services[step.task].ready = True
    if old is not None:
        world.handoffs += old.host != step.decision.host
        _record_downtime(world, step.task, step.decision.host, world.env.now - began)
    update_speeds(world)


def _is_need_ready(world: SimState, need: str) -> bool:
    service = world.services.get(need)
    return need in world.manager.done or (service is not None and service.ready)


def _record_placement(world: SimState, task: Task, host: str) -> None:
    placements = {
        **world.manager.placements,
        task.name: Placement(host=host, since=world.env.now, spec_hash=task.spec_hash),
    }
    world.manager = replace(
        world.manager, placements=placements, first={task.name: host, **world.manager.first}
    )


def _remove_placement(world: SimState, name: str, *, completed: bool) -> None:
    placements = {task: there for task, there in world.manager.placements.items() if task != name}
    done = (
        {**world.manager.done, name: world.tasks.tasks[name].spec_hash} if completed else world.manager.done
    )
    world.manager = replace(world.manager, placements=placements, done=done)


def _record_downtime(world: SimState, task: str, host: str, seconds: float) -> None:
    known = world.manager.downtimes.get((task, host), ())
    world.manager = replace(
        world.manager, downtimes={**world.manager.downtimes, (task, host): (*known, seconds)[-20:]}
    )
