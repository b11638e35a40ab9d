# SPDX-License-Identifier: Apache-2.0
"""Worlds of a sweep: settings applied to a fleet, a scenario and the policy of its tasks. Pure."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from edgectl.experiments.model.mission_event import LinkChange, MissionEvent
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.model.sweep import SweepBounds, SweepWorld
from edgectl.formats.digest import hash_value
from edgectl.model.inventory import Inventory, Role
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import Tasks

# Raised with every change of a result: files of results are found by it. tests/experiments/
# test_simulator_digests.py fails where a result changes.
RESULTS_VERSION = 1
# Policies that know neither margin nor dwell.
_POLICIES_WITHOUT_MOVES = (PolicyName.LOCAL,)


class World(NamedTuple):
    """What settings change."""

    inventory: Inventory
    scenario: Scenario
    policy: Policy


def set_robot_cores(world: World, cores: float) -> World:
    """Each robot has so many cores."""
    hosts = {
        name: replace(machine, cores=cores) if world.inventory.hosts[name].role is Role.ROBOT else machine
        for name, machine in world.scenario.hosts.items()
    }
    return world._replace(scenario=replace(world.scenario, hosts=hosts))


def set_link_ratio(world: World, ratio: float) -> World:
    """A link that carries less than at best, at any time of the mission, then carries 1/``ratio`` of that.

    At best: the most that the inventory or the scenario states for a link.
    """
    scenario = world.scenario
    stated = [*world.inventory.links.values(), *(change.throughput for change in scenario.links)]
    best = max(stated, default=0.0)
    links = tuple(
        replace(change, throughput=best / ratio) if 0.0 < change.throughput < best else change
        for change in scenario.links
    )
    events = tuple(_slow_link(event, best, ratio) for event in scenario.events)
    return world._replace(scenario=replace(scenario, links=links, events=events))


def _slow_link(event: MissionEvent, best: float, ratio: float) -> MissionEvent:
    change: LinkChange | None = event.link
    if change is None or change.throughput is None or not 0.0 < change.throughput < best:
        return event
    return replace(event, link=replace(change, throughput=best / ratio))


def _set_timing(name: str) -> Callable[[World, Any], World]:
    def change(world: World, value: Any) -> World:  # noqa: ANN401 - as its reader has it
        timing = replace(world.scenario.timing, **{name: value})
        return world._replace(scenario=replace(world.scenario, timing=timing))

    return change


def _set_policy(name: str) -> Callable[[World, Any], World]:
    return lambda world, value: world._replace(policy=replace(world.policy, **{name: value}))


# By key of a sweep file. The inventory is read anew before.
SETTINGS: Mapping[str, Callable[[World, Any], World]] = {
    "robot_cores": set_robot_cores,
    "link_ratio": set_link_ratio,
    "radio": lambda world, radio: world._replace(scenario=replace(world.scenario, radio=radio)),
    "noise": _set_timing("noise"),
    "every": _set_timing("every"),
    "margin": _set_policy("move_margin"),
    "dwell": _set_policy("min_dwell"),
}


def build_world(
    settings: Mapping[str, str], world: World, tasks: Tasks, schemes: tuple[Scheme, ...], bounds: SweepBounds
) -> SweepWorld:
    """The world with its digest: of what affects a result, and nothing else."""
    scenario = replace(world.scenario, name="", assumptions=(), published={})
    meaning = {
        "version": RESULTS_VERSION,
        "inventory": world.inventory.digest,
        "tasks": tasks.digest,
        "scenario": scenario,
        "schemes": [_strip_policy(scheme) for scheme in schemes],
        "bounds": bounds,
    }
    return SweepWorld(
        settings=settings,
        inventory=world.inventory,
        tasks=tasks,
        scenario=scenario,
        schemes=schemes,
        bounds=bounds,
        digest=hash_value(_make_hashable(meaning)),
    )


def _strip_policy(scheme: Scheme) -> Scheme:
    """The scheme without settings that its policy does not read."""
    if scheme.policy.name not in _POLICIES_WITHOUT_MOVES:
        return scheme
    plain = Policy()
    return replace(
        scheme, policy=replace(scheme.policy, move_margin=plain.move_margin, min_dwell=plain.min_dwell)
    )


def _make_hashable(value: Any) -> Any:  # noqa: ANN401 - any value of a model
    return {key: tuple(inner) if isinstance(inner, list) else inner for key, inner in value.items()}
