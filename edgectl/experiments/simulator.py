# SPDX-License-Identifier: Apache-2.0
"""Closed-loop simulation of a mission on fairly shared hosts and links, with the real scheduler and diff.

Every event (a job ends, a task starts or stops) recomputes the speed of all tasks.
"""

import math
from collections.abc import Generator, Iterable, Sequence
from dataclasses import replace
from typing import Any

import simpy

from edgectl.experiments.model.mission_event import select_present_tasks
from edgectl.experiments.model.scenario import Scenario, SimJob, SimRun, SimTiming
from edgectl.experiments.simulator_events import show_reading, start_events
from edgectl.experiments.simulator_flows import get_job_speed
from edgectl.experiments.simulator_memory import SimMemory
from edgectl.experiments.simulator_plans import order_steps, plan_cycle
from edgectl.experiments.simulator_speeds import notify_change, update_speeds
from edgectl.experiments.simulator_state import (
    HostMeter,
    NormalDraw,
    SimState,
    SimTask,
    SimWork,
    UniformDraw,
    compute_host_usage,
    forget_probe,
    integrate_loads,
    list_external_placements,
)
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import Placement
from edgectl.model.plan import Action, Step
from edgectl.model.policy import Policy
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.garbage import pause_collection


def draw_no_jitter(_stream: str) -> float:
    """The draw under which events happen at once."""
    return 0.0


def simulate_mission(
    inventory: Inventory,
    tasks: Tasks,
    scenario: Scenario,
    policy: Policy,
    draw_normal: NormalDraw,
    draw_uniform: UniformDraw = draw_no_jitter,
    *,
    oracle: bool = False,
    memory: SimMemory | None = None,
) -> SimRun:
    """One run of the mission under ``policy``; the same draws give the same run.

    ``oracle``: choose hosts by true speeds and links (`simulator_oracle.assign_by_oracle`). ``memory``: of
    other runs of the same mission under the same policy; it makes this one faster and changes nothing.

    ``draw_uniform`` has a stream for each event, so that events come alike whatever else is drawn.

    Raises:
        ValueError: ``memory`` is of another mission or policy.
    """
    memory = memory or SimMemory(inventory=inventory, tasks=tasks, scenario=scenario, policy=policy)
    if not memory.is_of(inventory, tasks, scenario, policy):
        raise ValueError("the memory is of another mission or policy")
    env = simpy.Environment()
    state = SimState(
        env=env,
        inventory=inventory,
        tasks=select_present_tasks(tasks, scenario.events, ()),
        scenario=scenario,
        policy=replace(policy, attended=False, best_effort=policy.best_effort or oracle),
        oracle=oracle,
        all_tasks=tasks,
        draw_normal=draw_normal,
        draw_uniform=draw_uniform,
        changed=env.event(),
        read=env.event(),
        reference=inventory.edges[0].name,
        meters={host: HostMeter() for host in scenario.hosts},
        memory=None if scenario.events or scenario.cycles else memory,
    )
    with pause_collection():
        return _run_mission(state)


def _run_mission(state: SimState) -> SimRun:
    env, scenario = state.env, state.scenario
    for job in scenario.jobs:
        state.left[job.task] = state.left.get(job.task, 0) + 1
    for name, host in list_external_placements(state):
        state.services[name] = SimTask(task=state.tasks.tasks[name], host=host, since=0.0, ready=True)
    update_speeds(state)
    done: dict[str, simpy.Process] = {}
    ends: dict[str, float] = {}
    for job in _sort_jobs(scenario.jobs):
        work = job.work * math.exp(state.draw_normal() * job.spread) if job.spread else job.work
        done[job.name] = env.process(_run_job(state, job, work, [done[name] for name in job.after], ends))
    start_events(state)
    env.process(_run_manager(state))
    env.run(
        until=simpy.AnyOf(env, [simpy.AllOf(env, list(done.values())), env.timeout(scenario.timing.limit)])
    )
    integrate_loads(state)
    finished = len(ends) == len(scenario.jobs)
    return SimRun(
        latency=max(ends.values()) if finished else scenario.timing.limit,
        finished=finished,
        handoffs=state.handoffs,
        unplaced=state.unplaced,
        usage={host: compute_host_usage(state, host) for host in scenario.hosts},
        jobs=ends,
        events=tuple(state.records),
        courses={name: tuple(points) for name, points in state.courses.items()},
        course_ends=state.course_ends,
    )


def _sort_jobs(jobs: Iterable[SimJob]) -> list[SimJob]:
    """Jobs in topological order; the file reader has refused cycles."""
    left, ordered = list(jobs), list[SimJob]()
    placed = set[str]()
    while left:
        ready = [job for job in left if placed.issuperset(job.after)]
        ordered += ready
        placed |= {job.name for job in ready}
        left = [job for job in left if job.name not in placed]
    return ordered


def _run_job(
    state: SimState, job: SimJob, work: float, before: list[simpy.Process], ends: dict[str, float]
) -> Generator[Any, Any, None]:
    """Work off a job at the current speed of its task."""
    robots = state.all_tasks.tasks[job.task].robots
    robot = robots[0] if len(robots) == 1 else None
    if robot is not None:
        state.robot_work[robot] = state.robot_work.get(robot, 0.0) + work
    yield simpy.AllOf(state.env, before)
    part = state.working[job.name] = SimWork(job=job, robot=robot, since=state.env.now)
    if state.scenario.events:
        notify_change(state)
    while work > 1e-9:
        part.speed, part.since, part.left = get_job_speed(state, job), state.env.now, work
        changed = part.changed = state.env.event()
        yield (
            simpy.AnyOf(state.env, [changed, state.env.timeout(work / part.speed)])
            if part.speed > 0
            else changed
        )
        done = part.speed * (state.env.now - part.since)
        work -= done
        part.since = state.env.now
        if robot is not None:
            state.robot_done[robot] = state.robot_done.get(robot, 0.0) + done
    del state.working[job.name]
    ends[job.name] = state.env.now
    state.ends.add(job.name)
    state.left[job.task] -= 1
    forget_probe(state)
    if state.scenario.links or state.scenario.events:
        integrate_loads(state)
        state.done.add(job.name)
        update_speeds(state)


def _run_manager(state: SimState) -> Generator[Any, Any, None]:
    """The manager's endless loop: probe, plan, apply, wait."""
    timing = state.scenario.timing
    while True:
        began = state.env.now
        if timing.probe:
            yield state.env.timeout(timing.probe)
        plan = plan_cycle(state)
        show_reading(state)
        state.unplaced += sum(step.action is Action.UNPLACED for step in plan)
        steps = [step for step in plan if step.action.changes]
        if steps and timing.plan:
            yield state.env.timeout(timing.plan)
        state.starting = {step.task for step in steps if step.decision.host is not None}
        yield simpy.AllOf(state.env, begin_steps(state, steps))
        if steps and timing.apply:
            yield state.env.timeout(timing.apply)
        yield state.env.timeout(_compute_pause_s(timing, state.env.now - began))


def _compute_pause_s(timing: SimTiming, taken: float) -> float:
    return timing.every - math.fmod(taken, timing.every) if timing.paced else timing.every


def begin_steps(state: SimState, steps: Sequence[Step]) -> list[simpy.Process]:
    """Begin all steps: those that start something after its needs, and after the moves that leave its host,
    in the order of the executor.
    """
    begun = dict[str, simpy.Process]()
    for step, needs in order_steps(state.tasks, steps):
        begun[step.task] = state.env.process(_run_step(state, step, [begun[other] for other in needs]))
    return list(begun.values())


def _run_step(state: SimState, step: Step, before: Sequence[simpy.Event]) -> Generator[Any, Any, None]:
    """Apply one step of the plan after those ``before``: stop the task, then start it once its needs are
    ready.

    A host that is lost meanwhile ends the step: nothing was stopped, or nothing runs.
    """
    timing = state.scenario.timing
    if before:
        yield simpy.AllOf(state.env, before)
    old = state.services.get(step.task)
    if old is not None and timing.prepare:
        yield state.env.timeout(timing.prepare)
    began = state.env.now
    if old is not None:
        integrate_loads(state)
        old.ready = False
        update_speeds(state)
        yield state.env.timeout(timing.stop)
        integrate_loads(state)
        state.services.pop(step.task, None)
        update_speeds(state)
    host = step.decision.host
    if step.action in (Action.STOP, Action.COMPLETE) or host is None:
        state.starting.discard(step.task)
        _remove_placement(state, step.task, completed=step.action is Action.COMPLETE)
        return
    yield from _start_task(state, step.task, host)
    state.starting.discard(step.task)
    service = state.services.get(step.task)
    if service is not None and old is not None:
        state.handoffs += old.host != host
        _record_downtime(state, step.task, host, state.env.now - began)
    update_speeds(state)


def _start_task(state: SimState, name: str, host: str) -> Generator[Any, Any, None]:
    """Start a task once its needs are ready, unless one of them cannot become so or the host is off."""
    task = state.tasks.tasks[name]
    while not all(_is_need_ready(state, need.task) for need in task.needs):
        if not all(_can_become_ready(state, need.task) for need in task.needs):
            return
        yield state.changed
    if host in state.overlay.lost:
        return
    integrate_loads(state)
    service = state.services[name] = SimTask(task=task, host=host, since=state.env.now)
    _record_placement(state, task, host)
    update_speeds(state)
    yield state.env.timeout(state.scenario.timing.start)
    integrate_loads(state)
    service.ready = True


def _can_become_ready(state: SimState, need: str) -> bool:
    return need in state.services or need in state.starting or need in state.manager.done


def _is_need_ready(state: SimState, need: str) -> bool:
    service = state.services.get(need)
    return need in state.manager.done or (service is not None and service.ready)


def _record_placement(state: SimState, task: Task, host: str) -> None:
    placements = {
        **state.manager.placements,
        task.name: Placement(host=host, since=state.env.now, spec_hash=task.spec_hash),
    }
    state.manager = replace(
        state.manager, placements=placements, first={task.name: host, **state.manager.first}
    )


def _remove_placement(state: SimState, name: str, *, completed: bool) -> None:
    placements = {task: there for task, there in state.manager.placements.items() if task != name}
    done = (
        {**state.manager.done, name: state.tasks.tasks[name].spec_hash} if completed else state.manager.done
    )
    state.manager = replace(state.manager, placements=placements, done=done)


def _record_downtime(state: SimState, task: str, host: str, seconds: float) -> None:
    known = state.manager.downtimes.get((task, host), ())
    state.manager = replace(
        state.manager, downtimes={**state.manager.downtimes, (task, host): (*known, seconds)[-20:]}
    )
