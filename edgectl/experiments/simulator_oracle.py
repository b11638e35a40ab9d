# SPDX-License-Identifier: Apache-2.0
"""The oracle of simulations: a joint plan from the true speeds and links of this moment (ADR 130).

It knows what every host and link gives now, without noise or delay, and the work that is left of each job. It
does not know the future: drawn work of jobs that have not begun, and changes to come.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import simpy

from edgectl.experiments.model.scenario import SimJob
from edgectl.experiments.simulator_speeds import update_speeds
from edgectl.experiments.simulator_state import SimState, SimTask
from edgectl.model.assignment import Assignment, Decision, Reason, Verdict
from edgectl.model.task import Task
from edgectl.scheduler.feasibility import find_rule_against

# A plan must be so much sooner (s) to be another one.
_LEAST_GAIN_S = 1e-6
_MAX_ROUNDS = 20
# Speed that a task counts with which cannot run: its mission ends late, but finite plans stay comparable.
_STANDSTILL = 1e-6
# When the last job ends, and the sum of the ends of all, both in s from now.
PlanCost = tuple[float, float]


def assign_by_oracle(state: SimState, assignment: Assignment) -> Assignment:
    """``assignment`` with other hosts: those of the joint plan under which the mission ends soonest.

    Starts from the hosts where tasks run, and of ``assignment`` for others; changes single hosts and swaps
    pairs while that helps. A move costs the stop and the start of its task.
    """
    decided = {each.task: each for each in assignment.decisions if _may_choose(state, each)}
    hosts = {name: each.previous_host or each.host or "" for name, each in decided.items()}
    choices = {name: _list_allowed_hosts(state, state.tasks.tasks[name]) for name in decided}
    best = _rate_plan(state, hosts)
    for _ in range(_MAX_ROUNDS):
        found = min(
            ((_rate_plan(state, {**hosts, **change}), change) for change in _list_changes(hosts, choices)),
            key=lambda rated: rated[0],
            default=None,
        )
        if found is None or found[0] >= best or sum(best) - sum(found[0]) < _LEAST_GAIN_S:
            break
        best, hosts = found[0], {**hosts, **found[1]}
    return replace(
        assignment,
        decisions=tuple(
            _redirect(each, hosts[each.task]) if each.task in hosts else each for each in assignment.decisions
        ),
    )


def _may_choose(state: SimState, decision: Decision) -> bool:
    """Whether the task runs or may start, and has work left or none at all (it serves others)."""
    return (
        decision.host is not None
        and decision.verdict in (Verdict.PLACED, Verdict.KEPT)
        and state.tasks.tasks[decision.task].managed
    )


def _list_allowed_hosts(state: SimState, task: Task) -> list[str]:
    """The hosts that the rules of the task allow and that are not lost."""
    own = task.robots[0] if len(task.robots) == 1 else None
    edges = [host for host in state.inventory.edges if find_rule_against(host, task, robot=False) is None]
    robots = [
        host
        for host in state.inventory.robots
        if host.name == own and find_rule_against(host, task, robot=True) is None
    ]
    return [host.name for host in (*edges, *robots) if host.name not in state.overlay.lost]


def _list_changes(
    hosts: Mapping[str, str], choices: Mapping[str, Iterable[str]]
) -> Iterable[Mapping[str, str]]:
    """Each task on another of its hosts; then each pair of tasks that may swap theirs."""
    for name, allowed in choices.items():
        yield from ({name: host} for host in allowed if host != hosts[name])
    names = list(hosts)
    for place, one in enumerate(names):
        for other in names[place + 1 :]:
            here, there = hosts[one], hosts[other]
            if here != there and here in choices[other] and there in choices[one]:
                yield {one: there, other: here}


def _rate_plan(state: SimState, hosts: Mapping[str, str]) -> PlanCost:
    """When the mission would end if every task stayed on its host, and nothing else changed."""
    speeds = _estimate_speeds(state, hosts)
    timing = state.scenario.timing
    pauses = {
        name: timing.start + timing.stop * (name in state.services)
        for name, host in hosts.items()
        if name not in state.services or state.services[name].host != host
    }
    ends: dict[str, float] = {}
    for job in _sort_open_jobs(state):
        ready = max((ends.get(before, 0.0) for before in job.after), default=0.0)
        pause = max(0.0, pauses.get(job.task, 0.0) - ready)
        speed = max(speeds.get(job.task, 1.0), _STANDSTILL)
        ends[job.name] = ready + pause + _get_work_left(state, job) / speed
    return max(ends.values(), default=0.0), sum(ends.values()) + sum(pauses.values())


def _sort_open_jobs(state: SimState) -> list[SimJob]:
    """The jobs that are not over, each after those that it waits for."""
    left = {job.name: job for job in state.scenario.jobs if not _is_over(state, job)}
    ordered: list[SimJob] = []
    while left:
        ready = [job for job in left.values() if not any(before in left for before in job.after)]
        ordered += ready
        for job in ready:
            del left[job.name]
    return ordered


def _is_over(state: SimState, job: SimJob) -> bool:
    return state.left.get(job.task) == 0 or job.name in state.ends


def _get_work_left(state: SimState, job: SimJob) -> float:
    part = state.working.get(job.name)
    if part is None:
        return job.work
    return max(0.0, part.left - part.speed * (state.env.now - part.since))


def _estimate_speeds(state: SimState, hosts: Mapping[str, str]) -> Mapping[str, float]:
    """The speed of each task if all were ready on these hosts, by the model itself on a copy."""
    env = simpy.Environment()
    services = {
        name: SimTask(task=service.task, host=service.host, since=0.0, ready=True)
        for name, service in state.services.items()
        if name not in hosts
    }
    services |= {
        name: SimTask(task=state.tasks.tasks[name], host=host, since=0.0, ready=True)
        for name, host in hosts.items()
    }
    scratch = SimState(
        env=env,
        inventory=state.inventory,
        tasks=state.tasks,
        scenario=replace(state.scenario, events=()),
        policy=state.policy,
        draw_normal=state.draw_normal,
        changed=env.event(),
        read=env.event(),
        reference=state.reference,
        services=services,
        done=state.done,
        overlay=state.overlay,
        all_tasks=state.all_tasks,
    )
    update_speeds(scratch)
    return scratch.speeds


def _redirect(decision: Decision, host: str) -> Decision:
    """The decision with another host; a task that stays is kept."""
    if host == decision.previous_host:
        return replace(decision, verdict=Verdict.KEPT, reason=Reason.STILL_BEST, host=host)
    return replace(decision, verdict=Verdict.PLACED, reason=Reason.OPTIMAL, host=host)
