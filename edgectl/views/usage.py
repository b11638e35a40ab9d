"""What is used, against what there is and what was asked for."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from edgectl.formats.document import Document, encode_number
from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState
from edgectl.model.measured_demand import (
    classify_host,
    has_enough_samples,
    is_of_current_spec,
    resolve_demand,
)
from edgectl.model.snapshot import HostSample, ResourceUsage, TaskSample
from edgectl.model.task import Demand, Quantity, Task
from edgectl.views.sparkline import SPARKLINE_SAMPLES, render_bar, render_sparkline
from edgectl.views.text import Cell, RenderOptions, Row, compute_remaining_width, render_columns

_BAR_WIDTH = 8
_MIN_SPARKLINE_WIDTH = 24
_SPARKLINE_INDENT = 4
_WRAPPED_COLUMNS = frozenset({0, 1, 4})  # of hosts the name, status and link; of tasks the name and host
_DEMAND_TOLERANCE = 0.05  # so much of its demand a task may be above it before it is marked


@dataclass(frozen=True, slots=True, kw_only=True)
class ResourceAmounts:
    """What a task demands on its host, or uses: cores, bytes, and bytes/s over all of its links. None: not stated."""

    cores: float | None = None
    bytes: float | None = None
    rate: float | None = None

    def document(self) -> Document:
        """As JSON types; what is not stated is absent."""
        named = {"cores": self.cores, "bytes": self.bytes, "bytes_per_s": self.rate}
        return {key: encode_number(value) for key, value in named.items() if value is not None}


def render_usage_share(usage: ResourceUsage, limit: float, look: RenderOptions) -> Cell:
    """``64%``, on a terminal behind a bar; above ``limit`` (a share of the capacity) it says so."""
    part = usage.used / usage.capacity if usage.capacity > 0 else 0.0
    text = f"{part:4.0%}" if look.width is not None else f"{part:.0%}"
    drawn = f"{render_bar(part, _BAR_WIDTH, unicode=look.unicode)} {text}" if look.width is not None else text
    return Cell(drawn + "!", "bad") if part > limit else Cell(drawn)


def compute_task_demand(
    task: Task, host: Host | None, sample: HostSample, memory: ManagerState | None
) -> ResourceAmounts:
    """What counts as the demand of ``task`` on its host: measured where that is wished for and known, else as stated."""
    demand = _select_current_demand(task, host, sample, memory)
    links = [
        sample.links[robot].capacity_bytes_per_s if robot in sample.links else 0.0 for robot in task.robots
    ]
    rate = demand["network"]
    return ResourceAmounts(
        cores=_compute_amount(demand["cpu"], sample.usage["cpu"].capacity if "cpu" in sample.usage else 0.0),
        bytes=_compute_amount(
            demand["memory"], sample.usage["memory"].capacity if "memory" in sample.usage else 0.0
        ),
        rate=sum(rate.of(capacity) for capacity in links) if rate is not None and links else None,
    )


def _select_current_demand(
    task: Task, host: Host | None, sample: HostSample, memory: ManagerState | None
) -> Demand:
    if host is None or memory is None or not sample.measured:
        return task.demand
    found = memory.measured.get(
        (task.name, classify_host(host, sample.usage["cpu"].capacity, sample.usage["memory"].capacity))
    )
    return (
        resolve_demand(task.demand, found)
        if found is not None and has_enough_samples(found) and is_of_current_spec(task, found)
        else task.demand
    )


def _compute_amount(quantity: Quantity | None, capacity: float) -> float | None:
    return None if quantity is None else quantity.of(capacity)


def subtract_demand(sample: TaskSample, demand: ResourceAmounts) -> ResourceAmounts:
    """Use minus demand, where there is one."""
    pairs = (
        (sample.used["cpu"], demand.cores),
        (sample.used["memory"], demand.bytes),
        (sample.used["network"], demand.rate),
    )
    cores, size, rate = (None if wanted is None else used - wanted for used, wanted in pairs)
    return ResourceAmounts(cores=cores, bytes=size, rate=rate)


def format_or_dash(value: float | None, show: Callable[[float], str]) -> str:
    """A quantity, or a dash."""
    return "-" if value is None else show(value)


def render_difference(value: float | None, demand: float | None, show: Callable[[float], str]) -> Cell:
    """A difference from ``demand``, signed, so that more than was asked for shows without colour."""
    if value is None or demand is None:
        return Cell("-")
    text = show(abs(value))
    zero = text == show(0.0)
    sign = "" if zero else "+" if value > 0 else "-"
    return Cell(sign + text, "warn" if value > demand * _DEMAND_TOLERANCE and not zero else "")


def render_with_sparklines(
    rows: Sequence[Row],
    histories: Sequence[tuple[Sequence[float | None], float]],
    look: RenderOptions,
    *,
    right: Collection[int] = (),
) -> str:
    """The rows (the first is the head) as columns with a sparkline each, of values and what the top of its line means.

    Beside the table where there is room, else below its row. Nothing is drawn where there is no terminal.
    """
    longest = min(SPARKLINE_SAMPLES, max((len(values) for values, _ in histories), default=0))
    if look.width is None or not longest:
        return render_columns(rows, look, right=right, wrap=_WRAPPED_COLUMNS)
    room = compute_remaining_width(rows, look)
    beside = room >= min(longest, _MIN_SPARKLINE_WIDTH)
    width = min(longest, room if beside else look.width - _SPARKLINE_INDENT)
    lines = [render_sparkline(values[-width:], top, width, unicode=look.unicode) for values, top in histories]
    title = f"CPU, LAST {width} SAMPLES"
    head = title if beside and len(title) <= room else ""
    drawn = [(*rows[0], head), *((*row, line) for row, line in zip(rows[1:], lines, strict=True))]
    return render_columns(drawn, look, right=right, wrap=_WRAPPED_COLUMNS, below=not beside)
