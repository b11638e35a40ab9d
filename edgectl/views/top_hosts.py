# SPDX-License-Identifier: Apache-2.0
"""Usage of hosts, now and over the last samples, against capacity and limits."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from edgectl.formats.document import Document, without_none
from edgectl.model.inventory import Host, Inventory, Limits
from edgectl.model.point import HostPoint
from edgectl.model.resource import CPU, HOST_RESOURCES, Resource
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.rules.heat import describe_heat
from edgectl.units import format_instant, format_rate
from edgectl.views.glossary import get_flat_used_key, head
from edgectl.views.notes import list_snapshot_notes
from edgectl.views.output import ListView
from edgectl.views.output_format import WIDE_FORMATS
from edgectl.views.rows import encode_host_row
from edgectl.views.state import render_host_status
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row
from edgectl.views.usage import (
    format_sample_age,
    render_usage_share,
    render_with_sparklines,
)

_HOST_HEAD = head("host", "status", *(f"{each.name}.share" for each in HOST_RESOURCES), "link", "task_count")
_WIDE_HOST_HEAD = head(
    "sample_age_s",
    *(f"{each.name}.usage" for each in HOST_RESOURCES),
    "rx_bytes_per_s",
    "tx_bytes_per_s",
    "device.load_1m",
    "device.temperature_c",
)
_HOST_RIGHT_COLUMNS = frozenset(range(2, len(_HOST_HEAD) + len(_WIDE_HOST_HEAD))) - {2 + len(HOST_RESOURCES)}


class TopHostsView(ListView):
    """Usage of each host: its CPU, its memory and its busiest link, with the CPU over the last samples."""

    kind = "host-usage"
    formats = WIDE_FORMATS

    def __init__(
        self,
        snapshot: Snapshot,
        inventory: Inventory,
        points: Iterable[HostPoint],
        *,
        order: Sequence[int] | None = None,
        headers: bool = True,
    ) -> None:
        """``order``: the places of the hosts, where they are sorted otherwise than in the inventory."""
        names = list(snapshot.hosts)
        hosts = {names[place]: snapshot.hosts[names[place]] for place in order or ()}
        self._snapshot = replace(snapshot, hosts=hosts) if hosts else snapshot
        self._inventory, self._headers = inventory, headers
        self._points = group_points_by_host(points)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Shares of the capacity."""
        return self._render(look, wide=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with sample ages, absolute numbers, network interfaces, load and temperature."""
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
        return render_with_sparklines(
            [first, *rows], histories, look, right=_HOST_RIGHT_COLUMNS, headers=self._headers
        )

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
        format_sample_age(sample),
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
    """A line for each resource of which a host uses more than its limit, and for each host that is hot."""
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
        heat = describe_heat(host, sample)
        lines += [f"{name} is {heat}"] if heat else []
    return lines


def _get_cpu_share(point: HostPoint) -> float | None:
    return point.usage[CPU.name].share if CPU.name in point.usage else None


def group_points_by_host(points: Iterable[HostPoint]) -> dict[str, list[HostPoint]]:
    """Samples by host, in the order in which they come."""
    found: dict[str, list[HostPoint]] = {}
    for point in points:
        found.setdefault(point.host, []).append(point)
    return found


def _encode_host_point(point: HostPoint) -> Document:
    return without_none(
        at=format_instant(point.at),
        **{get_flat_used_key(each): point.amounts[each.used_key] for each in HOST_RESOURCES},
    )
