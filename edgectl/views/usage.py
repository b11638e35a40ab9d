# SPDX-License-Identifier: Apache-2.0
"""Usage against capacity and demand."""

from collections.abc import Callable, Collection, Mapping, Sequence

from edgectl.model.demand import Demand
from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState
from edgectl.model.resource import CPU, MEMORY, RESOURCES, TASK_RESOURCES
from edgectl.model.snapshot import HostSample, LinkSample, ResourceUsage, TaskSample
from edgectl.model.task import Task
from edgectl.rules.measured_demand import (
    classify_host,
    has_enough_samples,
    is_of_current_spec,
    resolve_demand,
)
from edgectl.units import format_duration, format_rate
from edgectl.views.sparkline import SPARKLINE_SAMPLES, render_bar, render_sparkline
from edgectl.views.text import Cell, RenderOptions, Row, compute_remaining_width, render_columns

_BAR_WIDTH = 8
_MIN_SPARKLINE_WIDTH = 24
_SPARKLINE_INDENT = 4
_WRAPPED_COLUMNS = frozenset({1, 4})  # of hosts the status and the link
_DEMAND_TOLERANCE = 0.05  # share of its demand by which a task may exceed it before it is marked


# Demand or usage of a task on its host by resource, of the network over all of its links; absent: not stated.
Amounts = Mapping[str, float]


def render_usage_share(usage: ResourceUsage, limit: float, look: RenderOptions) -> Cell:
    """``64%``, on a terminal behind a bar; marked with ``!`` above ``limit`` (a share of the capacity)."""
    part = usage.share if usage.capacity > 0 else 0.0
    text = f"{part:4.0%}" if look.width is not None else f"{part:.0%}"
    drawn = f"{render_bar(part, _BAR_WIDTH, unicode=look.unicode)} {text}" if look.width is not None else text
    return Cell(drawn + "!", "bad") if part > limit else Cell(drawn)


def describe_capacity(link: LinkSample) -> str:
    """The capacity of a link with its source; of a live one also its age and what it lowers."""
    capacity = format_rate(link.capacity_bytes_per_s)
    if link.nominal is None:
        return f"{capacity} ({link.capacity_source})"
    age = render_capacity_age(link)
    return f"{capacity} ({link.capacity_source}, {age} ago, nominal {format_rate(link.nominal)})"


def format_sample_age(sample: HostSample) -> str:
    """Age of the readings of a host, and whether a profiler took them."""
    return format_duration(sample.sample_age_s) + (" profiler" if sample.resident else "")


def render_capacity_age(link: LinkSample | None) -> str:
    """The age of a live capacity; ``-`` of any other."""
    return "-" if link is None or link.capacity_age_s is None else format_duration(link.capacity_age_s)


def compute_task_demand(
    task: Task, host: Host | None, sample: HostSample, memory: ManagerState | None
) -> Amounts:
    """The demand of ``task`` on its host: measured where asked for and known, else declared."""
    demand = _select_current_demand(task, host, sample, memory)
    links = [
        sample.links[robot].nominal_bytes_per_s if robot in sample.links else 0.0 for robot in task.robots
    ]
    amounts = {}
    for resource in RESOURCES:
        quantity, usage = demand[resource.name], sample.usage.get(resource.name)
        if quantity is not None and not resource.per_link:
            amounts[resource.name] = quantity.of(usage.capacity if usage is not None else 0.0)
        elif quantity is not None and links:
            amounts[resource.name] = sum(quantity.of(capacity) for capacity in links)
    return amounts


def _select_current_demand(
    task: Task, host: Host | None, sample: HostSample, memory: ManagerState | None
) -> Demand:
    if host is None or memory is None or not sample.measured:
        return task.demand
    found = memory.measured.get(
        (
            task.name,
            classify_host(host, sample.usage[CPU.name].capacity, sample.usage[MEMORY.name].capacity),
        )
    )
    return (
        resolve_demand(task.demand, found)
        if found is not None and has_enough_samples(found) and is_of_current_spec(task, found)
        else task.demand
    )


def subtract_demand(sample: TaskSample, demand: Amounts) -> Amounts:
    """Usage minus demand, where there is one and the usage can be measured."""
    return {
        each.name: sample.used[each.name] - demand[each.name]
        for each in TASK_RESOURCES
        if each.name in demand
    }


def format_traffic(text: str, partial: str) -> str:
    """Traffic with what it lacks (``partial``, empty for nothing)."""
    return f"{text} (partial: {partial})" if partial else text


def format_or_dash(value: float | None, show: Callable[[float], str]) -> str:
    """A quantity, or a dash."""
    return "-" if value is None else show(value)


def render_difference(value: float | None, demand: float | None, show: Callable[[float], str]) -> Cell:
    """A signed difference from ``demand``, so that an excess shows without colour."""
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
    headers: bool = True,
) -> str:
    """The rows (the first has the ``headers``) with a sparkline each: its values, and the value of its top.

    Beside the table where there is room, for the shortest one also by wrapped headings; else below its row.
    None without a terminal.
    """
    longest = min(SPARKLINE_SAMPLES, max((len(values) for values, _ in histories), default=0))
    if look.width is None or not longest:
        return render_columns(rows[0 if headers else 1 :], look, right=right, wrap=_WRAPPED_COLUMNS)
    shortest, room = min(longest, _MIN_SPARKLINE_WIDTH), compute_remaining_width(rows, look)
    if room < shortest:
        room = min(shortest, compute_remaining_width(rows, look, wrap_headings=True))
    beside = room >= shortest
    width = min(longest, room if beside else look.width - _SPARKLINE_INDENT)
    lines = [render_sparkline(values[-width:], top, width, unicode=look.unicode) for values, top in histories]
    title = f"CPU, LAST {width} SAMPLES"
    title_cell = Cell(title if not beside or len(title) <= room else "", "head")
    drawn = [(*rows[0], title_cell), *((*row, line) for row, line in zip(rows[1:], lines, strict=True))]
    shown = drawn[0 if headers else 1 :]
    return render_columns(shown, look, right=right, wrap=_WRAPPED_COLUMNS, below=not beside)
