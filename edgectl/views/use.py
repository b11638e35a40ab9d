"""What is used, against what there is and what was asked for."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from edgectl.formats.base import Document, number
from edgectl.model.demand import enough, host_class, of_today, resolved
from edgectl.model.inventory import Host
from edgectl.model.memory import Memory
from edgectl.model.snapshot import HostSample, TaskSample
from edgectl.model.task import Demand, Quantity, Task
from edgectl.views.spark import SAMPLES, bar, spark
from edgectl.views.text import Cell, Look, Row, columns, room_beside

_BAR = 8
_LEAST_BESIDE = 24
_INDENT = 4
_WRAPPED = frozenset({0, 1, 4})  # of hosts the name, status and link; of tasks the name and host
_SLACK = 0.05  # so much of its demand a task may be above it before it is marked


@dataclass(frozen=True, slots=True, kw_only=True)
class Amounts:
    """What a task demands on its host, or uses: cores, bytes, and bytes/s over all of its links. None: not stated."""

    cores: float | None = None
    bytes: float | None = None
    rate: float | None = None

    def document(self) -> Document:
        """As JSON types; what is not stated is absent."""
        named = {"cores": self.cores, "bytes": self.bytes, "bytes_per_s": self.rate}
        return {key: number(value) for key, value in named.items() if value is not None}


def share(used: float, capacity: float, limit: float, look: Look) -> Cell:
    """``64%``, on a terminal behind a bar; above ``limit`` (a share of the capacity) it says so."""
    part = used / capacity if capacity > 0 else 0.0
    text = f"{part:4.0%}" if look.width is not None else f"{part:.0%}"
    drawn = f"{bar(part, _BAR, unicode=look.unicode)} {text}" if look.width is not None else text
    return Cell(drawn + "!", "bad") if part > limit else Cell(drawn)


def demanded(task: Task, host: Host | None, sample: HostSample, memory: Memory | None) -> Amounts:
    """What counts as the demand of ``task`` on its host: measured where that is wished for and known, else as stated."""
    demand = _demand(task, host, sample, memory)
    links = [sample.links[robot].capacity_bytes_per_s if robot in sample.links else 0.0 for robot in task.robots]
    return Amounts(
        cores=_of(demand.cpu, sample.cpu.cores if sample.cpu else 0.0),
        bytes=_of(demand.memory, sample.memory.total_bytes if sample.memory else 0.0),
        rate=sum(demand.throughput.of(capacity) for capacity in links) if demand.throughput is not None and links else None,
    )


def _demand(task: Task, host: Host | None, sample: HostSample, memory: Memory | None) -> Demand:
    if host is None or memory is None or sample.cpu is None or sample.memory is None:
        return task.demand
    found = memory.measured.get((task.name, host_class(host, sample.cpu.cores, sample.memory.total_bytes)))
    return resolved(task.demand, found) if found is not None and enough(found) and of_today(task, found) else task.demand


def _of(quantity: Quantity | None, capacity: float) -> float | None:
    return None if quantity is None else quantity.of(capacity)


def off(sample: TaskSample, demand: Amounts) -> Amounts:
    """Use minus demand, where there is one."""
    pairs = ((sample.used_cores, demand.cores), (sample.used_bytes, demand.bytes), (sample.used_bytes_per_s, demand.rate))
    cores, size, rate = (None if wanted is None else used - wanted for used, wanted in pairs)
    return Amounts(cores=cores, bytes=size, rate=rate)


def shown(value: float | None, show: Callable[[float], str]) -> str:
    """A quantity, or a dash."""
    return "-" if value is None else show(value)


def apart(value: float | None, demand: float | None, show: Callable[[float], str]) -> Cell:
    """A difference from ``demand``, signed, so that more than was asked for shows without colour."""
    if value is None or demand is None:
        return Cell("-")
    text = show(abs(value))
    zero = text == show(0.0)
    sign = "" if zero else "+" if value > 0 else "-"
    return Cell(sign + text, "warn" if value > demand * _SLACK and not zero else "")


def with_history(
    rows: Sequence[Row], histories: Sequence[tuple[Sequence[float | None], float]], look: Look, *, right: Collection[int] = ()
) -> str:
    """The rows (the first is the head) as columns with a sparkline each, of values and what the top of its line means.

    Beside the table where there is room, else below its row. Nothing is drawn where there is no terminal.
    """
    longest = min(SAMPLES, max((len(values) for values, _ in histories), default=0))
    if look.width is None or not longest:
        return columns(rows, look, right=right, wrap=_WRAPPED)
    room = room_beside(rows, look)
    beside = room >= min(longest, _LEAST_BESIDE)
    width = min(longest, room if beside else look.width - _INDENT)
    lines = [spark(values[-width:], top, width, unicode=look.unicode) for values, top in histories]
    title = f"CPU, LAST {width} SAMPLES"
    head = title if beside and len(title) <= room else ""
    drawn = [(*rows[0], head), *((*row, line) for row, line in zip(rows[1:], lines, strict=True))]
    return columns(drawn, look, right=right, wrap=_WRAPPED, below=not beside)
