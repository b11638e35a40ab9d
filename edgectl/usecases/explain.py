# SPDX-License-Identifier: Apache-2.0
"""Explanation of one placement and of what would change it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import pstdev

from edgectl.model.explanation import Explanation
from edgectl.model.plan import Plan
from edgectl.model.point import HostPoint
from edgectl.model.resource import HOST_RESOURCES
from edgectl.scheduler.crossings import check_flips
from edgectl.scheduler.explain import TermNoise, find_tie
from edgectl.scheduler.explain import explain_decision as explained
from edgectl.usecases.fleet import Fleet

# Number of recent samples that measure the variation of readings, and the least number that counts.
_MAX_SAMPLES, _MIN_SAMPLES = 60, 10


def explain_placement(
    fleet: Fleet, plan: Plan, task: str, noise: Mapping[str, TermNoise] | None = None
) -> Explanation:
    """Explain the decision of ``plan`` on ``task``; each change that would alter it is planned again."""
    decisions = [step.decision for step in plan.steps]
    index = next(index for index, decision in enumerate(decisions) if decision.task == task)
    found = explained(
        fleet.inventory, fleet.tasks.tasks[task], plan.snapshot, decisions[index], plan.policy, noise
    )
    return replace(
        found,
        flips=check_flips(fleet.inventory, fleet.tasks, plan.snapshot, plan.policy, task, found.flips),
        tie=find_tie(decisions[index], decisions[:index]),
    )


def compute_noise_by_host(fleet: Fleet) -> dict[str, TermNoise]:
    """The recent variation of each host's readings, from the history."""
    points: dict[str, list[HostPoint]] = {}
    for point in fleet.history.use(
        fleet.state, fleet.warn, lambda store: store.host_points(limit=_MAX_SAMPLES)
    ):
        points.setdefault(point.host, []).append(point)
    return {host: _compute_noise(found) for host, found in points.items() if len(found) >= _MIN_SAMPLES}


def _compute_noise(points: Sequence[HostPoint]) -> TermNoise:
    shares = {
        resource.name: [point.usage[resource.name].share for point in points if resource.name in point.usage]
        for resource in HOST_RESOURCES
    }
    return TermNoise({name: pstdev(found) for name, found in shares.items() if found})
