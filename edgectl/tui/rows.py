"""What the live view shows: a snapshot and the samples before it, as rows and as text. Pure."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import attrgetter

from edgectl.model.order import natural_key
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample
from edgectl.model.task import Task
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import metrics
from edgectl.views.absent import absent, standing
from edgectl.views.spark import SAMPLES, spark
from edgectl.views.state import STATES, phrase
from edgectl.views.text import Cell

# Columns of the terminal: around each cell, and beside the table.
_PADDING, _SCROLLBAR = 2, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One picture: the fleet now, what it was by host and by task (oldest first), and the tasks of the files."""

    snapshot: Snapshot
    tasks: Mapping[str, Task]
    host_points: Mapping[str, tuple[HostPoint, ...]] = field(default_factory=dict)
    task_points: Mapping[str, tuple[TaskPoint, ...]] = field(default_factory=dict)

    @property
    def silent(self) -> int:
        """How many hosts did not answer."""
        return sum(not host.ok for host in self.snapshot.hosts.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One row: what it is about, its cells, and its value under each order."""

    host: str | None
    task: str | None
    cells: tuple[Cell, ...]
    orders: Mapping[str, tuple[object, ...]]

    @property
    def key(self) -> str:
        """What stays the same while the numbers change."""
        return f"{self.task}@{self.host}" if self.task else str(self.host)


HOST_ORDERS = ("name", "cpu", "memory", "tasks")
TASK_ORDERS = ("name", "host", "cpu", "memory", "network", "age")
HOST_TITLES = ("HOST", "STATUS", "CPU", "", "MEMORY", "", "TASKS")
TASK_TITLES = ("TASK", "HOST", "STATE", "AGE", "CPU", "", "MEMORY", "NETWORK")


def by_host(points: Iterable[HostPoint]) -> dict[str, tuple[HostPoint, ...]]:
    """Samples by host."""
    return {host: tuple(found) for host, found in groupby(sorted(points, key=attrgetter("host", "at")), key=attrgetter("host"))}


def by_task(points: Iterable[TaskPoint]) -> dict[str, tuple[TaskPoint, ...]]:
    """Samples by task."""
    return {task: tuple(found) for task, found in groupby(sorted(points, key=attrgetter("task", "at")), key=attrgetter("task"))}


def chosen(lines: Iterable[Line], wanted: str, order: str) -> list[Line]:
    """The lines that show ``wanted``, in ``order``: names upwards, numbers downwards."""
    found = [line for line in lines if not wanted or any(wanted.lower() in cell.text.lower() for cell in line.cells)]
    return sorted(found, key=lambda line: line.orders[order])


def host_lines(frame: Frame, width: int, *, unicode: bool) -> list[Line]:
    """One line per host; two sparklines share what a terminal of ``width`` columns has left."""

    def lines(room: int) -> list[Line]:
        return [_host_line(name, host, frame, room, unicode=unicode) for name, host in frame.snapshot.hosts.items()]

    return lines(_left(lines(0), HOST_TITLES, width) // 2)


def _left(lines: Sequence[Line], titles: Sequence[str], width: int) -> int:
    """Columns that the terminal has left beside the text."""
    return max(0, width - _SCROLLBAR - sum(each + _PADDING for each in widths(lines, titles)))


def widths(lines: Iterable[Line], titles: Sequence[str]) -> list[int]:
    """What each column of a table needs."""
    rows = [[len(cell.text) for cell in line.cells] for line in lines]
    return [max(column) for column in zip([len(title) for title in titles], *rows, strict=True)]


def _host_line(name: str, host: HostSample, frame: Frame, room: int, *, unicode: bool) -> Line:
    points = frame.host_points.get(name, ())
    closed = standing(name, frame.snapshot.memory)
    cpu = host.cpu.used_cores / host.cpu.cores if host.cpu else 0.0
    memory = host.memory.used_bytes / host.memory.total_bytes if host.memory else 0.0
    count = sum(task.state.alive for task in host.tasks.values())
    status = Cell(closed or "ok", "warn" if closed else "good") if host.ok else Cell(closed or "silent", "bad")
    cells = (
        Cell(name, "name"),
        status,
        Cell(f"{format_cores(host.cpu.used_cores)}/{format_cores(host.cpu.cores)}" if host.cpu else "-", _heat(cpu)),
        Cell(_past([_share(p.used_cores, p.cores) for p in points], 1.0, room, unicode=unicode), "dim"),
        Cell(f"{memory:.0%}" if host.memory else "-", _heat(memory)),
        Cell(_past([_share(p.used_bytes, p.total_bytes) for p in points], 1.0, room, unicode=unicode), "dim"),
        Cell(str(count) if host.ok else "-"),
    )
    named = natural_key(name)
    return Line(
        host=name, task=None, cells=cells,
        orders={"name": (named,), "cpu": (-cpu, named), "memory": (-memory, named), "tasks": (-count, named)},
    )  # fmt: skip


def task_lines(frame: Frame, width: int, *, unicode: bool) -> list[Line]:
    """One line per task and host that reports it, and one per task of the files that no host reports."""
    runs = [(name, host, sample) for host, each in frame.snapshot.hosts.items() for name, sample in each.tasks.items()]
    seen = {name for name, _, _ in runs}
    others = [_absent_line(task, frame) for task in frame.tasks.values() if task.name not in seen]

    def lines(room: int) -> list[Line]:
        return [_task_line(name, host, sample, frame, room, unicode=unicode) for name, host, sample in runs] + others

    return lines(_left(lines(0), TASK_TITLES, width))


def _task_line(name: str, host: str, sample: TaskSample, frame: Frame, room: int, *, unicode: bool) -> Line:
    cores = [point.used_cores for point in frame.task_points.get(name, ()) if point.host == host]
    age = max(0.0, frame.snapshot.taken_at - sample.started_at) if sample.started_at else 0.0
    alive = sample.state.alive
    cells = (
        Cell(name, "name"),
        Cell(host),
        Cell(sample.state.value, STATES[sample.state]),
        Cell(format_duration(age) if sample.started_at else "-"),
        Cell(format_cores(sample.used_cores) if alive else "-"),
        Cell(_past(cores, max([*cores, 0.01]), room, unicode=unicode), "dim"),
        Cell(format_bytes(sample.used_bytes) if alive else "-"),
        Cell(format_rate(sample.used_bytes_per_s) if alive else "-"),
    )
    return _line(name, host, cells, cpu=sample.used_cores, memory=sample.used_bytes, network=sample.used_bytes_per_s, age=age)


def _absent_line(task: Task, frame: Frame) -> Line:
    known = absent(task, frame.snapshot)
    cells = (
        Cell(task.name, "name"),
        Cell(known.host or "-"),
        Cell(known.state, "dim"),
        Cell("-"),
        Cell("-"),
        Cell(""),
        Cell("-"),
        Cell("-"),
    )
    return _line(task.name, known.host, cells)


def _line(task: str, host: str | None, cells: Sequence[Cell], **amounts: float) -> Line:
    named = (natural_key(task), natural_key(host or ""))
    orders = {order: (-amounts.get(order, 0.0), *named) for order in TASK_ORDERS[2:]}
    return Line(host=host, task=task, cells=tuple(cells), orders={**orders, "name": named, "host": named[::-1]})


def _share(used: float | None, capacity: float | None) -> float | None:
    return used / capacity if used is not None and capacity else None


def _past(values: Sequence[float | None], top: float, room: int, *, unicode: bool) -> str:
    room = min(room, SAMPLES)
    return spark(values, top, room, unicode=unicode).rjust(room)


def _heat(share: float) -> str:
    """Colour that only repeats what the number says."""
    return "bad" if share > 1 else "warn" if share > 0.8 else ""


def described(frame: Frame, line: Line) -> str:
    """Everything that is known of a line."""
    facts = _task_facts(frame, line) if line.task else _host_facts(frame, str(line.host))
    width = max(len(name) for name, _ in facts)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in facts)


def _host_facts(frame: Frame, name: str) -> list[tuple[str, str]]:
    host = frame.snapshot.hosts[name]
    facts = [("host", f"{name} ({host.role})"), ("status", standing(name, frame.snapshot.memory) or host.status.value)]
    facts += _given(("error", host.error), ("hint", host.hint))
    if host.cpu and host.memory:
        facts.append(("cpu", f"{format_cores(host.cpu.used_cores)} of {format_cores(host.cpu.cores)} cores"))
        facts.append(("memory", f"{format_bytes(host.memory.used_bytes)} of {format_bytes(host.memory.total_bytes)}"))
    facts += _optional("load", host.device.load_1m, "{:.2f}") + _optional("temperature", host.device.temperature_c, "{:.0f} °C")
    for robot, link in host.links.items():
        trip = "" if link.rtt_ms is None else f", {link.rtt_ms:.1f} ms"
        used, carries = format_rate(link.used_bytes_per_s), format_rate(link.capacity_bytes_per_s)
        facts.append((f"link {robot}", f"{used} of {carries} ({link.capacity_source}){trip}"))
    return facts + [(f"task {task}", phrase(sample)) for task, sample in host.tasks.items()]


def _task_facts(frame: Frame, line: Line) -> list[tuple[str, str]]:
    host = frame.snapshot.hosts.get(line.host or "")
    sample = host.tasks.get(str(line.task)) if host else None
    task = frame.tasks.get(str(line.task))
    facts = [("task", str(line.task)), ("host", line.host or "-"), ("state", phrase(sample) if sample else line.cells[2].text)]
    if sample:
        facts += _given(("started", format_instant(sample.started_at) if sample.started_at else ""))
        facts.append(
            ("uses", f"{format_cores(sample.used_cores)} cores, {format_bytes(sample.used_bytes)}, {format_rate(sample.used_bytes_per_s)}")
        )
        facts.append(("restarts", str(sample.restarts)))
        facts += _given(("metrics", metrics.line(sample.metrics) if sample.metrics else ""))
        facts += _given(("limits", sample.limits), *(("said last", text) for text in sample.log_tail))
    if task:
        facts += _given(("robots", ", ".join(task.robots)), ("needs", ", ".join(need.task for need in task.needs)))
        facts += _given(("pinned to", task.hosts.pin or ""))
    else:
        facts.append(("files", "no task of the files has this name"))
    return facts


def _given(*facts: tuple[str, str]) -> list[tuple[str, str]]:
    return [(name, value) for name, value in facts if value]


def _optional(name: str, value: float | None, form: str) -> list[tuple[str, str]]:
    return [] if value is None else [(name, form.format(value))]
