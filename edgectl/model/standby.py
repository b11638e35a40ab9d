# SPDX-License-Identifier: Apache-2.0
"""Copies of a task that wait inactive on another host, and the state that a move takes along."""

from enum import StrEnum

from edgectl.agent.link import protocol
from edgectl.dataclass import dataclass
from edgectl.model.check import Check
from edgectl.model.demand import Demand

MEBIBYTE = 2.0**20


@dataclass(frozen=True, slots=True, kw_only=True)
class Activation:
    """How an instance becomes active and inactive: a pair of commands, or the lifecycle of a ROS 2 node.

    The commands run on the host of the instance, in the environment of the task; ``EDGECTL_PID`` is its main
    process. An instance is inactive when it has started. ``ready``: answered with yes by an inactive instance
    that can be activated; None: it has run for ``Task.up`` (``lifecycle``: it is configured).
    """

    activate: Check | None = None
    deactivate: Check | None = None
    lifecycle: str | None = None
    ready: Check | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StandbyRule:
    """Standby level ``warm``: ``hosts`` hosts besides the task's own keep a started, inactive copy.

    ``demand``: what one copy needs while it is inactive; of CPU and memory alone. Memory that is not stated
    is as much as that of the task, CPU none.
    """

    activation: Activation
    hosts: int = 1
    demand: Demand = Demand()


def is_standby_entry(entry: object) -> bool:
    """Whether the entry of an instance in a reply proves that it is inactive."""
    if not isinstance(entry, dict) or entry.get("role") != protocol.ROLE_STANDBY:
        return False
    return entry.get("switching", False) is False


class SaveMoment(StrEnum):
    """Whether the old instance is still active while its state is saved, or inactive by then."""

    ACTIVE = "active"
    INACTIVE = "inactive"


@dataclass(frozen=True, slots=True, kw_only=True)
class StateRule:
    """The state that a move takes along: what ``save`` prints on the old host is the input of ``load`` on the
    new one; or the last message of the latched ``topic``. ``max_bytes``: a larger state is refused.
    """

    save: Check | None = None
    load: Check | None = None
    topic: str | None = None
    moment: SaveMoment = SaveMoment.INACTIVE
    max_bytes: float = 256 * MEBIBYTE
