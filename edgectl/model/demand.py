"""Demand of a task for each resource."""

from math import inf

from edgectl.dataclass import dataclass
from edgectl.model.resource import RESOURCES_BY_NAME, ResourceMap


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A demand: absolute, in the unit of its resource, or a share of the measured capacity before limits.

    ``measured``: it counts only until there is enough history of the task on that class of host (ADR 0025).
    """

    value: float
    relative: bool = False
    measured: bool = False

    def of(self, capacity: float) -> float:
        """The demand in the unit of ``capacity`` (the host's before limits, or the link's).

        A share of no limit is 0.
        """
        if not self.relative:
            return self.value
        return self.value * capacity if capacity != inf else 0.0


ZERO = Quantity(value=0.0)


class Demand(ResourceMap[Quantity | None]):
    """rho of one task by resource; of the network, on each of its links.

    None: not stated, 0 until measured.
    """

    __slots__ = ()
    DEFAULTS = dict.fromkeys(RESOURCES_BY_NAME, None)
