"""Usage of hosts and tasks, now and over the last samples, against capacity and demand."""

from collections.abc import Iterable, Sequence

from edgectl.errors import describe_unseen_task
from edgectl.formats.document import Document, without_none
from edgectl.model.inventory import Host, Inventory, Limits
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.resource import CPU, HOST_RESOURCES, RESOURCES, TASK_RESOURCES, Resource
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.names import natural_key
from edgectl.units import format_duration, format_instant, format_rate
from edgectl.views import metrics
from edgectl.views.glossary import get_flat_used_key, head
from edgectl.views.output import ListView
from edgectl.views.output_format import WIDE_FORMATS
from edgectl.views.plan_sections import list_snapshot_notes
from edgectl.views.rows import compute_task_age, encode_host_row, encode_run_row, find_task_demand
from edgectl.views.state import TASK_STATE_STYLES, render_host_status, resolve_absent_task
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns
from edgectl.views.usage import (
    Amounts,
    format_or_dash,
    render_difference,
    render_usage_share,
    render_with_sparklines,
    subtract_demand,
)

_HOST_HEAD = head("host", "status", *(f"{each.name}.share" for each in HOST_RESOURCES), "link", "task_count")
_WIDE_HOST_HEAD = head(
    *(f"{each.name}.usage" for each in HOST_RESOURCES),
    "rx_bytes_per_s",
    "tx_bytes_per_s",
    "device.load_1m",
    "device.temperature_c",
)
# Of the CPU the demand is always shown, of the others in the wide form.
_OTHER_TASK_RESOURCES = tuple(each for each in TASK_RESOURCES if each is not CPU)
_UNMEASURED_RESOURCES = tuple(each for each in RESOURCES if each not in TASK_RESOURCES)


def _list_columns(resource: Resource, *amounts: str) -> tuple[str, ...]:
    return tuple(f"{resource.name}.{amount}_{resource.unit.name}" for amount in amounts)


_TASK_HEAD = head(
    "task", "host", *_list_columns(CPU, "used", "demand", "excess"),
    *(column for each in _OTHER_TASK_RESOURCES for column in _list_columns(each, "used")), "age_s", "ready",
)  # fmt: skip
_WIDE_TASK_HEAD = head(
    *(column for each in _OTHER_TASK_RESOURCES for column in _list_columns(each, "demand", "excess")),
    *(column for each in _UNMEASURED_RESOURCES for column in _list_columns(each, "demand")), "restarts",
)  # fmt: skip
_HOST_RIGHT_COLUMNS = frozenset(range(2, len(_HOST_HEAD) + len(_WIDE_HOST_HEAD))) - {2 + len(HOST_RESOURCES)}
_RIGHT_COLUMNS = frozenset(range(2, len(_TASK_HEAD) - 1))
_WIDE_RIGHT_COLUMNS = frozenset(range(len(_TASK_HEAD), len(_TASK_HEAD) + len(_WIDE_TASK_HEAD)))


class TopHostsView(ListView):
    """Usage of each host: its CPU, its memory and its busiest link, with the CPU over the last samples."""

    kind = "host-usage"
    formats = WIDE_FORMATS

    def __init__(self, snapshot: Snapshot, inventory: Inventory, points: Iterable[HostPoint]) -> None:
        self._snapshot, self._inventory = snapshot, inventory
        self._points = group_points_by_host(points)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Shares of the capacity."""
        return self._render(look, wide=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with absolute numbers, network interfaces, load and temperature."""
        return self._render(look, wide=True)

    def _render(self, look: RenderOptions, *, wide: bool) -> str:
        value, inventory = self._snapshot, self._inventory
        rows = [
            _render_top_host_row(name, sample, inventory.hosts.get(name), value, look, wide=wide)
            for name, sample in value.hosts.items()
        ]
        histories = [
            ([_get_cpu_share(point) for point in self._points.get(name, ())], 1.0) for name in value.hosts
        ]
        first: Row = (*_HOST_HEAD, *_WIDE_HOST_HEAD) if wide else _HOST_HEAD
        return render_with_sparklines([first, *rows], histories, look, right=_HOST_RIGHT_COLUMNS)

    def items(self) -> Sequence[Document]:
        """The hosts as JSON types, each with its last samples, oldest first."""
        return [
            encode_host_row(name, self._snapshot)
            | {"history": list(map(_encode_host_point, self._points.get(name, ())))}
            for name in self._snapshot.hosts
        ]

    def warnings(self) -> Sequence[str]:
        """Hosts above their limits, and hosts without a reply."""
        return [
            *_list_over_limit_notes(self._snapshot, self._inventory),
            *list_snapshot_notes(self._snapshot),
        ]


class TopTasksView(ListView):
    """Usage of each task that runs, against its demand, with its CPU over the last samples."""

    kind = "task-usage"
    formats = WIDE_FORMATS

    def __init__(
        self, snapshot: Snapshot, inventory: Inventory, tasks: Tasks, points: Iterable[TaskPoint]
    ) -> None:
        self._snapshot, self._inventory, self._tasks = snapshot, inventory, tasks
        self._points = group_points_by_task(points)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per task; then the metrics that applications report."""
        return self._render(look, wide=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with demand and excess of memory and network."""
        return self._render(look, wide=True)

    def _render(self, look: RenderOptions, *, wide: bool) -> str:
        runs = _list_running_tasks(self._snapshot)
        if not runs:
            return ""
        rows: list[Row] = [(*_TASK_HEAD, *_WIDE_TASK_HEAD) if wide else _TASK_HEAD]
        histories: list[tuple[Sequence[float | None], float]] = []
        for name, host, sample in runs:
            demand = self._find_demand(name, host)
            task = self._tasks.tasks.get(name)
            rows.append(_render_top_task_row(name, host, sample, task, demand, self._snapshot, wide=wide))
            used = [point.used[CPU.name] for point in self._points.get(name, ())]
            histories.append((used, max([demand.get(CPU.name) or 0.0, *used])))
        right = _RIGHT_COLUMNS | _WIDE_RIGHT_COLUMNS if wide else _RIGHT_COLUMNS
        body = render_with_sparklines(rows, histories, look, right=right)
        reported = render_columns(metrics.render_metrics_rows(runs), look)
        return body + (reported and "\n" + reported)

    def _list_idle_notes(self) -> list[str]:
        """How many tasks do not run, and those of which it is not known because their host is silent."""
        running = {name for name, _, _ in _list_running_tasks(self._snapshot)}
        missing = [task for name, task in self._tasks.tasks.items() if name not in running]
        absent = {task.name: resolve_absent_task(task, self._snapshot) for task in missing}
        unseen = {task: known.host for task, known in absent.items() if known.host is not None}
        unknown = [
            f"not known: {describe_unseen_task(task, host)}"
            for task, host in unseen.items()
            if absent[task].lost is None
        ]
        idle = len(missing) - len(unseen)
        count = f"{idle} of {len(self._tasks.tasks)} tasks do not run: edgectl status"
        return [
            *unknown,
            *([count] if idle else []),
            *([] if running or idle else ["no task is seen to run"]),
        ]

    def _find_demand(self, name: str, host: str) -> Amounts:
        return find_task_demand(name, host, self._snapshot, self._inventory, self._tasks)

    def items(self) -> Sequence[Document]:
        """The tasks as JSON types, each with its last samples, oldest first."""
        return [
            encode_run_row(name, host, sample, self._find_demand(name, host), self._snapshot)
            | {"history": list(map(_encode_task_point, self._points.get(name, ())))}
            for name, host, sample in _list_running_tasks(self._snapshot)
        ]

    def warnings(self) -> Sequence[str]:
        """Tasks that do not run, and hosts without a reply."""
        return [*self._list_idle_notes(), *list_snapshot_notes(self._snapshot)]


def _render_top_host_row(
    name: str, sample: HostSample, host: Host | None, value: Snapshot, look: RenderOptions, *, wide: bool
) -> Row:
    first = (Cell(name, "name"), render_host_status(name, sample, value.manager))
    if not sample.ok or not sample.measured:
        return (*first, *["-"] * (len(_HOST_HEAD) - 2 + (len(_WIDE_HOST_HEAD) if wide else 0)))
    limits = host.limits if host else Limits()
    row: Row = (
        *first,
        *(
            render_usage_share(usage, limits[each.name], look)
            if (usage := sample.usage.get(each.name)) is not None
            else Cell("-")
            for each in HOST_RESOURCES
        ),
        _render_busiest_link(sample),
        str(sum(task.state.alive for task in sample.tasks.values())),
    )
    return (*row, *_render_wide_host_cells(sample)) if wide else row


def _render_busiest_link(sample: HostSample) -> Cell:
    """The link with the largest share in use."""
    found = [
        (link.used_bytes_per_s / link.capacity_bytes_per_s, robot)
        for robot, link in sample.links.items()
        if link.capacity_bytes_per_s
    ]
    if not found:
        return Cell("-")
    part, robot = max(found, key=lambda entry: entry[0])
    return Cell(f"{part:.0%} {robot}", "bad" if part > 1 else "")


def _render_wide_host_cells(sample: HostSample) -> Row:
    device = sample.device
    inward = sum(each.rx_bytes_per_s for each in device.interfaces.values())
    outward = sum(each.tx_bytes_per_s for each in device.interfaces.values())
    return (
        *(_format_used_of_capacity(sample, each) for each in HOST_RESOURCES),
        format_rate(inward) if device.interfaces else "-",
        format_rate(outward) if device.interfaces else "-",
        "-" if device.load_1m is None else f"{device.load_1m:.2f}",
        "-" if device.temperature_c is None else f"{device.temperature_c:.0f}C",
    )


def _format_used_of_capacity(sample: HostSample, resource: Resource) -> str:
    usage = sample.usage.get(resource.name)
    if usage is None:
        return "-"
    return f"{resource.unit.format(usage.used)}/{resource.unit.format(usage.capacity)}"


def _list_over_limit_notes(value: Snapshot, inventory: Inventory) -> list[str]:
    """One line for each host that uses more than its limits."""
    lines = []
    for name, sample in value.hosts.items():
        host = inventory.hosts.get(name)
        if host is None or not sample.measured:
            continue
        parts = {name: (usage.share, host.limits[name]) for name, usage in sample.usage.items()}
        lines += [
            f"{name} uses {part:.0%} of its {what}; its limit is {limit:.0%}"
            for what, (part, limit) in parts.items()
            if part > limit
        ]
    return lines


def _get_cpu_share(point: HostPoint) -> float | None:
    return point.usage[CPU.name].share if CPU.name in point.usage else None


def group_points_by_host(points: Iterable[HostPoint]) -> dict[str, list[HostPoint]]:
    """Samples by host, in the order in which they come."""
    found: dict[str, list[HostPoint]] = {}
    for point in points:
        found.setdefault(point.host, []).append(point)
    return found


def group_points_by_task(points: Iterable[TaskPoint]) -> dict[str, list[TaskPoint]]:
    """Samples by task, in the order in which they come."""
    found: dict[str, list[TaskPoint]] = {}
    for point in points:
        found.setdefault(point.task, []).append(point)
    return found


def render_task_rows_of_host(value: Snapshot, inventory: Inventory, tasks: Tasks, *, on: str) -> list[Row]:
    """The tasks that run on one host, with headings and without the host; empty where nothing runs."""
    rows: list[Row] = [
        _render_top_task_row(
            name,
            host,
            sample,
            tasks.tasks.get(name),
            find_task_demand(name, host, value, inventory, tasks),
            value,
            wide=False,
        )
        for name, host, sample in _list_running_tasks(value)
        if host == on
    ]
    return [(row[0], *row[2:]) for row in (_TASK_HEAD, *rows)] if rows else []


def _list_running_tasks(value: Snapshot) -> list[tuple[str, str, TaskSample]]:
    runs = (
        (name, host, sample)
        for host, each in value.hosts.items()
        for name, sample in each.tasks.items()
        if sample.state.alive
    )
    return sorted(runs, key=lambda run: (natural_key(run[0]), natural_key(run[1])))


def _render_top_task_row(
    name: str,
    host: str,
    sample: TaskSample,
    task: Task | None,
    demand: Amounts,
    value: Snapshot,
    *,
    wide: bool,
) -> Row:
    row: Row = (
        Cell(name, "name"),
        host,
        CPU.unit.format(sample.used[CPU.name]),
        *_render_demand_and_excess(CPU, sample, demand),
        *(each.unit.format(sample.used[each.name]) for each in _OTHER_TASK_RESOURCES),
        format_or_dash(compute_task_age(sample, value), format_duration),
        _render_readiness(sample, task),
    )
    if not wide:
        return row
    return (
        *row,
        *(cell for each in _OTHER_TASK_RESOURCES for cell in _render_demand_and_excess(each, sample, demand)),
        *(format_or_dash(demand.get(each.name), each.unit.format) for each in _UNMEASURED_RESOURCES),
        str(sample.restarts),
    )


def _render_demand_and_excess(resource: Resource, sample: TaskSample, demand: Amounts) -> Row:
    demanded, show = demand.get(resource.name), resource.unit.format
    excess = subtract_demand(sample, demand).get(resource.name)
    return format_or_dash(demanded, show), render_difference(excess, demanded, show)


def _render_readiness(sample: TaskSample, task: Task | None) -> Cell:
    """Yes or no where there is a readiness check."""
    if sample.state is TaskState.RUNNING:
        return Cell("no", "warn") if task is not None and task.ready is not None else Cell("-")
    return Cell("yes" if sample.state is TaskState.READY else "no", TASK_STATE_STYLES[sample.state])


def _encode_host_point(point: HostPoint) -> Document:
    return without_none(
        at=format_instant(point.at),
        **{get_flat_used_key(each): point.amounts[each.used_key] for each in HOST_RESOURCES},
    )


def _encode_task_point(point: TaskPoint) -> Document:
    return without_none(
        at=format_instant(point.at),
        host=point.host,
        **{get_flat_used_key(each): point.used[each.name] for each in TASK_RESOURCES},
    )
