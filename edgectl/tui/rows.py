# SPDX-License-Identifier: Apache-2.0
"""Rows of the live view, from a snapshot and the samples before it. Pure."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from edgectl.model.inventory import Inventory
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.resource import CPU, MEASURED_HOST_RESOURCES, TASK_RESOURCES, Resource
from edgectl.model.snapshot import HostSample, LinkSample, ResourceUsage, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.names import natural_key
from edgectl.units import format_cores, format_duration, format_rate
from edgectl.views.describe_host import HostDetailsView
from edgectl.views.describe_task import TaskDetailsView
from edgectl.views.notes import join_first_words
from edgectl.views.rows import compute_task_age, find_task_demand
from edgectl.views.sparkline import SPARKLINE_SAMPLES, render_sparkline
from edgectl.views.state import TASK_STATE_STYLES, format_operator_mark, resolve_absent_task
from edgectl.views.status import StatusView
from edgectl.views.text import Cell
from edgectl.views.usage import render_difference

# Columns of the terminal: around each cell, and beside the table.
_PADDING, _SCROLLBAR = 2, 2
# Fewer show no course.
_MIN_SPARKLINE_SAMPLES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One probe of the fleet with its last samples by host and by task (oldest first), and its files."""

    snapshot: Snapshot
    inventory: Inventory
    tasks: Tasks
    host_points: Mapping[str, Sequence[HostPoint]] = field(default_factory=dict)
    task_points: Mapping[str, Sequence[TaskPoint]] = field(default_factory=dict)

    @property
    def unreachable(self) -> int:
        """Number of hosts without a reply."""
        return sum(not host.ok for host in self.snapshot.hosts.values())

    @property
    def oldest_at(self) -> float:
        """When the oldest of the samples was taken (s since 1970): a profiler's is older than the probe."""
        ages = (host.sample_age_s for host in self.snapshot.hosts.values() if host.ok)
        return self.snapshot.taken_at - max(ages, default=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class TopRow:
    """One row: its host or task, its cells, and its value under each order."""

    host: str | None
    task: str | None
    cells: tuple[Cell, ...]
    orders: Mapping[str, tuple[object, ...]]

    @property
    def key(self) -> str:
        """Identity of the row while the numbers change."""
        return f"{self.task}@{self.host}" if self.task else str(self.host)


# Of the CPU a table shows amounts and, of a task, its last samples; of the others one figure.
_OTHER_HOST_RESOURCES = tuple(each for each in MEASURED_HOST_RESOURCES if each is not CPU)
_OTHER_TASK_RESOURCES = tuple(each for each in TASK_RESOURCES if each is not CPU)
HOST_ORDERS = ("name", *(each.name for each in MEASURED_HOST_RESOURCES), "tasks")
TASK_ORDERS = ("name", "host", *(each.name for each in TASK_RESOURCES), "age")
HOST_TITLES = (
    "HOST", "STATUS", "CPU", "",
    *(title for each in _OTHER_HOST_RESOURCES for title in (f"{each.title}%", "")), "TASKS",
)  # fmt: skip
LINK_TITLES = ("LINK", "USE", "USED", "CAPACITY", "RTT", "TASKS")
LINK_ORDER = "use"
TASK_TITLES = (
    "TASK", "HOST", "STATE", "AGE", "CPU/DEMAND", "", *(each.title for each in _OTHER_TASK_RESOURCES),
)  # fmt: skip


def select_rows(lines: Iterable[TopRow], wanted: str, order: str) -> list[TopRow]:
    """The lines that show ``wanted``, in ``order``: names upwards, numbers downwards."""
    found = [
        line
        for line in lines
        if not wanted or any(wanted.lower() in cell.text.lower() for cell in line.cells)
    ]
    return sorted(found, key=lambda line: line.orders[order])


def build_host_rows(frame: Frame, width: int, *, unicode: bool) -> list[TopRow]:
    """One line per host; a sparkline per resource in what a terminal of ``width`` columns has left."""

    def lines(room: int) -> list[TopRow]:
        return [
            _build_host_row(name, host, frame, room, unicode=unicode)
            for name, host in frame.snapshot.hosts.items()
        ]

    return lines(_compute_spare_columns(lines(0), HOST_TITLES, width) // len(MEASURED_HOST_RESOURCES))


def _compute_spare_columns(lines: Sequence[TopRow], titles: Sequence[str], width: int) -> int:
    """Columns that the terminal has left beside the text."""
    return max(0, width - _SCROLLBAR - sum(each + _PADDING for each in compute_table_widths(lines, titles)))


def compute_table_widths(lines: Iterable[TopRow], titles: Sequence[str]) -> list[int]:
    """Width of each column of a table."""
    rows = [[len(cell.text) for cell in line.cells] for line in lines]
    return [max(column) for column in zip([len(title) for title in titles], *rows, strict=True)]


def _build_host_row(name: str, host: HostSample, frame: Frame, room: int, *, unicode: bool) -> TopRow:
    points = frame.host_points.get(name, ())
    closed = format_operator_mark(name, frame.snapshot.manager)
    shares = {each.name: _get_share(host.usage.get(each.name)) or 0.0 for each in MEASURED_HOST_RESOURCES}
    count = sum(task.state.alive for task in host.tasks.values())
    status = (
        Cell(closed or "ok", "warn" if closed else "good")
        if host.ok
        else Cell(closed or "unreachable", "bad")
    )
    cells = (
        Cell(name, "name"),
        status,
        *(
            cell
            for each in MEASURED_HOST_RESOURCES
            for cell in (
                _render_host_usage(each, host.usage.get(each.name)),
                _render_share_history(each, points, room, unicode=unicode),
            )
        ),
        Cell(str(count) if host.ok else "-"),
    )
    named = natural_key(name)
    by_share = {each: (-share, named) for each, share in shares.items()}
    return TopRow(
        host=name, task=None, cells=cells, orders={"name": (named,), **by_share, "tasks": (-count, named)}
    )


def _render_host_usage(resource: Resource, usage: ResourceUsage | None) -> Cell:
    """Cores in use of all, of the other resources the share in use."""
    if usage is None:
        return Cell("-")
    text = (
        f"{format_cores(usage.used)}/{format_cores(usage.capacity)}"
        if resource is CPU
        else f"{usage.share:.0%}"
    )
    return Cell(text, _get_heat_style(usage.share))


def _render_share_history(
    resource: Resource, points: Sequence[HostPoint], room: int, *, unicode: bool
) -> Cell:
    shares = [_get_share(point.usage.get(resource.name)) for point in points]
    return Cell(_render_history(shares, 1.0, room, unicode=unicode), "dim")


def build_task_rows(frame: Frame, width: int, *, unicode: bool) -> list[TopRow]:
    """One line per task and host that reports it, and one per task of the files that no host reports."""
    runs = [
        (name, host, sample)
        for host, each in frame.snapshot.hosts.items()
        for name, sample in each.tasks.items()
    ]
    seen = {name for name, _, _ in runs}
    others = [
        _build_absent_task_row(task, frame) for task in frame.tasks.tasks.values() if task.name not in seen
    ]

    def lines(room: int) -> list[TopRow]:
        return [
            _build_task_row(name, host, sample, frame, room, unicode=unicode) for name, host, sample in runs
        ] + others

    return lines(_compute_spare_columns(lines(0), TASK_TITLES, width))


def _build_task_row(
    name: str, host: str, sample: TaskSample, frame: Frame, room: int, *, unicode: bool
) -> TopRow:
    cores = [point.used[CPU.name] for point in frame.task_points.get(name, ()) if point.host == host]
    age = compute_task_age(sample, frame.snapshot)
    alive = sample.state.alive
    demand = find_task_demand(name, host, frame.snapshot, frame.inventory, frame.tasks).get(CPU.name)
    cells = (
        Cell(name, "name"),
        Cell(host),
        Cell(sample.state.value, TASK_STATE_STYLES[sample.state]),
        Cell("-" if age is None else format_duration(age)),
        _render_cores_and_demand(sample.used[CPU.name], demand) if alive else Cell("-"),
        Cell(_render_history(cores, max([demand or 0.01, *cores]), room, unicode=unicode), "dim"),
        *(Cell(each.unit.format(sample.used[each.name]) if alive else "-") for each in _OTHER_TASK_RESOURCES),
    )
    return _assemble_task_row(name, host, cells, age=age or 0.0, **sample.used)


def _render_cores_and_demand(used: float, demand: float | None) -> Cell:
    """Usage and demand of cores."""
    if demand is None:
        return Cell(format_cores(used))
    return Cell(
        f"{format_cores(used)}/{format_cores(demand)}",
        render_difference(used - demand, demand, format_cores).style,
    )


def _build_absent_task_row(task: Task, frame: Frame) -> TopRow:
    known = resolve_absent_task(task, frame.snapshot)
    cells = (
        Cell(task.name, "name"),
        Cell(known.host or "-"),
        Cell(known.state, "dim"),
        Cell("-"),
        Cell("-"),
        Cell(""),
        *(Cell("-") for _ in _OTHER_TASK_RESOURCES),
    )
    return _assemble_task_row(task.name, known.host, cells)


def _assemble_task_row(task: str, host: str | None, cells: Sequence[Cell], **amounts: float) -> TopRow:
    named = (natural_key(task), natural_key(host or ""))
    orders = {order: (-amounts.get(order, 0.0), *named) for order in TASK_ORDERS[2:]}
    return TopRow(
        host=host, task=task, cells=tuple(cells), orders={**orders, "name": named, "host": named[::-1]}
    )


def build_link_rows(frame: Frame) -> list[TopRow]:
    """One line per link of a host that answers, the busiest first."""
    return [
        _build_link_row(edge, robot, link, frame)
        for edge, sample in frame.snapshot.hosts.items()
        for robot, link in sample.links.items()
    ]


def _build_link_row(edge: str, robot: str, link: LinkSample, frame: Frame) -> TopRow:
    down = not link.capacity_bytes_per_s
    share = 0.0 if down else link.used_bytes_per_s / link.capacity_bytes_per_s
    tasks = sorted(
        name
        for name in frame.snapshot.hosts[edge].tasks
        if name in frame.tasks.tasks and robot in frame.tasks.tasks[name].robots
    )
    cells = (
        Cell(f"{edge} - {robot}", "name"),
        Cell("down", "bad") if down else Cell(f"{share:.0%}", _get_heat_style(share)),
        Cell(format_rate(link.used_bytes_per_s)),
        Cell(format_rate(link.capacity_bytes_per_s)),
        Cell("-" if link.rtt_ms is None else f"{link.rtt_ms:.1f}ms"),
        Cell(join_first_words(tasks) if tasks else "-"),
    )
    named = (natural_key(edge), natural_key(robot))
    return TopRow(host=edge, task=None, cells=cells, orders={"use": (not down, -share, *named)})


def list_problems(frame: Frame) -> list[str]:
    """What is wrong now, as ``edgectl status`` begins."""
    return StatusView(frame.snapshot, frame.inventory, frame.tasks).list_problems()


def _get_share(usage: ResourceUsage | None) -> float | None:
    return None if usage is None else usage.share


def _render_history(values: Sequence[float | None], top: float, room: int, *, unicode: bool) -> str:
    if room < _MIN_SPARKLINE_SAMPLES:
        return ""
    room = min(room, SPARKLINE_SAMPLES)
    return render_sparkline(values, top, room, unicode=unicode).rjust(room)


def _get_heat_style(share: float) -> str:
    """Colour of a share; it only repeats the number."""
    return "bad" if share > 1 else "warn" if share > 0.8 else ""


def render_row_details(frame: Frame, line: TopRow) -> str:
    """The description of the host or task of a row."""
    if line.task:
        return TaskDetailsView(line.task, frame.snapshot, frame.inventory, frame.tasks, None, None).table()
    return HostDetailsView(str(line.host), frame.snapshot, frame.inventory, frame.tasks, None).table()
