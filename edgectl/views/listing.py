"""Listings of edges, robots, tasks and links, and the changes from one probe to the next.

Measurements (usage, round trips, ages) stand in ``-o wide`` and in the documents, and are no change:
``edgectl top`` shows them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from edgectl.formats.document import Document
from edgectl.model.inventory import Host, Inventory
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.snapshot import HostSample, LinkSample, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.units import format_duration, format_instant, format_rate
from edgectl.views import metrics
from edgectl.views.glossary import head
from edgectl.views.other_tasks import list_foreign_notes
from edgectl.views.output import ListView, round_item
from edgectl.views.output_format import FLEET_FORMATS
from edgectl.views.plan_sections import list_snapshot_notes
from edgectl.views.rows import (
    compute_task_age,
    encode_absent_row,
    encode_host_row,
    encode_link_sample,
    encode_run_row,
    find_task_demand,
)
from edgectl.views.state import (
    TASK_STATE_STYLES,
    format_silence,
    format_task_state,
    render_host_status,
    resolve_absent_task,
)
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, measure_column_widths, render_columns


class ListingKind(StrEnum):
    """The kinds that can be listed."""

    EDGES = "edges"
    ROBOTS = "robots"
    TASKS = "tasks"
    LINKS = "links"


class ItemChange(StrEnum):
    """The difference of an item from the probe before."""

    ADDED = "ADDED"
    MODIFIED = "MODIFIED"
    DELETED = "DELETED"


@dataclass(frozen=True, slots=True, kw_only=True)
class ListingItem:
    """One thing. ``path`` is unique among its kind (a task that runs twice is listed twice).

    ``aliases``: the words that select it on the command line. ``row`` is its line, ``wide_cells`` what
    ``wide`` adds before the last column, ``told`` what counts as a change.
    """

    path: str
    name: str
    aliases: tuple[str, ...]
    row: Row
    wide_cells: Row
    told: tuple[object, ...]
    document: Document
    labels: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """Items of one kind at one instant (s since 1970), with notes on the whole."""

    kind: ListingKind
    at: float
    items: tuple[ListingItem, ...]
    notes: tuple[str, ...] = ()


Change = tuple[ItemChange, ListingItem]

# Of each kind: the columns, those that wide adds before the last one, and the headings of numbers.
_CAPACITY_COLUMNS = tuple(f"{resource.name}.capacity_{resource.unit.name}" for resource in HOST_RESOURCES)
_SHARE_COLUMNS = tuple(f"{resource.name}.share" for resource in HOST_RESOURCES)
_HOST_COLUMNS = ("host", "status", *_CAPACITY_COLUMNS, "task_count")
_WIDE_HOST_COLUMNS = ("address", *_SHARE_COLUMNS)
_COLUMNS: Mapping[ListingKind, tuple[tuple[str, ...], tuple[str, ...]]] = {
    ListingKind.EDGES: ((*_HOST_COLUMNS, "labels"), _WIDE_HOST_COLUMNS),
    ListingKind.ROBOTS: ((*_HOST_COLUMNS, "onboard", "labels"), _WIDE_HOST_COLUMNS),
    ListingKind.TASKS: (
        ("task", "host", "state", "restarts", "age_s"),
        ("kind", "robots", "needs", "pid", "metrics"),
    ),
    ListingKind.LINKS: (
        ("edge", "robot", "capacity_bytes_per_s", "capacity_source"),
        ("network.used_bytes_per_s", "rtt_ms"),
    ),
}
_NUMBERS = {
    *_CAPACITY_COLUMNS, *_SHARE_COLUMNS, "task_count", "restarts",
    "age_s", "pid", "capacity_bytes_per_s", "network.used_bytes_per_s", "rtt_ms",
}  # fmt: skip
_UNKNOWN_SOURCE = Cell("unknown", "warn")
_WRAPPED_COLUMNS = frozenset(range(12))


class ListingView(ListView):
    """A listing below its headings, then the hosts that do not answer."""

    formats = FLEET_FORMATS

    def __init__(self, listing: Listing) -> None:
        self._listing = listing
        self.kind = listing.kind.value.removesuffix("s")

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per item."""
        return _render_listing(self._listing, look, wide=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with measurements and more declarations."""
        return _render_listing(self._listing, look, wide=True)

    def items(self) -> Sequence[Document]:
        """The items as JSON types."""
        return [item.document for item in self._listing.items]

    def warnings(self) -> Sequence[str]:
        """Hosts without a reply, and tasks that run twice or at lost places."""
        return self._listing.notes

    def notes(self) -> Sequence[str]:
        """The same, and that nothing is listed."""
        return _list_listing_notes(self._listing)

    def names(self) -> Sequence[str]:
        """KIND/NAME of each item."""
        return [item.name for item in self._listing.items]


class ListingChangesView(ListView):
    """The changes of a listing, below the lines of the ``first`` one; where this is the first, all of it."""

    formats = FLEET_FORMATS
    kind = "change"

    def __init__(self, listing: Listing, changes: Sequence[Change], first: Listing | None) -> None:
        self._listing, self._changes, self._first = listing, changes, first

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The lines that changed."""
        return self._render(look, wide=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The same in full."""
        return self._render(look, wide=True)

    def _render(self, look: RenderOptions, *, wide: bool) -> str:
        if self._first is None:
            return _render_listing(self._listing, look, wide=wide)
        rows = [
            _build_deleted_item_row(item, wide=wide)
            if change is ItemChange.DELETED
            else _build_item_row(item, wide=wide)
            for change, item in self._changes
        ]
        return render_columns(
            rows,
            look,
            right=_find_number_columns(self._first.kind, wide=wide),
            wrap=_WRAPPED_COLUMNS,
            least=measure_column_widths(_build_listing_rows(self._first, wide=wide)),
        )

    def items(self) -> Sequence[Document]:
        """The changes: type, instant and the item as it is now."""
        at = format_instant(self._listing.at)
        return [
            {"type": change.value, "at": at, "object": round_item(item.document)}
            for change, item in self._changes
        ]

    def notes(self) -> Sequence[str]:
        """The notes of the first listing."""
        return _list_listing_notes(self._listing) if self._first is None else ()

    def names(self) -> Sequence[str]:
        """KIND/NAME of each item that changed."""
        return [item.name for _, item in self._changes]


def build_listing(kind: ListingKind, value: Snapshot, inventory: Inventory, tasks: Tasks) -> Listing:
    """Everything of a kind: the declarations of the files, and what hosts report beyond them."""
    build: Mapping[ListingKind, Callable[[], Iterator[ListingItem]]] = {
        ListingKind.EDGES: lambda: (_build_host_item(host, value, ()) for host in inventory.edges),
        ListingKind.ROBOTS: lambda: (
            _build_host_item(host, value, ("yes" if host.onboard else "no",)) for host in inventory.robots
        ),
        ListingKind.TASKS: lambda: _build_task_items(value, inventory, tasks),
        ListingKind.LINKS: lambda: _build_link_items(value, inventory),
    }
    return Listing(
        kind=kind,
        at=value.taken_at,
        items=tuple(build[kind]()),
        notes=(
            *list_snapshot_notes(value),
            *(list_foreign_notes(value) if kind is ListingKind.TASKS else ()),
        ),
    )


def compare_listings(before: Listing | None, after: Listing) -> list[Change]:
    """The changes in the order of ``after``; then what is gone."""
    known = {item.path: item for item in before.items} if before else {}
    found = [(ItemChange.MODIFIED if item.path in known else ItemChange.ADDED, item) for item in after.items]
    left = known.keys() - {item.path for item in after.items}
    return [
        (change, item)
        for change, item in found
        if change is ItemChange.ADDED or known[item.path].told != item.told
    ] + [(ItemChange.DELETED, item) for path, item in known.items() if path in left]


def _build_host_item(host: Host, value: Snapshot, extra: Row) -> ListingItem:
    sample = value.hosts.get(host.name)
    status, alive = render_host_status(host.name, sample, value.manager), _count_alive_tasks(sample)
    usage = sample.usage if sample and sample.ok else {}
    capacity = (
        *(
            resource.unit.format(found.capacity) if (found := usage.get(resource.name)) else "-"
            for resource in HOST_RESOURCES
        ),
        str(alive) if usage else "-",
    )
    labels = ",".join(f"{key}={text}" for key, text in host.labels.items()) or "-"
    return ListingItem(
        path=host.name,
        name=f"{host.role}/{host.name}",
        aliases=(host.name,),
        row=(Cell(host.name, "name"), status, *capacity, *extra, labels),
        wide_cells=(
            f"{host.connection} {host.host}",
            *(
                f"{found.used / found.capacity:.0%}" if (found := usage.get(resource.name)) else "-"
                for resource in HOST_RESOURCES
            ),
        ),
        told=(status.text, *capacity, *extra, labels),
        document=encode_host_row(host.name, value, host),
        labels=host.labels,
    )


def _count_alive_tasks(sample: HostSample | None) -> int:
    return sum(task.state.alive for task in sample.tasks.values()) if sample else 0


def _build_task_items(value: Snapshot, inventory: Inventory, tasks: Tasks) -> Iterator[ListingItem]:
    runs = [(name, host, sample) for host, each in value.hosts.items() for name, sample in each.tasks.items()]
    seen = {name for name, _, _ in runs}
    order = {name: place for place, name in enumerate([*tasks.tasks, *sorted(seen - tasks.tasks.keys())])}
    items = [_build_running_task_item(run, value, inventory, tasks) for run in runs]
    items += [_build_absent_task_item(task, value) for task in tasks.tasks.values() if task.name not in seen]
    yield from sorted(items, key=lambda item: (order[item.aliases[0]], item.path))


def _build_running_task_item(
    run: tuple[str, str, TaskSample], value: Snapshot, inventory: Inventory, tasks: Tasks
) -> ListingItem:
    name, host, sample = run
    task, demand = tasks.tasks.get(name), find_task_demand(name, host, value, inventory, tasks)
    state, restarts = Cell(format_task_state(sample), TASK_STATE_STYLES[sample.state]), str(sample.restarts)
    age = compute_task_age(sample, value)
    return ListingItem(
        path=f"{name} on {host}",
        name=f"task/{name}",
        aliases=(name,),
        row=(Cell(name, "name"), host, state, restarts, "-" if age is None else format_duration(age)),
        wide_cells=(
            *_format_spec_columns(task),
            str(sample.pid or "-"),
            metrics.format_metrics(sample.metrics),
        ),
        told=(host, state.text, restarts, sample.instance, *_format_spec_columns(task)),
        document=encode_run_row(name, host, sample, demand, value) | _encode_spec_columns(task),
        labels=_collect_task_labels(task),
    )


def _build_absent_task_item(task: Task, value: Snapshot) -> ListingItem:
    known = resolve_absent_task(task, value)
    state = Cell(known.state + format_silence(known.contact, value.taken_at), "warn" if known.host else "dim")
    return ListingItem(
        path=f"{task.name} on -",
        name=f"task/{task.name}",
        aliases=(task.name,),
        row=(Cell(task.name, "name"), known.host or "-", state, "-", "-"),
        wide_cells=(*_format_spec_columns(task), "-", "-"),
        told=(known.host, known.state, *_format_spec_columns(task)),
        document=encode_absent_row(task, value) | _encode_spec_columns(task),
        labels=_collect_task_labels(task),
    )


def _format_spec_columns(task: Task | None) -> tuple[str, str, str]:
    if task is None:
        return ("not in the files", "-", "-")
    kind = task.kind.value if task.managed else "not managed"
    return (kind, ",".join(task.robots) or "-", ",".join(need.task for need in task.needs) or "-")


def _encode_spec_columns(task: Task | None) -> Document:
    if task is None:
        return {"in_files": False}
    needs = [{"task": need.task, "until": need.until.value} for need in task.needs]
    return {
        "in_files": True,
        "task_kind": task.kind.value,
        "robot_names": list(task.robots),
        "needs": needs,
        "labels": dict(task.labels),
    }


def _collect_task_labels(task: Task | None) -> Mapping[str, str]:
    return {} if task is None else {**task.labels, "task": task.template}


def _build_link_items(value: Snapshot, inventory: Inventory) -> Iterator[ListingItem]:
    for edge in inventory.edges:
        sample = value.hosts.get(edge.name)
        for robot in inventory.robots:
            link = sample.links.get(robot.name) if sample else None
            yield _build_link_item(edge.name, robot.name, link, value)


def _build_link_item(edge: str, robot: str, link: LinkSample | None, value: Snapshot) -> ListingItem:
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
        aliases=(path, edge, robot),
        row=(Cell(edge, "name"), Cell(robot, "name"), capacity, source),
        wide_cells=(format_rate(link.used_bytes_per_s) if link else "-", rtt),
        told=(capacity, source.text),
        document={
            "edge": edge,
            "robot": robot,
            "taken_at": format_instant(value.taken_at),
            **(encode_link_sample(link) if link else {}),
        },
        labels={},
    )


def _list_listing_notes(value: Listing) -> list[str]:
    return [*([] if value.items else [f"no {value.kind}"]), *value.notes]


def _render_listing(value: Listing, look: RenderOptions, *, wide: bool) -> str:
    return (
        render_columns(
            _build_listing_rows(value, wide=wide),
            look,
            right=_find_number_columns(value.kind, wide=wide),
            wrap=_WRAPPED_COLUMNS,
        )
        if value.items
        else ""
    )


def _build_listing_rows(value: Listing, *, wide: bool) -> list[Row]:
    return [
        head(*_list_columns(value.kind, wide=wide)),
        *(_build_item_row(item, wide=wide) for item in value.items),
    ]


def _list_columns(kind: ListingKind, *, wide: bool) -> tuple[str, ...]:
    columns, more = _COLUMNS[kind]
    return (*columns[:-1], *more, columns[-1]) if wide else columns


def _find_number_columns(kind: ListingKind, *, wide: bool) -> frozenset[int]:
    columns = _list_columns(kind, wide=wide)
    return frozenset(place for place, column in enumerate(columns) if column in _NUMBERS)


def _build_item_row(item: ListingItem, *, wide: bool) -> Row:
    return (*item.row[:-1], *item.wide_cells, item.row[-1]) if wide else item.row


def _build_deleted_item_row(item: ListingItem, *, wide: bool) -> Row:
    """Only tasks that no file names can go."""
    name, host, _, *rest = _build_item_row(item, wide=wide)
    return (name, host, Cell("gone", "bad"), *rest)
