# SPDX-License-Identifier: Apache-2.0
"""UT_rating: the ratings of plugins, as the snapshot holds them (ADR 149). Pure."""

from collections.abc import Mapping, Sequence

from edgectl.errors import UsageError
from edgectl.model.assignment import NO_RATING
from edgectl.model.policy import Policy
from edgectl.model.resource import RATING
from edgectl.model.snapshot import Snapshot
from edgectl.scheduler.capacities import Capacities

# By task, UT_rating of each place.
Ratings = Mapping[str, Sequence[float]]


def collect_ratings(policy: Policy, snapshot: Snapshot, fleet: Capacities) -> Ratings:
    """UT_rating by task and place: the mean over the terms of ``policy``; empty where it weighs none.

    Raises:
        UsageError: ratings are weighed, and no term is named, or the snapshot lacks one.
    """
    if not policy.weights[RATING]:
        return {}
    missing = list_missing_terms(policy, snapshot)
    if missing or not policy.terms:
        named = f"the ratings of {', '.join(missing)}" if missing else "terms"
        raise UsageError(
            f"{RATING} is weighed, and {named} are missing",
            hint="plan from hosts, where the plugin is installed"
            if missing
            else "add terms: [NAME] to the task file",
        )
    rated = [snapshot.ratings[term].tasks for term in policy.terms]
    return {
        task: [
            sum(each.get(task, {}).get(host.name, NO_RATING) for each in rated) / len(rated)
            for host in fleet.places
        ]
        for task in sorted({task for each in rated for task in each})
    }


def list_missing_terms(policy: Policy, snapshot: Snapshot) -> list[str]:
    """The terms of ``policy`` that ``snapshot`` has no ratings of."""
    return [term for term in policy.terms if term not in snapshot.ratings]


def get_rating(ratings: Ratings, task: str, place: int) -> float:
    """UT_rating of one task at one place."""
    row = ratings.get(task)
    return NO_RATING if row is None else row[place]
