"""What there is: one item per edge, robot, task or link, with what is stated of it, and what changed from one look to the next.

What is only measured (use, round trips, ages) stands in ``-o wide`` and in JSON, and is no change: ``edgectl top`` shows it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from edgectl.formats.document import FORMAT_VERSION, Document, encode_number, without_none
from edgectl.formats.snapshot import encode_host, encode_link, encode_task
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.snapshot import HostSample, LinkSample, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import metrics
from edgectl.views.plan_sections import list_unreachable_notes, render_notes
from edgectl.views.state import (
    TASK_STATE_STYLES,
    format_operator_mark,
    format_silence,
    format_task_state,
    render_host_status,
    resolve_absent_task,
)
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, measure_column_widths, render_columns


class ListingKind(StrEnum):
    """What can be listed."""

    EDGES = "edges"
    ROBOTS = "robots"
    TASKS = "tasks"
    LINKS = "links"


class ItemChange(StrEnum):
    """How an item differs from the look before."""

    ADDED = "ADDED"
    MODIFIED = "MODIFIED"
    DELETED = "DELETED"


@dataclass(frozen=True, slots=True, kw_only=True)
class ListingItem:
    """One thing. ``path`` names it among its kind (a task that runs twice stands there twice), ``name`` as other commands take it.

    ``row`` is its line, ``more`` what ``wide`` adds before the last column, ``told`` what counts as a change.
    """

    path: str
    name: str
    row: Row
    wide_cells: Row
    told: tuple[object, ...]
    document: Document
    labels: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """Items of one kind at one instant (s since 1970), and what a person has to know besides."""

    kind: ListingKind
    at: float
    items: tuple[ListingItem, ...]
    notes: tuple[str, ...] = ()


# The columns of each kind, and those that wide adds before the last one.
_COLUMN_HEADS: Mapping[ListingKind, tuple[Row, Row]] = {
    ListingKind.EDGES: (("NAME", "STATUS", "CORES", "MEMORY", "TASKS", "LABELS"), ("ADDRESS", "CPU", "USED")),
    ListingKind.ROBOTS: (
        ("NAME", "STATUS", "CORES", "MEMORY", "TASKS", "ONBOARD", "LABELS"),
        ("ADDRESS", "CPU", "USED"),
    ),
    ListingKind.TASKS: (
        ("NAME", "HOST", "STATE", "RESTARTS", "UP"),
        ("KIND", "ROBOTS", "NEEDS", "PID", "METRICS"),
    ),
    ListingKind.LINKS: (("EDGE", "ROBOT", "CAPACITY", "SOURCE"), ("USED", "RTT")),
}
_UNKNOWN_SOURCE = Cell("unknown", "warn")
_WRAPPED_COLUMNS = frozenset(range(12))


def build_listing(kind: ListingKind, value: Snapshot, inventory: Inventory, tasks: Tasks) -> Listing:
    """Everything of a kind: what the files state, and what the hosts report beyond them."""
    made = {
        ListingKind.EDGES: _build_edge_items,
        ListingKind.ROBOTS: _build_robot_items,
        ListingKind.TASKS: _build_task_items,
        ListingKind.LINKS: _build_link_items,
    }[kind]
    return Listing(
        kind=kind,
        at=value.taken_at,
        items=tuple(made(value, inventory, tasks)),
        notes=tuple(list_unreachable_notes(value)),
    )


def compare_listings(before: Listing | None, after: Listing) -> list[tuple[ItemChange, ListingItem]]:
    """What differs, in the order of ``after``; then what is gone."""
    known = {item.path: item for item in before.items} if before else {}
    found = [(ItemChange.MODIFIED if item.path in known else ItemChange.ADDED, item) for item in after.items]
    left = known.keys() - {item.path for item in after.items}
    return [
        (change, item)
        for change, item in found
        if change is ItemChange.ADDED or known[item.path].told != item.told
    ] + [(ItemChange.DELETED, item) for path, item in known.items() if path in left]


def _build_edge_items(value: Snapshot, inventory: Inventory, _tasks: Tasks) -> Iterator[ListingItem]:
    return (_build_host_item(host, value, ()) for host in inventory.edges)


def _build_robot_items(value: Snapshot, inventory: Inventory, _tasks: Tasks) -> Iterator[ListingItem]:
    return (_build_host_item(host, value, ("yes" if host.onboard else "no",)) for host in inventory.robots)


def _build_host_item(host: Host, value: Snapshot, extra: Row) -> ListingItem:
    sample = value.hosts.get(host.name)
    status, alive = render_host_status(host.name, sample, value.manager), _count_alive_tasks(sample)
    usage = sample.usage if sample and sample.ok else {}
    cpu, memory = usage.get("cpu"), usage.get("memory")
    said = (
        format_cores(cpu.capacity) if cpu else "-",
        format_bytes(memory.capacity) if memory else "-",
        str(alive) if cpu else "-",
    )
    labels = ",".join(f"{key}={text}" for key, text in host.labels.items()) or "-"
    return ListingItem(
        path=host.name,
        name=f"{host.role}/{host.name}",
        row=(Cell(host.name, "name"), status, *said, *extra, labels),
        wide_cells=(
            f"{host.connection} {host.host}",
            f"{cpu.used / cpu.capacity:.0%}" if cpu else "-",
            f"{memory.used / memory.capacity:.0%}" if memory else "-",
        ),
        told=(status.text, *said, *extra, labels),
        document=encode_listed_host(host, value),
        labels=host.labels,
    )


def _count_alive_tasks(sample: HostSample | None) -> int:
    return sum(task.state.alive for task in sample.tasks.values()) if sample else 0


def encode_listed_host(host: Host, value: Snapshot) -> Document:
    """What is known of one host, as JSON types: what the inventory states (no environment), then its part of the snapshot."""
    stated = without_none(
        kind=host.role.value,
        name=host.name,
        address=host.host,
        connection=host.connection.value,
        labels=dict(host.labels),
        limits={name: encode_number(share) for name, share in host.limits.items()},
        onboard=host.onboard if host.role is Role.ROBOT else None,
        closed=format_operator_mark(host.name, value.manager) or None,
    )
    return stated | (
        encode_host(value.hosts[host.name]) if host.name in value.hosts else {"status": "not probed"}
    )


def _build_task_items(value: Snapshot, _inventory: Inventory, tasks: Tasks) -> Iterator[ListingItem]:
    runs = [(name, host, sample) for host, each in value.hosts.items() for name, sample in each.tasks.items()]
    seen = {name for name, _, _ in runs}
    order = {name: place for place, name in enumerate([*tasks.tasks, *sorted(seen - tasks.tasks.keys())])}
    items = [
        _build_running_task_item(name, host, sample, tasks.tasks.get(name), value)
        for name, host, sample in runs
    ]
    items += [_build_absent_task_item(task, value) for task in tasks.tasks.values() if task.name not in seen]
    yield from sorted(items, key=lambda item: (order[str(item.document["name"])], item.path))


def _build_running_task_item(
    name: str, host: str, sample: TaskSample, task: Task | None, value: Snapshot
) -> ListingItem:
    state, restarts = Cell(format_task_state(sample), TASK_STATE_STYLES[sample.state]), str(sample.restarts)
    up = (
        format_duration(max(0.0, value.taken_at - sample.started_at))
        if sample.started_at and sample.state.alive
        else "-"
    )
    return ListingItem(
        path=f"{name} on {host}",
        name=f"task/{name}",
        row=(Cell(name, "name"), host, state, restarts, up),
        wide_cells=(
            *_format_spec_columns(task),
            str(sample.pid or "-"),
            metrics.format_metrics(sample.metrics),
        ),
        told=(host, state.text, restarts, sample.instance, *_format_spec_columns(task)),
        document={"kind": "task", "name": name, "host": host} | encode_task(sample),
        labels=_collect_task_labels(task),
    )


def _build_absent_task_item(task: Task, value: Snapshot) -> ListingItem:
    known = resolve_absent_task(task, value)
    state = Cell(known.state + format_silence(known.contact, value.taken_at), "warn" if known.host else "dim")
    contact = None if known.contact is None else format_instant(known.contact)
    stated = without_none(
        kind="task", name=task.name, state=known.state, last_host=known.host, last_contact=contact
    )
    return ListingItem(
        path=f"{task.name} on -",
        name=f"task/{task.name}",
        row=(Cell(task.name, "name"), known.host or "-", state, "-", "-"),
        wide_cells=(*_format_spec_columns(task), "-", "-"),
        told=(known.host, known.state, *_format_spec_columns(task)),
        document=stated,
        labels=_collect_task_labels(task),
    )


def _format_spec_columns(task: Task | None) -> tuple[str, str, str]:
    if task is None:
        return ("not in the files", "-", "-")
    kind = task.kind.value if task.managed else "not managed"
    return (kind, ",".join(task.robots) or "-", ",".join(need.task for need in task.needs) or "-")


def _collect_task_labels(task: Task | None) -> Mapping[str, str]:
    return {} if task is None else {**task.labels, "task": task.template}


def _build_link_items(value: Snapshot, inventory: Inventory, _tasks: Tasks) -> Iterator[ListingItem]:
    for edge in inventory.edges:
        sample = value.hosts.get(edge.name)
        for robot in inventory.robots:
            yield _build_link_item(edge.name, robot.name, sample.links.get(robot.name) if sample else None)


def _build_link_item(edge: str, robot: str, link: LinkSample | None) -> ListingItem:
    path = f"{edge}/{robot}"
    capacity = format_rate(link.capacity_bytes_per_s) if link else "-"
    source = (
        Cell(link.capacity_source.value, "warn" if link.capacity_source == "assumed" else "")
        if link
        else _UNKNOWN_SOURCE
    )
    rtt = f"{link.rtt_ms:.1f}ms" if link and link.rtt_ms is not None else "-"
    return ListingItem(
        path=path,
        name=f"link/{path}",
        row=(Cell(edge, "name"), Cell(robot, "name"), capacity, source),
        wide_cells=(format_rate(link.used_bytes_per_s) if link else "-", rtt),
        told=(capacity, source.text),
        document={"kind": "link", "name": path, "edge": edge, "robot": robot}
        | (encode_link(link) if link else {}),
        labels={},
    )


def render_listing(value: Listing, look: RenderOptions = PLAIN) -> str:
    """A line per item below a head, then the hosts that do not answer."""
    return _render_listing_table(value, look, wide=False)


def render_wide_listing(value: Listing, look: RenderOptions = PLAIN) -> str:
    """The same with what is measured, and more of what is stated."""
    return _render_listing_table(value, look, wide=True)


def _render_listing_table(value: Listing, look: RenderOptions, *, wide: bool) -> str:
    table = (
        render_columns(_build_listing_rows(value, wide=wide), look, wrap=_WRAPPED_COLUMNS)
        if value.items
        else f"No {value.kind}.\n"
    )
    return table + render_notes(value.notes, look)


def render_listing_changes(
    value: Listing,
    changed: Iterable[tuple[ItemChange, ListingItem]],
    first: Listing | None,
    look: RenderOptions = PLAIN,
) -> str:
    """The lines of what changed, below those of the ``first`` look as far as its widths go; all of them where this is the first."""
    return (
        render_listing(value, look)
        if first is None
        else _render_changed_items(changed, first, look, wide=False)
    )


def render_wide_listing_changes(
    value: Listing,
    changed: Iterable[tuple[ItemChange, ListingItem]],
    first: Listing | None,
    look: RenderOptions = PLAIN,
) -> str:
    """The same, wide."""
    return (
        render_wide_listing(value, look)
        if first is None
        else _render_changed_items(changed, first, look, wide=True)
    )


def _render_changed_items(
    changed: Iterable[tuple[ItemChange, ListingItem]], first: Listing, look: RenderOptions, *, wide: bool
) -> str:
    rows = [
        _build_deleted_item_row(item, wide=wide)
        if change is ItemChange.DELETED
        else _build_item_row(item, wide=wide)
        for change, item in changed
    ]
    return render_columns(
        rows, look, wrap=_WRAPPED_COLUMNS, least=measure_column_widths(_build_listing_rows(first, wide=wide))
    )


def _build_listing_rows(value: Listing, *, wide: bool) -> list[Row]:
    return [
        _build_head_row(value.kind, wide=wide),
        *(_build_item_row(item, wide=wide) for item in value.items),
    ]


def _build_head_row(kind: ListingKind, *, wide: bool) -> Row:
    head, more = _COLUMN_HEADS[kind]
    return (*head[:-1], *more, head[-1]) if wide else head


def _build_item_row(item: ListingItem, *, wide: bool) -> Row:
    return (*item.row[:-1], *item.wide_cells, item.row[-1]) if wide else item.row


def _build_deleted_item_row(item: ListingItem, *, wide: bool) -> Row:
    """Only tasks that no file names can go."""
    name, host, _, *rest = _build_item_row(item, wide=wide)
    return (name, host, Cell("gone", "bad"), *rest)


def encode_listing(value: Listing) -> Document:
    """All items, as JSON types."""
    return {
        "format_version": FORMAT_VERSION,
        "taken_at": format_instant(value.at),
        "items": [item.document for item in value.items],
    }


def encode_item_change(at: float, change: ItemChange, item: ListingItem) -> Document:
    """One change at ``at`` (s since 1970), as JSON types."""
    return {"type": change.value, "at": format_instant(at), "object": item.document}
