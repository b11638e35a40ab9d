# SPDX-License-Identifier: Apache-2.0
"""The snapshot of a probe: hosts with their load, links and tasks."""

from collections.abc import Callable, Sequence

from edgectl.formats.document import Document, encode_optional, without_none
from edgectl.formats.kinds import SNAPSHOT_KIND
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.snapshot import (
    BandwidthMeasurement,
    HostSample,
    InterfaceSample,
    LinkSample,
    ResourceUsage,
    Snapshot,
)
from edgectl.units import format_duration, format_rate
from edgectl.views.glossary import head
from edgectl.views.notes import list_snapshot_notes
from edgectl.views.other_tasks import list_foreign_notes
from edgectl.views.output import View
from edgectl.views.output_format import FLEET_FORMATS
from edgectl.views.rows import encode_host_row
from edgectl.views.state import render_host_status
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, is_within_width, render_columns
from edgectl.views.usage import describe_capacity, format_sample_age, format_traffic

UsedCell = Callable[[ResourceUsage | None, Callable[[float], str]], Cell]
_USED_COLUMNS = tuple(f"{each.name}.used_{each.unit.name}" for each in HOST_RESOURCES)


class SnapshotView(View):
    """A snapshot; its document is the one that ``edgectl plan --snapshot`` reads."""

    formats = FLEET_FORMATS

    def __init__(self, snapshot: Snapshot, bandwidth: Sequence[BandwidthMeasurement] = ()) -> None:
        self._snapshot = snapshot
        self._bandwidth = bandwidth

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per host: capacity, usage, links and tasks; on a narrow terminal shares alone."""
        rows = self._render_host_rows(_render_used_cell)
        if not is_within_width([row[:-1] for row in rows], look):
            rows = self._render_host_rows(_render_share_cell)
        return self._render_bandwidth(look) + render_columns(
            rows, look, right=set(range(3, 4 + len(HOST_RESOURCES))), wrap={2}
        )

    def _render_host_rows(self, show: UsedCell) -> list[Row]:
        """The heading, then the rows with the usage of each resource by ``show``."""
        return [
            head("host", "role", "status", *_USED_COLUMNS, "task_count", "links"),
            *(
                _render_host_row(name, host, self._snapshot, show)
                for name, host in self._snapshot.hosts.items()
            ),
        ]

    def notes(self) -> Sequence[str]:
        """Hosts without a reply, tasks that run twice or at lost places, and tasks of other fleets."""
        return [*list_snapshot_notes(self._snapshot), *list_foreign_notes(self._snapshot)]

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table, then load, temperature, GPU, sample age, links in full and interfaces of each host."""
        rows = [
            head(
                "host",
                "sample_age_s",
                "device.load_1m",
                "device.temperature_c",
                "device.gpu_share",
                "links",
                "interfaces",
            )
        ]
        rows += [_render_device_row(name, host) for name, host in self._snapshot.hosts.items() if host.ok]
        return self.table(look) + "\n" + render_columns(rows, look, right={1, 2, 3, 4}, wrap={5})

    def _render_bandwidth(self, look: RenderOptions) -> str:
        if not self._bandwidth:
            return ""
        rows = [head("edge", "robot", "capacity_bytes_per_s")]
        rows += [(each.edge, each.robot, _render_bandwidth_cell(each)) for each in self._bandwidth]
        return render_columns(rows, look) + "\n"

    def document(self) -> Document:
        """The snapshot file. Its numbers are exact, for it is read back."""
        document = SNAPSHOT_KIND.encode(self._snapshot)
        if self._bandwidth:
            document["bandwidth"] = [_encode_bandwidth_measurement(each) for each in self._bandwidth]
        return document

    def rows(self) -> Sequence[Document]:
        """One row per host."""
        return [encode_host_row(name, self._snapshot) for name in self._snapshot.hosts]

    def names(self) -> Sequence[str]:
        """The hosts that replied, as edge/NAME or robot/NAME."""
        return [f"{host.role}/{name}" for name, host in self._snapshot.hosts.items() if host.ok]


def _render_host_row(name: str, host: HostSample, value: Snapshot, show: UsedCell) -> Row:
    first = (Cell(name, "name"), host.role, render_host_status(name, host, value.manager))
    if not host.ok or not host.measured:
        return (*first, *("-",) * (len(HOST_RESOURCES) + 2))
    return (
        *first,
        *(show(host.usage.get(each.name), each.unit.format) for each in HOST_RESOURCES),
        str(sum(task.state.alive for task in host.tasks.values())),
        ", ".join(_format_link_share(robot, link) for robot, link in host.links.items()) or "-",
    )


def _render_used_cell(usage: ResourceUsage | None, show: Callable[[float], str]) -> Cell:
    if usage is None:
        return Cell("-")
    share = usage.used / usage.capacity
    return Cell(f"{show(usage.used)}/{show(usage.capacity)} ({share:.0%})", "bad" if share > 1 else "")


def _render_share_cell(usage: ResourceUsage | None, _: Callable[[float], str]) -> Cell:
    if usage is None:
        return Cell("-")
    share = usage.used / usage.capacity
    return Cell(f"{share:.0%}", "bad" if share > 1 else "")


def _format_link_share(robot: str, link: LinkSample) -> str:
    share = (
        f" {link.used_bytes_per_s / link.capacity_bytes_per_s:.0%}" if link.capacity_bytes_per_s else " down"
    )
    rtt = f" {link.rtt_ms:.1f}ms" if link.rtt_ms is not None else ""
    return format_traffic(f"{robot}{share}{rtt}", link.partial)


def _render_device_row(name: str, host: HostSample) -> Row:
    device = host.device
    return (
        Cell(name, "name"),
        format_sample_age(host),
        "-" if device.load_1m is None else f"{device.load_1m:.2f}",
        "-" if device.temperature_c is None else f"{device.temperature_c:.0f}C",
        "-" if device.gpu_share is None else f"{device.gpu_share:.0%}",
        ", ".join(_format_link_details(robot, link) for robot, link in host.links.items()) or "-",
        ", ".join(_format_interface(interface, sample) for interface, sample in device.interfaces.items())
        or "-",
    )


def _format_link_details(robot: str, link: LinkSample) -> str:
    remark = f"partial: {link.partial}" if link.partial else f"by {link.used_source}"
    return f"{robot} {format_rate(link.used_bytes_per_s)} ({remark}) of {describe_capacity(link)}"


def _format_interface(name: str, sample: InterfaceSample) -> str:
    speed = f" of {format_rate(sample.speed_bytes_per_s)}" if sample.speed_bytes_per_s else ""
    traffic = (
        f"{name} in {format_rate(sample.rx_bytes_per_s)} out {format_rate(sample.tx_bytes_per_s)}{speed}"
    )
    return " ".join([traffic, *_describe_radio(sample)])


def _describe_radio(sample: InterfaceSample) -> list[str]:
    found = [] if sample.level_dbm is None else [f"{sample.level_dbm:.0f}dBm"]
    if sample.retries_per_s is not None:
        found.append(f"{sample.retries_per_s:.0f} retries/s")
    if sample.access_point:
        since = "" if sample.joined_s is None else f" for {format_duration(sample.joined_s)}"
        found.append(f"at {sample.access_point}{since}")
    return found


def _render_bandwidth_cell(value: BandwidthMeasurement) -> str | Cell:
    return Cell(value.error, "bad") if value.bytes_per_s is None else format_rate(value.bytes_per_s)


def _encode_bandwidth_measurement(value: BandwidthMeasurement) -> Document:
    return without_none(
        edge=value.edge,
        robot=value.robot,
        capacity_bytes_per_s=encode_optional(value.bytes_per_s),
        error=value.error or None,
    )
