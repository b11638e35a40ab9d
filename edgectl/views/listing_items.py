# SPDX-License-Identifier: Apache-2.0
"""Items of a listing of edges, robots, tasks or links, and their changes from one probe to the next."""

from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum

from edgectl.dataclass import dataclass
from edgectl.formats.document import Document
from edgectl.model.inventory import Host, Inventory
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.snapshot import HostSample, LinkSample, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.units import format_duration, format_instant, format_rate
from edgectl.views import metrics
from edgectl.views.notes import list_snapshot_notes
from edgectl.views.other_tasks import list_foreign_notes
from edgectl.views.rows import (
    compute_task_age,
    encode_absent_row,
    encode_host_row,
    encode_link_sample,
    encode_run_row,
    find_task_demand,
)
from edgectl.views.standbys import encode_standby_row, list_standby_runs, render_standby_state
from edgectl.views.state import (
    TASK_STATE_STYLES,
    format_silence,
    format_task_state,
    render_host_status,
    resolve_absent_task,
)
from edgectl.views.text import Cell, Row
from edgectl.views.usage import render_capacity_age


class ListingKind(StrEnum):
    """The kinds that can be listed."""

    HOSTS = "hosts"
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
    labels: Mapping[str, str | tuple[str, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """Items of one kind at one instant (s since 1970), with notes on the whole."""

    kind: ListingKind
    at: float
    items: tuple[ListingItem, ...]
    notes: tuple[str, ...] = ()


Change = tuple[ItemChange, ListingItem]


_UNKNOWN_SOURCE = Cell("unknown", "warn")


def build_listing(kind: ListingKind, value: Snapshot, inventory: Inventory, tasks: Tasks) -> Listing:
    """Everything of a kind: the declarations of the files, and what hosts report beyond them."""
    build: Mapping[ListingKind, Callable[[], Iterator[ListingItem]]] = {
        ListingKind.HOSTS: lambda: (
            _build_host_item(host, value, (host.role.value,)) for host in inventory.hosts.values()
        ),
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
        labels={
            "host": host.name,
            "kind": host.role.value,
            "state": status.text.partition(",")[0],
            **host.labels,
        },
    )


def _count_alive_tasks(sample: HostSample | None) -> int:
    return sum(task.state.alive for task in sample.tasks.values()) if sample else 0


def _build_task_items(value: Snapshot, inventory: Inventory, tasks: Tasks) -> Iterator[ListingItem]:
    runs = [(name, host, sample) for host, each in value.hosts.items() for name, sample in each.tasks.items()]
    seen = {name for name, _, _ in runs}
    order = {name: place for place, name in enumerate([*tasks.tasks, *sorted(seen - tasks.tasks.keys())])}
    items = [_build_running_task_item(run, value, inventory, tasks) for run in runs]
    items += [_build_absent_task_item(task, value) for task in tasks.tasks.values() if task.name not in seen]
    copies = list_standby_runs(value)
    items += [_build_standby_item(run, value, tasks) for run in copies]
    order |= {name: len(order) for name in sorted({name for name, _, _ in copies}) if name not in order}
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
        aliases=(name, *((task.template,) if task is not None else ())),
        row=(Cell(name, "name"), host, state, restarts, "-" if age is None else format_duration(age)),
        wide_cells=(
            *_format_spec_columns(task),
            str(sample.pid or "-"),
            metrics.format_metrics(sample.metrics),
        ),
        told=(host, state.text, restarts, sample.instance, *_format_spec_columns(task)),
        document=encode_run_row(name, host, sample, demand, value) | _encode_spec_columns(task),
        labels=_collect_task_labels(task, host, sample.state.value),
    )


def _build_standby_item(run: tuple[str, str, TaskSample], value: Snapshot, tasks: Tasks) -> ListingItem:
    name, host, copy = run
    task, age = tasks.tasks.get(name), compute_task_age(copy, value)
    state, restarts = render_standby_state(copy), str(copy.restarts)
    return ListingItem(
        path=f"{name} on {host}",
        name=f"task/{name}",
        aliases=(name, *((task.template,) if task is not None else ())),
        row=(Cell(name, "name"), host, state, restarts, "-" if age is None else format_duration(age)),
        wide_cells=(*_format_spec_columns(task), str(copy.pid or "-"), metrics.format_metrics(copy.metrics)),
        told=(host, state.text, restarts, copy.instance, *_format_spec_columns(task)),
        document=encode_standby_row(name, host, copy, {}, value) | _encode_spec_columns(task),
        labels=_collect_task_labels(task, host, "standby"),
    )


def _build_absent_task_item(task: Task, value: Snapshot) -> ListingItem:
    known = resolve_absent_task(task, value)
    state = Cell(known.state + format_silence(known.contact, value.taken_at), "warn" if known.host else "dim")
    return ListingItem(
        path=f"{task.name} on -",
        name=f"task/{task.name}",
        aliases=(task.name, task.template),
        row=(Cell(task.name, "name"), known.host or "-", state, "-", "-"),
        wide_cells=(*_format_spec_columns(task), "-", "-"),
        told=(known.host, known.state, *_format_spec_columns(task)),
        document=encode_absent_row(task, value) | _encode_spec_columns(task),
        labels=_collect_task_labels(task, known.host, known.state),
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


def _collect_task_labels(
    task: Task | None, host: str | None, state: str
) -> Mapping[str, str | tuple[str, ...]]:
    """The labels of a task, and those that follow: task (its entry), kind, robot, host, state.

    Its own win.
    """
    seen: dict[str, str | tuple[str, ...]] = {
        "host": () if host is None else host,
        "state": state.replace(" ", "-"),
    }
    if task is None:
        return seen
    return {**seen, "task": task.template, "kind": task.kind.value, "robot": task.robots, **task.labels}


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
    nominal = format_rate(link.nominal_bytes_per_s) if link else "-"
    is_live = link is not None and link.nominal is not None
    return ListingItem(
        path=path,
        name=f"link/{path}",
        aliases=(path, edge, robot),
        row=(Cell(edge, "name"), Cell(robot, "name"), capacity, source, render_capacity_age(link)),
        wide_cells=(nominal, format_rate(link.used_bytes_per_s) if link else "-", rtt),
        # A live capacity is a measurement: its changes are none of the link.
        told=(nominal, "live" if is_live else source.text),
        document={
            "edge": edge,
            "robot": robot,
            "taken_at": format_instant(value.taken_at),
            **(encode_link_sample(link) if link else {}),
        },
        labels={"host": edge, "robot": robot},
    )
