# SPDX-License-Identifier: Apache-2.0
"""The resources (k in {cpu, memory, network} in the paper, and more) and the terms of eq. (4): one table.

Whatever is the same for every resource reads this table: files, documents, ledger, equations (1) to (3),
weights, history, tables. Amounts are in the resource's own unit. docs/contributing/add-a-term.md adds a row.
"""

from collections.abc import Mapping
from math import inf
from types import MappingProxyType
from typing import Any, ClassVar, NoReturn, Self, TypeVar

from edgectl.dataclass import dataclass
from edgectl.units import BYTES, BYTES_PER_S, CHARGE, CORES, GPUS, WATTS, Unit

Value = TypeVar("Value")
# Capacity of a host without the thing: what demands none of it has room, whatever demands some has none.
NOTHING = 1e-200


@dataclass(frozen=True, slots=True, kw_only=True)
class Resource:
    """One resource.

    ``name``: its key in inventory files and documents, its weight, its term. ``demand_key``: its key in
    ``demand`` of a task file. ``capacity_key`` and ``used_key``: the amounts in documents. ``compressible``:
    a task that gets less of it is slower, not dead. ``per_link``: it belongs to the link of an edge and a
    robot, not to a host. ``in_presets``: weighed by the presets ``all`` and ``resources``. ``optional``:
    few hosts have it, and no host can tell the share of one task in it, which is taken to use its demand.
    ``budget``: its capacity is stated in the inventory and never measured. ``absent``: capacity of a host
    that has none: infinite where it is then not limited, `NOTHING` where no demand fits. ``noise``:
    what readings of one task vary by, in its unit, however large the host.
    """

    name: str
    unit: Unit
    capacity_key: str
    used_key: str
    demand_key: str
    compressible: bool
    per_link: bool = False
    in_presets: bool = True
    optional: bool = False
    budget: bool = False
    absent: float = inf
    noise: float = 0.0

    def __str__(self) -> str:
        return self.name.replace("_", " ")

    @property
    def title(self) -> str:
        """Its name in headings."""
        return str(self).upper()

    def __hash__(self) -> int:
        return hash(self.name)


CPU = Resource(
    name="cpu",
    unit=CORES,
    capacity_key="cores",
    used_key="used_cores",
    demand_key="cpu",
    compressible=True,
    noise=0.05,  # the kernel counts in ticks of 10 ms, and a window is half a second
)
MEMORY = Resource(
    name="memory",
    unit=BYTES,
    capacity_key="total_bytes",
    used_key="used_bytes",
    demand_key="memory",
    compressible=False,
)
NETWORK = Resource(
    name="network",
    unit=BYTES_PER_S,
    capacity_key="capacity_bytes_per_s",
    used_key="used_bytes_per_s",
    demand_key="throughput",
    compressible=True,
    per_link=True,
)
GPU = Resource(
    name="gpu",
    unit=GPUS,
    capacity_key="gpus",
    used_key="used_gpus",
    demand_key="gpu",
    compressible=True,
    in_presets=False,
    optional=True,
    absent=NOTHING,
)
GPU_MEMORY = Resource(
    name="gpu_memory",
    unit=BYTES,
    capacity_key="gpu_total_bytes",
    used_key="gpu_used_bytes",
    demand_key="gpu_memory",
    compressible=False,
    in_presets=False,
    optional=True,
    absent=NOTHING,
)
POWER = Resource(
    name="power",
    unit=WATTS,
    capacity_key="budget_watts",
    used_key="used_watts",
    demand_key="power",
    compressible=True,
    in_presets=False,
    optional=True,
    budget=True,
)
BATTERY = Resource(
    name="battery",
    unit=CHARGE,
    capacity_key="full_charge",
    used_key="used_charge",
    demand_key="battery",
    compressible=True,
    in_presets=False,
    optional=True,
)
RESOURCES = (CPU, MEMORY, NETWORK, GPU, GPU_MEMORY, POWER, BATTERY)
HOST_RESOURCES = tuple(resource for resource in RESOURCES if not resource.per_link)
# Those whose use by one task can be measured.
TASK_RESOURCES = tuple(resource for resource in RESOURCES if not resource.optional)
# Those of which every host measures its own use and that of its tasks.
MEASURED_HOST_RESOURCES = tuple(resource for resource in HOST_RESOURCES if not resource.optional)
RESOURCES_BY_NAME: Mapping[str, Resource] = MappingProxyType(
    {resource.name: resource for resource in RESOURCES}
)
# The term of eq. (4) that is no resource: the reward for a place near the predecessors.
AFFINITY = "task"
# The term of what the robot feels (ADR 120), weighed only on request.
LATENCY = "latency"
# The term that plugins give (ADR 149), weighed only on request.
RATING = "rating"
TERMS = (*RESOURCES_BY_NAME, AFFINITY, LATENCY, RATING)
# Terms that documents leave out at their default: few fleets have them.
SPARE_TERMS = frozenset({LATENCY, RATING, *(resource.name for resource in RESOURCES if resource.optional)})


class ResourceMap(dict[str, Value]):
    """Immutable values by the name of a resource or term, in the order of the table.

    What is not given has its default. A subclass states ``DEFAULTS``, which also says which names there are,
    and ``OMITTED``: those that documents leave out at their default. A dict, because a plan of a large fleet
    reads millions.
    """

    __slots__ = ()
    DEFAULTS: ClassVar[dict[str, Any]] = {}
    OMITTED: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, values: Mapping[str, Value] | None = None, /, **named: Value) -> None:
        """Values by name, as a mapping, as keywords, or both.

        Raises:
            TypeError: a name that the table does not have.
        """
        dict.__init__(self, self.DEFAULTS)
        dict.update(self, values or (), **named)
        if len(self) != len(self.DEFAULTS):
            unknown = ", ".join(self.keys() - self.DEFAULTS.keys())
            raise TypeError(f"{type(self).__name__} has no {unknown}")

    @classmethod
    def from_complete(cls, values: Mapping[str, Value]) -> Self:
        """A map of all names, already in the order of the table: one for every candidate of every task."""
        made = cls.__new__(cls)
        dict.update(made, values)
        return made

    def __hash__(self) -> int:  # type: ignore[override]  # it is immutable, other dicts are not
        return hash(tuple(self.values()))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in self.items())})"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError(f"{type(self).__name__} cannot be changed")

    __setitem__ = __delitem__ = __ior__ = _refuse
    update = setdefault = pop = popitem = clear = _refuse

    @property
    def stated(self) -> dict[str, Value]:
        """The values that differ from their defaults."""
        return {name: value for name, value in self.items() if value != self.DEFAULTS[name]}


class Usage(ResourceMap[float]):
    """Amounts in use, 0 or more; of the network over all links."""

    __slots__ = ()
    DEFAULTS = dict.fromkeys(RESOURCES_BY_NAME, 0.0)
