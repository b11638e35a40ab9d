"""How much of what: hosts and tasks with their use now and lately, against capacity and demand."""

from collections.abc import Iterable, Sequence

from edgectl.formats.base import FORMAT_VERSION, Document, optional
from edgectl.formats.snapshot import encode_host, encode_task
from edgectl.model.inventory import Host, Inventory
from edgectl.model.order import natural_key
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import metrics
from edgectl.views.sections import note_lines, silent
from edgectl.views.state import STATES, host_status
from edgectl.views.text import PLAIN, Cell, Look, Row, columns
from edgectl.views.use import Amounts, apart, demanded, off, share, shown, with_history

_HOSTS: Row = ("NAME", "STATUS", "CPU", "MEMORY", "LINK", "TASKS")
_HOSTS_MORE: Row = ("CORES", "BYTES", "IN", "OUT", "LOAD", "TEMPERATURE")
_TASKS: Row = ("TASK", "HOST", "CPU", "DEMAND", "OFF", "MEMORY", "NETWORK", "UP", "READY")
_TASKS_MORE: Row = ("MEMORY DEMAND", "OFF", "NETWORK DEMAND", "OFF", "RESTARTS")
_RIGHT = frozenset(range(2, 8))
_RIGHT_MORE = frozenset(range(len(_TASKS), len(_TASKS) + len(_TASKS_MORE)))


def hosts(value: Snapshot, inventory: Inventory, points: Iterable[HostPoint], look: Look = PLAIN, *, wide: bool = False) -> str:
    """Use of each host: of its CPU, its memory and its busiest link, with the CPU over the last samples."""
    past = by_host(points)
    head: Row = (*_HOSTS, *_HOSTS_MORE) if wide else _HOSTS
    rows = [_host(name, sample, inventory.hosts.get(name), value, look, wide=wide) for name, sample in value.hosts.items()]
    histories = [([_load(point) for point in past.get(name, ())], 1.0) for name in value.hosts]
    return with_history([head, *rows], histories, look, right={5}) + note_lines([*_hot(value, inventory), *silent(value)], look)


def wide_hosts(value: Snapshot, inventory: Inventory, points: Iterable[HostPoint], look: Look = PLAIN) -> str:
    """The same in absolute numbers too, with what the device profiler says."""
    return hosts(value, inventory, points, look, wide=True)


def _host(name: str, sample: HostSample, host: Host | None, value: Snapshot, look: Look, *, wide: bool) -> Row:
    first = (Cell(name, "name"), host_status(name, sample, value.memory))
    if not sample.ok or sample.cpu is None or sample.memory is None:
        return (*first, *["-"] * (len(_HOSTS) - 2 + (len(_HOSTS_MORE) if wide else 0)))
    cpu, memory = sample.cpu, sample.memory
    row: Row = (
        *first,
        share(cpu.used_cores, cpu.cores, host.limits.cpu if host else 1.0, look),
        share(memory.used_bytes, memory.total_bytes, host.limits.memory if host else 1.0, look),
        _busiest(sample),
        str(sum(task.state.alive for task in sample.tasks.values())),
    )
    return (*row, *_host_more(sample)) if wide else row


def _busiest(sample: HostSample) -> Cell:
    """The link with the largest share in use."""
    found = [
        (link.used_bytes_per_s / link.capacity_bytes_per_s, robot) for robot, link in sample.links.items() if link.capacity_bytes_per_s
    ]
    if not found:
        return Cell("-")
    part, robot = max(found, key=lambda entry: entry[0])
    return Cell(f"{part:.0%} {robot}", "bad" if part > 1 else "")


def _host_more(sample: HostSample) -> Row:
    cpu, memory, device = sample.cpu, sample.memory, sample.device
    inward = sum(each.rx_bytes_per_s for each in device.interfaces.values())
    outward = sum(each.tx_bytes_per_s for each in device.interfaces.values())
    return (
        f"{format_cores(cpu.used_cores)}/{format_cores(cpu.cores)}" if cpu else "-",
        f"{format_bytes(memory.used_bytes)}/{format_bytes(memory.total_bytes)}" if memory else "-",
        format_rate(inward) if device.interfaces else "-",
        format_rate(outward) if device.interfaces else "-",
        "-" if device.load_1m is None else f"{device.load_1m:.2f}",
        "-" if device.temperature_c is None else f"{device.temperature_c:.0f}C",
    )


def _hot(value: Snapshot, inventory: Inventory) -> list[str]:
    """One line for each host that uses more than its limits allow to plan with."""
    lines = []
    for name, sample in value.hosts.items():
        host = inventory.hosts.get(name)
        if host is None or sample.cpu is None or sample.memory is None:
            continue
        parts = {
            "cpu": (sample.cpu.used_cores / sample.cpu.cores, host.limits.cpu),
            "memory": (sample.memory.used_bytes / sample.memory.total_bytes, host.limits.memory),
        }
        lines += [
            f"{name} uses {part:.0%} of its {what}; its limit is {limit:.0%}" for what, (part, limit) in parts.items() if part > limit
        ]
    return lines


def _load(point: HostPoint) -> float | None:
    return point.used_cores / point.cores if point.used_cores is not None and point.cores else None


def by_host(points: Iterable[HostPoint]) -> dict[str, list[HostPoint]]:
    """Samples by host, in the order in which they come."""
    found: dict[str, list[HostPoint]] = {}
    for point in points:
        found.setdefault(point.host, []).append(point)
    return found


def by_task(points: Iterable[TaskPoint]) -> dict[str, list[TaskPoint]]:
    """Samples by task, in the order in which they come."""
    found: dict[str, list[TaskPoint]] = {}
    for point in points:
        found.setdefault(point.task, []).append(point)
    return found


def tasks(
    value: Snapshot, inventory: Inventory, wanted: Tasks, points: Iterable[TaskPoint], look: Look = PLAIN, *, wide: bool = False
) -> str:
    """Use of each task that runs, against its demand, with its CPU over the last samples. Above its demand it is marked.

    Below stands what applications say of themselves.
    """
    past = by_task(points)
    rows: list[Row] = [(*_TASKS, *_TASKS_MORE) if wide else _TASKS]
    histories: list[tuple[Sequence[float | None], float]] = []
    for name, host, sample in _running(value):
        demand = demand_of(name, host, value, inventory, wanted)
        rows.append(_task(name, host, sample, wanted.tasks.get(name), demand, value, wide=wide))
        used = [point.used_cores for point in past.get(name, ())]
        histories.append((used, max([demand.cores or 0.0, *used])))
    if len(rows) == 1:
        return "No task runs.\n" + note_lines(silent(value), look)
    missing = len(wanted.tasks) - len(wanted.tasks.keys() & {name for name, _, _ in _running(value)})
    idle = [f"{missing} of {len(wanted.tasks)} tasks do not run: edgectl status"] if missing else []
    body = with_history(rows, histories, look, right=_RIGHT | _RIGHT_MORE if wide else _RIGHT)
    said = columns(metrics.table(_running(value)), look, wrap={0, 1})
    return body + (said and "\n" + said) + note_lines([*idle, *silent(value)], look)


def compared(value: Snapshot, inventory: Inventory, wanted: Tasks, *, on: str) -> list[Row]:
    """The rows of the tasks that run on one host, with their head and without the host; none where nothing runs."""
    rows: list[Row] = [
        _task(name, host, sample, wanted.tasks.get(name), demand_of(name, host, value, inventory, wanted), value, wide=False)
        for name, host, sample in _running(value)
        if host == on
    ]
    return [(row[0], *row[2:]) for row in (_TASKS, *rows)] if rows else []


def demand_of(name: str, host: str, value: Snapshot, inventory: Inventory, wanted: Tasks) -> Amounts:
    """What counts as the demand of a task on its host; nothing of one that no file names."""
    task = wanted.tasks.get(name)
    return demanded(task, inventory.hosts.get(host), value.hosts[host], value.memory) if task else Amounts()


def wide_tasks(value: Snapshot, inventory: Inventory, wanted: Tasks, points: Iterable[TaskPoint], look: Look = PLAIN) -> str:
    """The same with demand and difference of memory and network."""
    return tasks(value, inventory, wanted, points, look, wide=True)


def _running(value: Snapshot) -> list[tuple[str, str, TaskSample]]:
    runs = ((name, host, sample) for host, each in value.hosts.items() for name, sample in each.tasks.items() if sample.state.alive)
    return sorted(runs, key=lambda run: (natural_key(run[0]), natural_key(run[1])))


def _task(name: str, host: str, sample: TaskSample, task: Task | None, demand: Amounts, value: Snapshot, *, wide: bool) -> Row:
    difference = off(sample, demand)
    row: Row = (
        Cell(name, "name"),
        host,
        format_cores(sample.used_cores),
        shown(demand.cores, format_cores),
        apart(difference.cores, demand.cores, format_cores),
        format_bytes(sample.used_bytes),
        format_rate(sample.used_bytes_per_s),
        format_duration(max(0.0, value.taken_at - sample.started_at)) if sample.started_at else "-",
        _ready(sample, task),
    )
    if not wide:
        return row
    memory = (shown(demand.bytes, format_bytes), apart(difference.bytes, demand.bytes, format_bytes))
    network = (shown(demand.rate, format_rate), apart(difference.rate, demand.rate, format_rate))
    return (*row, *memory, *network, str(sample.restarts))


def _ready(sample: TaskSample, task: Task | None) -> Cell:
    """Yes or no where there is a check; else whether it runs is all that is known."""
    if sample.state is TaskState.RUNNING:
        return Cell("no", "warn") if task is not None and task.ready is not None else Cell("-")
    return Cell("yes" if sample.state is TaskState.READY else "no", STATES[sample.state])


def hosts_document(value: Snapshot, _inventory: Inventory, points: Iterable[HostPoint]) -> Document:
    """The hosts as JSON types, each with its last samples, oldest first."""
    past = by_host(points)
    items = [
        {"name": name, **encode_host(host), "history": list(map(_host_point, past.get(name, ())))} for name, host in value.hosts.items()
    ]
    return {"format_version": FORMAT_VERSION, "taken_at": format_instant(value.taken_at), "hosts": items}


def _host_point(point: HostPoint) -> Document:
    return {"at": format_instant(point.at), "used_cores": optional(point.used_cores), "used_bytes": optional(point.used_bytes)}


def tasks_document(value: Snapshot, inventory: Inventory, wanted: Tasks, points: Iterable[TaskPoint]) -> Document:
    """The tasks that run as JSON types, each with its demand, how far it is off it (use minus demand) and its last samples."""
    past = by_task(points)
    items = [
        _task_document(name, host, sample, demand_of(name, host, value, inventory, wanted), past.get(name, ()))
        for name, host, sample in _running(value)
    ]
    return {"format_version": FORMAT_VERSION, "taken_at": format_instant(value.taken_at), "tasks": items}


def _task_document(name: str, host: str, sample: TaskSample, demand: Amounts, points: Iterable[TaskPoint]) -> Document:
    measured = {"demand": demand.document(), "off": off(sample, demand).document()}
    return {"name": name, "host": host, **encode_task(sample), **measured, "history": list(map(_task_point, points))}


def _task_point(point: TaskPoint) -> Document:
    used = {"used_cores": optional(point.used_cores), "used_bytes": optional(point.used_bytes)}
    return {"at": format_instant(point.at), "host": point.host, **used, "used_bytes_per_s": optional(point.used_bytes_per_s)}
