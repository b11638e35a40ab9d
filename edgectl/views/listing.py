"""What there is: one item per edge, robot, task or link, with what is stated of it, and what changed from one look to the next.

What is only measured (use, round trips, ages) stands in ``-o wide`` and in JSON, and is no change: ``edgectl top`` shows it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from edgectl.formats.base import FORMAT_VERSION, Document, number, without_none
from edgectl.formats.snapshot import encode_host, encode_link, encode_task
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.snapshot import HostSample, LinkSample, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import metrics
from edgectl.views.absent import absent, silence, standing
from edgectl.views.sections import note_lines, silent
from edgectl.views.state import STATES, host_status, phrase
from edgectl.views.text import PLAIN, Cell, Look, Row, columns, widths_of


class Kind(StrEnum):
    """What can be listed."""

    EDGES = "edges"
    ROBOTS = "robots"
    TASKS = "tasks"
    LINKS = "links"


class Change(StrEnum):
    """How an item differs from the look before."""

    ADDED = "ADDED"
    MODIFIED = "MODIFIED"
    DELETED = "DELETED"


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One thing. ``path`` names it among its kind (a task that runs twice stands there twice), ``name`` as other commands take it.

    ``row`` is its line, ``more`` what ``wide`` adds before the last column, ``told`` what counts as a change.
    """

    path: str
    name: str
    row: Row
    more: Row
    told: tuple[object, ...]
    document: Document
    labels: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """Items of one kind at one instant (s since 1970), and what a person has to know besides."""

    kind: Kind
    at: float
    items: tuple[Item, ...]
    notes: tuple[str, ...] = ()


# The columns of each kind, and those that wide adds before the last one.
_HEADS: Mapping[Kind, tuple[Row, Row]] = {
    Kind.EDGES: (("NAME", "STATUS", "CORES", "MEMORY", "TASKS", "LABELS"), ("ADDRESS", "CPU", "USED")),
    Kind.ROBOTS: (("NAME", "STATUS", "CORES", "MEMORY", "TASKS", "ONBOARD", "LABELS"), ("ADDRESS", "CPU", "USED")),
    Kind.TASKS: (("NAME", "HOST", "STATE", "RESTARTS", "UP"), ("KIND", "ROBOTS", "NEEDS", "PID", "METRICS")),
    Kind.LINKS: (("EDGE", "ROBOT", "CAPACITY", "SOURCE"), ("USED", "RTT")),
}
_NO_LINK = Cell("unknown", "warn")
_WRAPPED = frozenset(range(12))


def listing(kind: Kind, value: Snapshot, inventory: Inventory, tasks: Tasks) -> Listing:
    """Everything of a kind: what the files state, and what the hosts report beyond them."""
    made = {Kind.EDGES: _edges, Kind.ROBOTS: _robots, Kind.TASKS: _tasks, Kind.LINKS: _links}[kind]
    return Listing(kind=kind, at=value.taken_at, items=tuple(made(value, inventory, tasks)), notes=tuple(silent(value)))


def changes(before: Listing | None, after: Listing) -> list[tuple[Change, Item]]:
    """What differs, in the order of ``after``; then what is gone."""
    known = {item.path: item for item in before.items} if before else {}
    found = [(Change.MODIFIED if item.path in known else Change.ADDED, item) for item in after.items]
    left = known.keys() - {item.path for item in after.items}
    return [(change, item) for change, item in found if change is Change.ADDED or known[item.path].told != item.told] + [
        (Change.DELETED, item) for path, item in known.items() if path in left
    ]


def _edges(value: Snapshot, inventory: Inventory, _tasks: Tasks) -> Iterator[Item]:
    return (_host(host, value, ()) for host in inventory.edges)


def _robots(value: Snapshot, inventory: Inventory, _tasks: Tasks) -> Iterator[Item]:
    return (_host(host, value, ("yes" if host.onboard else "no",)) for host in inventory.robots)


def _host(host: Host, value: Snapshot, extra: Row) -> Item:
    sample = value.hosts.get(host.name)
    status, alive = host_status(host.name, sample, value.memory), _alive(sample)
    cpu, memory = (sample.cpu, sample.memory) if sample and sample.ok else (None, None)
    said = (format_cores(cpu.cores) if cpu else "-", format_bytes(memory.total_bytes) if memory else "-", str(alive) if cpu else "-")
    labels = ",".join(f"{key}={text}" for key, text in host.labels.items()) or "-"
    return Item(
        path=host.name,
        name=f"{host.role}/{host.name}",
        row=(Cell(host.name, "name"), status, *said, *extra, labels),
        more=(
            f"{host.connection} {host.host}",
            f"{cpu.used_cores / cpu.cores:.0%}" if cpu else "-",
            f"{memory.used_bytes / memory.total_bytes:.0%}" if memory else "-",
        ),
        told=(status.text, *said, *extra, labels),
        document=host_document(host, value),
        labels=host.labels,
    )


def _alive(sample: HostSample | None) -> int:
    return sum(task.state.alive for task in sample.tasks.values()) if sample else 0


def host_document(host: Host, value: Snapshot) -> Document:
    """What is known of one host, as JSON types: what the inventory states (no environment), then its part of the snapshot."""
    stated = without_none(
        kind=host.role.value,
        name=host.name,
        address=host.host,
        connection=host.connection.value,
        labels=dict(host.labels),
        limits={"cpu": number(host.limits.cpu), "memory": number(host.limits.memory)},
        onboard=host.onboard if host.role is Role.ROBOT else None,
        closed=standing(host.name, value.memory) or None,
    )
    return stated | (encode_host(value.hosts[host.name]) if host.name in value.hosts else {"status": "not probed"})


def _tasks(value: Snapshot, _inventory: Inventory, tasks: Tasks) -> Iterator[Item]:
    runs = [(name, host, sample) for host, each in value.hosts.items() for name, sample in each.tasks.items()]
    seen = {name for name, _, _ in runs}
    order = {name: place for place, name in enumerate([*tasks.tasks, *sorted(seen - tasks.tasks.keys())])}
    items = [_run(name, host, sample, tasks.tasks.get(name), value) for name, host, sample in runs]
    items += [_missing(task, value) for task in tasks.tasks.values() if task.name not in seen]
    yield from sorted(items, key=lambda item: (order[str(item.document["name"])], item.path))


def _run(name: str, host: str, sample: TaskSample, task: Task | None, value: Snapshot) -> Item:
    state, restarts = Cell(phrase(sample), STATES[sample.state]), str(sample.restarts)
    up = format_duration(max(0.0, value.taken_at - sample.started_at)) if sample.started_at and sample.state.alive else "-"
    return Item(
        path=f"{name} on {host}",
        name=f"task/{name}",
        row=(Cell(name, "name"), host, state, restarts, up),
        more=(*_spec(task), str(sample.pid or "-"), metrics.line(sample.metrics)),
        told=(host, state.text, restarts, sample.instance, *_spec(task)),
        document={"kind": "task", "name": name, "host": host} | encode_task(sample),
        labels=_labels(task),
    )


def _missing(task: Task, value: Snapshot) -> Item:
    known = absent(task, value)
    state = Cell(known.state + silence(known.contact, value.taken_at), "warn" if known.host else "dim")
    contact = None if known.contact is None else format_instant(known.contact)
    stated = without_none(kind="task", name=task.name, state=known.state, last_host=known.host, last_contact=contact)
    return Item(
        path=f"{task.name} on -",
        name=f"task/{task.name}",
        row=(Cell(task.name, "name"), known.host or "-", state, "-", "-"),
        more=(*_spec(task), "-", "-"),
        told=(known.host, known.state, *_spec(task)),
        document=stated,
        labels=_labels(task),
    )


def _spec(task: Task | None) -> tuple[str, str, str]:
    if task is None:
        return ("not in the files", "-", "-")
    kind = task.kind.value if task.managed else "not managed"
    return (kind, ",".join(task.robots) or "-", ",".join(need.task for need in task.needs) or "-")


def _labels(task: Task | None) -> Mapping[str, str]:
    return {} if task is None else {**task.labels, "task": task.template}


def _links(value: Snapshot, inventory: Inventory, _tasks: Tasks) -> Iterator[Item]:
    for edge in inventory.edges:
        sample = value.hosts.get(edge.name)
        for robot in inventory.robots:
            yield _link(edge.name, robot.name, sample.links.get(robot.name) if sample else None)


def _link(edge: str, robot: str, link: LinkSample | None) -> Item:
    path = f"{edge}/{robot}"
    capacity = format_rate(link.capacity_bytes_per_s) if link else "-"
    source = Cell(link.capacity_source.value, "warn" if link.capacity_source == "assumed" else "") if link else _NO_LINK
    rtt = f"{link.rtt_ms:.1f}ms" if link and link.rtt_ms is not None else "-"
    return Item(
        path=path,
        name=f"link/{path}",
        row=(Cell(edge, "name"), Cell(robot, "name"), capacity, source),
        more=(format_rate(link.used_bytes_per_s) if link else "-", rtt),
        told=(capacity, source.text),
        document={"kind": "link", "name": path, "edge": edge, "robot": robot} | (encode_link(link) if link else {}),
        labels={},
    )


def text(value: Listing, look: Look = PLAIN) -> str:
    """A line per item below a head, then the hosts that do not answer."""
    return _table(value, look, wide=False)


def wide_text(value: Listing, look: Look = PLAIN) -> str:
    """The same with what is measured, and more of what is stated."""
    return _table(value, look, wide=True)


def _table(value: Listing, look: Look, *, wide: bool) -> str:
    table = columns(_rows(value, wide=wide), look, wrap=_WRAPPED) if value.items else f"No {value.kind}.\n"
    return table + note_lines(value.notes, look)


def more_text(value: Listing, changed: Iterable[tuple[Change, Item]], first: Listing | None, look: Look = PLAIN) -> str:
    """The lines of what changed, below those of the ``first`` look as far as its widths go; all of them where this is the first."""
    return text(value, look) if first is None else _lines(changed, first, look, wide=False)


def wide_more(value: Listing, changed: Iterable[tuple[Change, Item]], first: Listing | None, look: Look = PLAIN) -> str:
    """The same, wide."""
    return wide_text(value, look) if first is None else _lines(changed, first, look, wide=True)


def _lines(changed: Iterable[tuple[Change, Item]], first: Listing, look: Look, *, wide: bool) -> str:
    rows = [_gone(item, wide=wide) if change is Change.DELETED else _line(item, wide=wide) for change, item in changed]
    return columns(rows, look, wrap=_WRAPPED, least=widths_of(_rows(first, wide=wide)))


def _rows(value: Listing, *, wide: bool) -> list[Row]:
    return [_head(value.kind, wide=wide), *(_line(item, wide=wide) for item in value.items)]


def _head(kind: Kind, *, wide: bool) -> Row:
    head, more = _HEADS[kind]
    return (*head[:-1], *more, head[-1]) if wide else head


def _line(item: Item, *, wide: bool) -> Row:
    return (*item.row[:-1], *item.more, item.row[-1]) if wide else item.row


def _gone(item: Item, *, wide: bool) -> Row:
    """Only tasks that no file names can go."""
    name, host, _, *rest = _line(item, wide=wide)
    return (name, host, Cell("gone", "bad"), *rest)


def document(value: Listing) -> Document:
    """All items, as JSON types."""
    return {"format_version": FORMAT_VERSION, "taken_at": format_instant(value.at), "items": [item.document for item in value.items]}


def line(at: float, change: Change, item: Item) -> Document:
    """One change at ``at`` (s since 1970), as JSON types."""
    return {"type": change.value, "at": format_instant(at), "object": item.document}
