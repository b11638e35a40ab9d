# SPDX-License-Identifier: Apache-2.0
"""Load of one task on one place."""

from collections.abc import Mapping
from dataclasses import field

from edgectl.dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskUsage:
    """Amounts by resource of the host, and bytes/s by robot."""

    used: Mapping[str, float] = field(default_factory=dict)
    links: Mapping[str, float] = field(default_factory=dict)


def take_greater(one: TaskUsage, other: TaskUsage) -> TaskUsage:
    """The greater of each two amounts; an amount that only one of them has is taken as it is."""
    return TaskUsage(used=_take_greater(one.used, other.used), links=_take_greater(one.links, other.links))


def add_usage(one: TaskUsage, other: TaskUsage) -> TaskUsage:
    """The sum of both."""
    return TaskUsage(used=_add(one.used, other.used), links=_add(one.links, other.links))


def _add(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {**other, **{name: amount + other.get(name, 0.0) for name, amount in one.items()}}


def _take_greater(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {**other, **{name: max(amount, other.get(name, amount)) for name, amount in one.items()}}
