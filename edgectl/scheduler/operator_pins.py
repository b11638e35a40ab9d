# SPDX-License-Identifier: Apache-2.0
"""Pins that operators set on tasks by ``edgectl move`` (ADR 140). Pure.

A pin that can be followed acts as the pin of a task file. One that cannot is set aside, with the reason, and
the task is placed as if it had none.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TypeAlias

from edgectl.model.assignment import Decision, OperatorPin, Reason, Rejection, RejectionRule, Verdict
from edgectl.model.manager_state import ManagerState, Pin
from edgectl.model.task import NothingFits, Task, Tasks, join_units
from edgectl.scheduler.candidates import NEW_WORK_ONLY
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.feasibility import find_missing_engine, find_own_robot, find_rule_against
from edgectl.scheduler.initial_state import InitialState
from edgectl.scheduler.latency import may_keep_deadline
from edgectl.scheduler.ledger import build_measured_ledger, compute_demand_usage
from edgectl.scheduler.placement_rules import join_apart
from edgectl.scheduler.task_usage import TaskUsage, add_usage
from edgectl.scheduler.utility import EPSILON

# By task, the hosts that it leaves to pinned tasks, each with that task.
Yielded: TypeAlias = Mapping[str, Mapping[str, str]]
NOTHING_YIELDED: Yielded = MappingProxyType({})
# Reasons for the place of a task that has only one candidate, which the pin explains better.
_EXPLAINED_BY_PIN = (
    Reason.BEST,
    Reason.PINNED,
    Reason.ONLY_FEASIBLE,
    Reason.WITH_PREDECESSOR,
    Reason.TOGETHER,
    Reason.STILL_BEST,
    Reason.FORCED_RULE,
    Reason.FORCED_DRAIN,
)


def resolve_pins(
    tasks: Tasks,
    manager: ManagerState,
    fleet: Capacities,
    state: InitialState,
    now: float,
    *,
    best_effort: bool = False,
) -> dict[str, OperatorPin]:
    """The pins that hold at ``now`` by task, each with the reason that sets it aside, if one does.

    Of pins that rules between tasks forbid together the newest counts, as of several moves of one task.
    """
    active = {name: pin for name, pin in manager.pins.items() if name in tasks.tasks and pin.is_active(now)}
    if not active:
        return {}
    units = join_units(tasks.tasks)
    pinned: dict[str, str] = {}
    for name, task in tasks.tasks.items():
        if task.hosts.pin is not None and name not in state.fixed:
            pinned |= dict.fromkeys(units.get(name, (name,)), task.hosts.pin)
    found = {}
    for name in sorted(active, key=lambda each: (-active[each].since, each)):
        host = find_pinned_host(active[name], fleet)
        mates = [tasks.tasks[mate] for mate in units.get(name, (name,))]
        obstacle = _find_obstacle(mates, host, fleet, state, best_effort=best_effort)
        if obstacle is None and host is not None:
            obstacle = _find_rule_between(mates, host, pinned, tasks)
            if obstacle is None and name not in state.fixed:
                pinned |= dict.fromkeys((mate.name for mate in mates), host)
        found[name] = OperatorPin(
            host=host or active[name].host, until=active[name].until, set_aside=obstacle
        )
    return {name: found[name] for name in active}


def find_pinned_host(pin: Pin, fleet: Capacities) -> str | None:
    """The name of the pinned host in the inventory: of the host on its machine, also where another one has
    its name now, else the name as it was; None: gone.
    """
    machines = {
        host.name: sample.machine
        for host, sample in zip(fleet.places, fleet.samples, strict=True)
        if sample is not None and sample.machine
    }
    # Slices of one machine cannot be told apart.
    found = [name for name, machine in machines.items() if pin.machine and machine == pin.machine]
    if pin.host in fleet.index and (len(found) != 1 or machines.get(pin.host, pin.machine) == pin.machine):
        return pin.host
    return found[0] if len(found) == 1 else None


def _find_obstacle(
    mates: Sequence[Task], host: str | None, fleet: Capacities, state: InitialState, *, best_effort: bool
) -> RejectionRule | None:
    """Why ``mates``, which share a host, may not all be on ``host``, even if it were idle; None: they may."""
    if host is None:
        return RejectionRule.NOT_LISTED
    place = fleet.index[host]
    for task in mates:
        closed = fleet.closed.get(place)
        running = state.running.get(task.name)
        runs_there = running is not None and running.place == place
        stays = runs_there and place not in fleet.hard and closed is not None and closed.rule in NEW_WORK_ONLY
        if closed is not None and not stays:
            return closed.rule
        rule = find_pin_obstacle(task, host, fleet, best_effort=best_effort)
        if rule is not None:
            return rule
    return None if fits_unit(mates, host, fleet, best_effort=best_effort) else RejectionRule.INSUFFICIENT


def _find_rule_between(
    mates: Sequence[Task], host: str, pinned: Mapping[str, str], tasks: Tasks
) -> RejectionRule | None:
    """The rule that forbids ``mates`` on ``host`` while the tasks in ``pinned`` are on theirs."""
    if any(pinned.get(mate.name, host) != host for mate in mates):
        return RejectionRule.TOGETHER
    names = {mate.name for mate in mates}
    others = {name for name, place in pinned.items() if place == host} - names
    apart = {other for mate in mates for other in mate.apart} & others
    return (
        RejectionRule.APART if apart or any(names & {*tasks.tasks[each].apart} for each in others) else None
    )


def find_pin_obstacle(
    task: Task, host: str, fleet: Capacities, *, best_effort: bool = False
) -> RejectionRule | None:
    """Why ``task`` can never be on ``host``, even if nothing else ran there; None: it can."""
    place = fleet.index[host]
    robot = place >= fleet.edges
    if robot and place != find_own_robot(fleet, task):
        return RejectionRule.ONBOARD
    rule = find_rule_against(fleet.places[place], task, robot=robot)
    rule = rule or find_missing_engine(fleet.samples[place], task)
    if rule is not None or best_effort or task.if_nothing_fits is NothingFits.BEST_EFFORT:
        return rule
    if not robot and any(fleet.links[name][place] is None for name in task.robots if name in fleet.links):
        return RejectionRule.NO_LINK
    if not fits_unit((task,), host, fleet):
        return RejectionRule.INSUFFICIENT
    kept = not task.hard_deadline or may_keep_deadline(build_measured_ledger(fleet), task, place)
    return None if kept else RejectionRule.DEADLINE_MISSED


def fits_unit(mates: Iterable[Task], host: str, fleet: Capacities, *, best_effort: bool = False) -> bool:
    """Whether ``host`` and its links have room for all of ``mates`` at once, even if only while idle."""
    place, use = fleet.index[host], TaskUsage()
    for task in mates:
        if best_effort or task.if_nothing_fits is NothingFits.BEST_EFFORT:
            return True
        use = add_usage(use, compute_demand_usage(fleet, task, place))
    if any(amount > fleet.usable[name][place] + EPSILON for name, amount in use.used.items()):
        return False
    return place >= fleet.edges or all(
        (fleet.links[name][place] or 0.0) + EPSILON >= rate
        for name, rate in use.links.items()
        if name in fleet.links
    )


def pin_tasks(
    order: Sequence[Task], pins: Mapping[str, OperatorPin], yielded: Yielded = NOTHING_YIELDED
) -> list[Task]:
    """``order`` with every pin that counts as one of the task file, tasks that go together sharing it, and
    with every host that is ``yielded`` as one that the file excludes.
    """
    hosts = _list_pinned_hosts(order, pins)
    return [
        replace(task, hosts=replace(task.hosts, pin=hosts[task.name]))
        if task.name in hosts
        else replace(task, hosts=replace(task.hosts, never=(*task.hosts.never, *yielded[task.name])))
        if task.name in yielded
        else task
        for task in order
    ]


def find_yielded_hosts(order: Sequence[Task], pins: Mapping[str, OperatorPin]) -> Yielded:
    """The hosts that tasks without a pin leave to pinned ones that they must be apart from, with all that go
    together with them. Otherwise a pin would wait for as long as such a task runs.
    """
    hosts = _list_pinned_hosts(order, pins)
    apart = join_apart(order) if hosts else {}
    units = join_units({task.name: task for task in order}) if apart else {}
    tasks = {task.name: task for task in order}
    found: dict[str, dict[str, str]] = {}
    for name, host in hosts.items():
        leaving = {mate for other in apart.get(name, ()) for mate in units.get(other, (other,))}
        for mate in sorted(leaving & tasks.keys() - hosts.keys()):
            if tasks[mate].hosts.pin is None and host not in tasks[mate].hosts.never:
                found.setdefault(mate, {}).setdefault(host, name)
    return found


def _list_pinned_hosts(order: Sequence[Task], pins: Mapping[str, OperatorPin]) -> dict[str, str]:
    hosts = {name: pin.host for name, pin in pins.items() if pin.set_aside is None}
    units = join_units({task.name: task for task in order}) if hosts else {}
    for name, host in list(hosts.items()):
        for mate in units.get(name, ()):
            hosts.setdefault(mate, host)
    return hosts


def explain_pins(
    decisions: Sequence[Decision], pins: Mapping[str, OperatorPin], yielded: Yielded = NOTHING_YIELDED
) -> tuple[Decision, ...]:
    """``decisions``, each with the pin of its task, which is the reason of a place that it decided, and with
    the pinned task that a host is left to.
    """
    if not pins:
        return tuple(decisions)
    return tuple(
        _explain_pin(_explain_yielded(each, yielded.get(each.task, {})), pins.get(each.task))
        for each in decisions
    )


def _explain_yielded(decision: Decision, hosts: Mapping[str, str]) -> Decision:
    """``decision`` with the pinned tasks instead of ``never``, which its file does not say."""
    if not hosts:
        return decision
    ranking = tuple(
        replace(entry, rejections=(Rejection(rule=RejectionRule.APART, task=hosts[entry.host]),))
        if entry.host in hosts and entry.rejections[:1] == (Rejection(rule=RejectionRule.NEVER),)
        else entry
        for entry in decision.ranking
    )
    left = hosts.get(decision.previous_host or "") if decision.reason is Reason.FORCED_RULE else None
    return replace(
        decision,
        ranking=ranking,
        reason=decision.reason if left is None else Reason.MADE_ROOM,
        subject=decision.subject if left is None else left,
    )


def _explain_pin(decision: Decision, pin: OperatorPin | None) -> Decision:
    if pin is None or decision.verdict not in (Verdict.PLACED, Verdict.KEPT, Verdict.UNPLACED):
        return decision
    decided = pin.set_aside is None and decision.host == pin.host and decision.reason in _EXPLAINED_BY_PIN
    return replace(decision, pin=pin, reason=Reason.PINNED_BY_OPERATOR if decided else decision.reason)
