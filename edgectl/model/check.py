# SPDX-License-Identifier: Apache-2.0
"""Questions about a task, and commands that act for it."""

from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.model.ros import RosCheck


class CheckLocation(StrEnum):
    """Location of a check: the host of the task, or its robot."""

    HOST = "host"
    ROBOT = "robot"


class OnUnhealthy(StrEnum):
    """What becomes of a task that is not alive: only said, or its supervisor restarts it."""

    REPORT = "report"
    RESTART = "restart"


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A question that is answered within ``timeout`` seconds: a shell command by its exit status (0 = yes),
    or with ``ros`` the ROS graph; ``command`` is empty then.
    """

    command: str = ""
    on: CheckLocation = CheckLocation.HOST
    timeout: float = 20.0
    ros: RosCheck | None = None

    def describe(self) -> str:
        """The question as it was asked."""
        return self.command if self.ros is None else self.ros.describe()


@dataclass(frozen=True, slots=True, kw_only=True)
class AliveRule:
    """Question that a task's supervisor asks again and again; no answer of yes for ``after`` seconds means
    unhealthy.
    """

    check: Check
    after: float = 10.0
    on_unhealthy: OnUnhealthy = OnUnhealthy.REPORT
