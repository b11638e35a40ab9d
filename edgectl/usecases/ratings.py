# SPDX-License-Identifier: Apache-2.0
"""Ratings of hosts by plugins: computed once for a snapshot, and part of it from then on (ADR 149)."""

import dataclasses
import math
from collections.abc import Mapping

from edgectl.errors import UsageError
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot, TermRatings
from edgectl.scheduler.ratings import list_missing_terms
from edgectl.usecases.fleet import Fleet


def list_policy_plugins() -> list[str]:
    """Names of the installed plugins that are policies; none of them is imported."""
    from edgectl.plugins import PluginGroup, list_plugin_names

    return list_plugin_names(PluginGroup.POLICIES)


def add_ratings(fleet: Fleet, policy: Policy, snapshot: Snapshot) -> Snapshot:
    """``snapshot`` with the ratings of every term of ``policy``; those that it holds stay as they are.

    So a plan of a recorded snapshot is the same wherever it is made, with or without the plugin.

    Raises:
        UsageError: no installed package has a term that the snapshot lacks.
        PluginError: a term failed, or gave something else than numbers in 0..1.
    """
    missing = list_missing_terms(policy, snapshot)
    if not missing:
        return snapshot
    found = {name: _rate_hosts(name, fleet, snapshot) for name in missing}
    return dataclasses.replace(snapshot, ratings={**snapshot.ratings, **found})


def _rate_hosts(name: str, fleet: Fleet, snapshot: Snapshot) -> TermRatings:
    from edgectl.plugins import PluginGroup, list_plugin_names, load_plugin

    group = PluginGroup.TERMS
    if name not in list_plugin_names(group) and name in list_plugin_names(PluginGroup.POLICIES):
        group = PluginGroup.POLICIES
    try:
        plugin = load_plugin(group, name)
    except UsageError as error:
        hint = f"{error.hint}; a snapshot or a plan that was made with it holds its ratings"
        raise UsageError(error.message, hint=hint) from None
    # Without the state of the manager: what a term says is of files and measurements alone.
    seen = dataclasses.replace(snapshot, manager=None, ratings={})
    said = plugin.call(fleet.inventory, fleet.tasks, seen)
    try:
        return TermRatings(package=plugin.package, tasks=_check_ratings(said, fleet))
    except (TypeError, ValueError, AttributeError) as error:
        raise plugin.fail(error) from error


def _check_ratings(said: Mapping[str, Mapping[str, float]], fleet: Fleet) -> dict[str, dict[str, float]]:
    """The ratings in the order of the files.

    Raises:
        ValueError: a task or host is unknown, or a rating is not in 0..1.
        TypeError: it is no mapping of mappings of numbers.
    """
    unknown = sorted({*said} - fleet.tasks.tasks.keys()) + sorted(
        {host for hosts in said.values() for host in hosts} - fleet.inventory.hosts.keys()
    )
    if unknown:
        raise ValueError(f"it rates {unknown[0]!r}, which is neither a task nor a host of the files")
    for task, hosts in said.items():
        for host, value in hosts.items():
            if isinstance(value, bool) or not (math.isfinite(value) and 0.0 <= value <= 1.0):
                raise ValueError(f"the rating of {host} for {task} must be a number in 0..1, not {value!r}")
    return {
        task: {host: float(said[task][host]) for host in fleet.inventory.hosts if host in said[task]}
        for task in fleet.tasks.tasks
        if task in said
    }
