"""How much of what: hosts and tasks with their use now and lately, against capacity and demand."""

from collections.abc import Iterable, Sequence

from edgectl.formats.document import FORMAT_VERSION, Document, encode_optional
from edgectl.formats.snapshot import encode_host, encode_task
from edgectl.model.inventory import Host, Inventory, Limits
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.names import natural_key
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import metrics
from edgectl.views.plan_sections import list_unreachable_notes, render_notes
from edgectl.views.state import TASK_STATE_STYLES, render_host_status
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns
from edgectl.views.usage import (
    ResourceAmounts,
    compute_task_demand,
    format_or_dash,
    render_difference,
    render_usage_share,
    render_with_sparklines,
    subtract_demand,
)

_HOST_HEAD: Row = ("NAME", "STATUS", "CPU", "MEMORY", "LINK", "TASKS")
_WIDE_HOST_HEAD: Row = ("CORES", "BYTES", "IN", "OUT", "LOAD", "TEMPERATURE")
_TASK_HEAD: Row = ("TASK", "HOST", "CPU", "DEMAND", "OFF", "MEMORY", "NETWORK", "UP", "READY")
_WIDE_TASK_HEAD: Row = ("MEMORY DEMAND", "OFF", "NETWORK DEMAND", "OFF", "RESTARTS")
_RIGHT_COLUMNS = frozenset(range(2, 8))
_WIDE_RIGHT_COLUMNS = frozenset(range(len(_TASK_HEAD), len(_TASK_HEAD) + len(_WIDE_TASK_HEAD)))


def render_top_hosts(
    value: Snapshot,
    inventory: Inventory,
    points: Iterable[HostPoint],
    look: RenderOptions = PLAIN,
    *,
    wide: bool = False,
) -> str:
    """Use of each host: of its CPU, its memory and its busiest link, with the CPU over the last samples."""
    past = group_points_by_host(points)
    head: Row = (*_HOST_HEAD, *_WIDE_HOST_HEAD) if wide else _HOST_HEAD
    rows = [
        _render_top_host_row(name, sample, inventory.hosts.get(name), value, look, wide=wide)
        for name, sample in value.hosts.items()
    ]
    histories = [
        ([_compute_cpu_share_of_point(point) for point in past.get(name, ())], 1.0) for name in value.hosts
    ]
    return render_with_sparklines([head, *rows], histories, look, right={5}) + render_notes(
        [*_list_over_limit_notes(value, inventory), *list_unreachable_notes(value)], look
    )


def render_wide_top_hosts(
    value: Snapshot, inventory: Inventory, points: Iterable[HostPoint], look: RenderOptions = PLAIN
) -> str:
    """The same in absolute numbers too, with what the device profiler says."""
    return render_top_hosts(value, inventory, points, look, wide=True)


def _render_top_host_row(
    name: str, sample: HostSample, host: Host | None, value: Snapshot, look: RenderOptions, *, wide: bool
) -> Row:
    first = (Cell(name, "name"), render_host_status(name, sample, value.manager))
    if not sample.ok or not sample.measured:
        return (*first, *["-"] * (len(_HOST_HEAD) - 2 + (len(_WIDE_HOST_HEAD) if wide else 0)))
    limits = host.limits if host else Limits()
    row: Row = (
        *first,
        render_usage_share(sample.usage["cpu"], limits["cpu"], look),
        render_usage_share(sample.usage["memory"], limits["memory"], look),
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
    cpu, memory, device = sample.usage.get("cpu"), sample.usage.get("memory"), sample.device
    inward = sum(each.rx_bytes_per_s for each in device.interfaces.values())
    outward = sum(each.tx_bytes_per_s for each in device.interfaces.values())
    return (
        f"{format_cores(cpu.used)}/{format_cores(cpu.capacity)}" if cpu else "-",
        f"{format_bytes(memory.used)}/{format_bytes(memory.capacity)}" if memory else "-",
        format_rate(inward) if device.interfaces else "-",
        format_rate(outward) if device.interfaces else "-",
        "-" if device.load_1m is None else f"{device.load_1m:.2f}",
        "-" if device.temperature_c is None else f"{device.temperature_c:.0f}C",
    )


def _list_over_limit_notes(value: Snapshot, inventory: Inventory) -> list[str]:
    """One line for each host that uses more than its limits allow to plan with."""
    lines = []
    for name, sample in value.hosts.items():
        host = inventory.hosts.get(name)
        if host is None or not sample.measured:
            continue
        parts = {
            name: (usage.used / usage.capacity, host.limits[name]) for name, usage in sample.usage.items()
        }
        lines += [
            f"{name} uses {part:.0%} of its {what}; its limit is {limit:.0%}"
            for what, (part, limit) in parts.items()
            if part > limit
        ]
    return lines


def _compute_cpu_share_of_point(point: HostPoint) -> float | None:
    return point.used_cores / point.cores if point.used_cores is not None and point.cores else None


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


def render_top_tasks(
    value: Snapshot,
    inventory: Inventory,
    wanted: Tasks,
    points: Iterable[TaskPoint],
    look: RenderOptions = PLAIN,
    *,
    wide: bool = False,
) -> str:
    """Use of each task that runs, against its demand, with its CPU over the last samples. Above its demand it is marked.

    Below stands what applications say of themselves.
    """
    past = group_points_by_task(points)
    rows: list[Row] = [(*_TASK_HEAD, *_WIDE_TASK_HEAD) if wide else _TASK_HEAD]
    histories: list[tuple[Sequence[float | None], float]] = []
    for name, host, sample in _list_running_tasks(value):
        demand = find_task_demand(name, host, value, inventory, wanted)
        rows.append(
            _render_top_task_row(name, host, sample, wanted.tasks.get(name), demand, value, wide=wide)
        )
        used = [point.used_cores for point in past.get(name, ())]
        histories.append((used, max([demand.cores or 0.0, *used])))
    if len(rows) == 1:
        return "No task runs.\n" + render_notes(list_unreachable_notes(value), look)
    missing = len(wanted.tasks) - len(
        wanted.tasks.keys() & {name for name, _, _ in _list_running_tasks(value)}
    )
    idle = [f"{missing} of {len(wanted.tasks)} tasks do not run: edgectl status"] if missing else []
    body = render_with_sparklines(
        rows, histories, look, right=_RIGHT_COLUMNS | _WIDE_RIGHT_COLUMNS if wide else _RIGHT_COLUMNS
    )
    said = render_columns(metrics.render_metrics_rows(_list_running_tasks(value)), look, wrap={0, 1})
    return body + (said and "\n" + said) + render_notes([*idle, *list_unreachable_notes(value)], look)


def render_task_rows_of_host(value: Snapshot, inventory: Inventory, wanted: Tasks, *, on: str) -> list[Row]:
    """The rows of the tasks that run on one host, with their head and without the host; none where nothing runs."""
    rows: list[Row] = [
        _render_top_task_row(
            name,
            host,
            sample,
            wanted.tasks.get(name),
            find_task_demand(name, host, value, inventory, wanted),
            value,
            wide=False,
        )
        for name, host, sample in _list_running_tasks(value)
        if host == on
    ]
    return [(row[0], *row[2:]) for row in (_TASK_HEAD, *rows)] if rows else []


def find_task_demand(
    name: str, host: str, value: Snapshot, inventory: Inventory, wanted: Tasks
) -> ResourceAmounts:
    """What counts as the demand of a task on its host; nothing of one that no file names."""
    task = wanted.tasks.get(name)
    return (
        compute_task_demand(task, inventory.hosts.get(host), value.hosts[host], value.manager)
        if task
        else ResourceAmounts()
    )


def render_wide_top_tasks(
    value: Snapshot,
    inventory: Inventory,
    wanted: Tasks,
    points: Iterable[TaskPoint],
    look: RenderOptions = PLAIN,
) -> str:
    """The same with demand and difference of memory and network."""
    return render_top_tasks(value, inventory, wanted, points, look, wide=True)


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
    demand: ResourceAmounts,
    value: Snapshot,
    *,
    wide: bool,
) -> Row:
    difference = subtract_demand(sample, demand)
    row: Row = (
        Cell(name, "name"),
        host,
        format_cores(sample.used["cpu"]),
        format_or_dash(demand.cores, format_cores),
        render_difference(difference.cores, demand.cores, format_cores),
        format_bytes(sample.used["memory"]),
        format_rate(sample.used["network"]),
        format_duration(max(0.0, value.taken_at - sample.started_at)) if sample.started_at else "-",
        _render_readiness(sample, task),
    )
    if not wide:
        return row
    memory = (
        format_or_dash(demand.bytes, format_bytes),
        render_difference(difference.bytes, demand.bytes, format_bytes),
    )
    network = (
        format_or_dash(demand.rate, format_rate),
        render_difference(difference.rate, demand.rate, format_rate),
    )
    return (*row, *memory, *network, str(sample.restarts))


def _render_readiness(sample: TaskSample, task: Task | None) -> Cell:
    """Yes or no where there is a check; else whether it runs is all that is known."""
    if sample.state is TaskState.RUNNING:
        return Cell("no", "warn") if task is not None and task.ready is not None else Cell("-")
    return Cell("yes" if sample.state is TaskState.READY else "no", TASK_STATE_STYLES[sample.state])


def encode_top_hosts(value: Snapshot, _inventory: Inventory, points: Iterable[HostPoint]) -> Document:
    """The hosts as JSON types, each with its last samples, oldest first."""
    past = group_points_by_host(points)
    items = [
        {"name": name, **encode_host(host), "history": list(map(_encode_host_point, past.get(name, ())))}
        for name, host in value.hosts.items()
    ]
    return {"format_version": FORMAT_VERSION, "taken_at": format_instant(value.taken_at), "hosts": items}


def _encode_host_point(point: HostPoint) -> Document:
    return {
        "at": format_instant(point.at),
        "used_cores": encode_optional(point.used_cores),
        "used_bytes": encode_optional(point.used_bytes),
    }


def encode_top_tasks(
    value: Snapshot, inventory: Inventory, wanted: Tasks, points: Iterable[TaskPoint]
) -> Document:
    """The tasks that run as JSON types, each with its demand, how far it is off it (use minus demand) and its last samples."""
    past = group_points_by_task(points)
    items = [
        _encode_top_task(
            name, host, sample, find_task_demand(name, host, value, inventory, wanted), past.get(name, ())
        )
        for name, host, sample in _list_running_tasks(value)
    ]
    return {"format_version": FORMAT_VERSION, "taken_at": format_instant(value.taken_at), "tasks": items}


def _encode_top_task(
    name: str, host: str, sample: TaskSample, demand: ResourceAmounts, points: Iterable[TaskPoint]
) -> Document:
    measured = {"demand": demand.document(), "off": subtract_demand(sample, demand).document()}
    return {
        "name": name,
        "host": host,
        **encode_task(sample),
        **measured,
        "history": list(map(_encode_task_point, points)),
    }


def _encode_task_point(point: TaskPoint) -> Document:
    used = {"used_cores": encode_optional(point.used_cores), "used_bytes": encode_optional(point.used_bytes)}
    return {
        "at": format_instant(point.at),
        "host": point.host,
        **used,
        "used_bytes_per_s": encode_optional(point.used_bytes_per_s),
    }
