# SPDX-License-Identifier: Apache-2.0
"""Details of an edge or a robot: declarations of the inventory, measurements and the last events."""

from collections.abc import Mapping, Sequence

from edgectl.formats.document import Document, without_none
from edgectl.formats.event_document import encode_event
from edgectl.model.event import Event
from edgectl.model.inventory import Host, Inventory
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.snapshot import HostSample, InterfaceSample, ResourceUsage, Snapshot
from edgectl.model.task import Tasks
from edgectl.rules.heat import describe_heat
from edgectl.units import format_duration, format_instant, format_rate, format_watts
from edgectl.views.describe import Field, format_pairs, render_events_section, render_fields, render_section
from edgectl.views.glossary import head
from edgectl.views.other_tasks import render_other_task_rows
from edgectl.views.output import ItemView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.rows import encode_host_row
from edgectl.views.state import render_host_status
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row
from edgectl.views.top_tasks import render_task_rows_of_host
from edgectl.views.usage import (
    format_sample_age,
    format_traffic,
    render_capacity_age,
    render_usage_share,
)

_LINK_HEAD = head(
    "robot", "capacity_bytes_per_s", "capacity_source", "capacity_age_s", "nominal_bytes_per_s",
    "network.used_bytes_per_s", "rtt_ms",
)  # fmt: skip
_INTERFACE_HEAD = head("interface", "rx_bytes_per_s", "tx_bytes_per_s", "speed_bytes_per_s")


class HostDetailsView(ItemView):
    """One edge or robot. ``events``: the last ones, oldest first; None: not asked for."""

    formats = ITEM_FORMATS

    def __init__(
        self,
        name: str,
        snapshot: Snapshot,
        inventory: Inventory,
        tasks: Tasks,
        events: Sequence[Event] | None,
    ) -> None:
        self._host, self._snapshot = inventory.hosts[name], snapshot
        self._inventory, self._tasks, self._events = inventory, tasks, events
        self.kind = self._host.role.value

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Fields, then usage, links, tasks, interfaces and events."""
        stated, value = self._host, self._snapshot
        sample = value.hosts.get(stated.name)
        parts = [render_fields(_list_host_fields(stated, sample, value), look)]
        if sample is not None and sample.ok:
            tasks = render_task_rows_of_host(value, self._inventory, self._tasks, on=stated.name)
            interfaces = _render_interface_rows(sample.device.interfaces)
            parts += [
                render_section("Usage", _render_host_usage_rows(stated, sample, look), look),
                render_section("Links", _render_host_link_rows(sample), look, right={1, 3, 4, 5, 6}),
                render_section("Tasks", tasks, look, right=set(range(1, 7))),
                render_section(
                    "Other tasks on this machine", render_other_task_rows(sample), look, right={5}
                ),
                render_section("Interfaces", interfaces, look, right={1, 2, 3}),
            ]
        return "".join([*parts, render_events_section(self._events, look)])

    def item(self) -> Document:
        """The host as JSON types."""
        stated, memory = self._host, self._snapshot.manager
        contact = memory.contact.get(stated.name) if memory else None
        return {
            **encode_host_row(stated.name, self._snapshot, stated),
            **without_none(
                port=stated.port,
                user=stated.user,
                proxy_jump=stated.proxy_jump,
                runtime=stated.runtime.value,
                env={key: str(text) for key, text in stated.env.items()},
                contacted_at=None if contact is None else format_instant(contact),
            ),
            "events": [encode_event(event) for event in self._events or ()],
        }


def _list_host_fields(stated: Host, sample: HostSample | None, value: Snapshot) -> list[Field]:
    contact = value.manager.contact.get(stated.name) if value.manager else None
    found = [
        ("Name", Cell(stated.name, "name")),
        ("Role", stated.role.value),
        ("Address", stated.host),
        *_list_connection_fields(stated),
    ]
    found.append(("Status", render_host_status(stated.name, sample, value.manager)))
    if sample is not None and not sample.ok:
        found += [("Cause", sample.error), ("Hint", sample.hint)]
    elif sample is not None:
        found.append(("Sample age", format_sample_age(sample)))
    return [
        *found,
        (
            "Last contact",
            "" if contact is None else f"{format_duration(max(0.0, value.taken_at - contact))} ago",
        ),
        ("Labels", format_pairs(stated.labels)),
        ("Capacity", _format_host_capacity(stated, sample)),
        ("Limits", _format_limits(stated, sample)),
        ("Onboard", "candidate for its own tasks" if stated.onboard else ""),
        ("Runtime", stated.runtime.value),
        ("Prelude", stated.prelude),
        ("Environment", format_pairs(stated.env)),
        ("Env command", " ".join(stated.env_command)),
        ("Swarm", ", ".join(stated.swarm)),
        ("Device", _format_device(sample) if sample is not None and sample.ok else ""),
    ]


def _list_connection_fields(stated: Host) -> list[Field]:
    named = {
        "port": stated.port,
        "user": stated.user,
        "key": stated.identity_file,
        "through": stated.proxy_jump,
    }
    parts = [f"{what} {text}" for what, text in named.items() if text]
    return [("Connection", ", ".join([stated.connection.value, *parts]))]


def _format_limits(stated: Host, sample: HostSample | None) -> str:
    known: Mapping[str, float] = stated.capacity or {}
    heat = describe_heat(stated, sample)
    hottest = "" if stated.max_temperature is None else f", max {stated.max_temperature:.0f}C"
    shares = ", ".join(
        f"{each} {stated.limits[each.name]:.0%}"
        for each in HOST_RESOURCES
        if known.get(each.name) or not each.optional or stated.limits[each.name] != 1
    )
    return shares + hottest + (f" (now {heat})" if heat else "")


def _format_host_capacity(stated: Host, sample: HostSample | None) -> str:
    if stated.is_slice and stated.capacity is not None:
        declared, base = _format_amounts(stated.capacity), _format_amounts(stated.base)
        return f"{declared} (declared)" + (f"; base load {base}" if any(stated.base.values()) else "")
    if sample is None or not sample.measured:
        return ""
    return f"{_format_amounts({name: usage.capacity for name, usage in sample.usage.items()})} (measured)"


def _format_amounts(amounts: Mapping[str, float]) -> str:
    return ", ".join(
        resource.unit.format_in_text(amounts[resource.name])
        for resource in HOST_RESOURCES
        if amounts.get(resource.name) or (resource.name in amounts and not resource.optional)
    )


def _format_device(sample: HostSample) -> str:
    device = sample.device
    known = {
        "load": None if device.load_1m is None else f"{device.load_1m:.2f}",
        "temperature": None if device.temperature_c is None else f"{device.temperature_c:.0f}C",
        "gpu": None if device.gpu_share is None else f"{device.gpu_share:.0%}",
        "power": None if device.power_w is None else format_watts(device.power_w),
        "clock": None if device.clock_skew_s is None else _format_clock_skew(device.clock_skew_s),
        "boot": device.boot_id[:8] or None,
    }
    return ", ".join(f"{what} {text}" for what, text in known.items() if text)


def _format_clock_skew(seconds: float) -> str:
    return f"{abs(seconds):.1f}s {'behind' if seconds < 0 else 'ahead'}"


def _render_host_usage_rows(stated: Host, sample: HostSample, look: RenderOptions) -> list[Row]:
    if not sample.measured:
        return []
    return [
        *(
            (
                each.name,
                render_usage_share(usage, stated.limits[each.name], look),
                f"{each.unit.format(usage.used)} of {each.unit.format_in_text(usage.capacity)}",
            )
            for each in HOST_RESOURCES
            if (usage := sample.usage.get(each.name)) is not None
        ),
        *(
            (
                robot,
                render_usage_share(
                    ResourceUsage(capacity=link.capacity_bytes_per_s, used=link.used_bytes_per_s), 1.0, look
                ),
                (
                    f"{format_traffic(format_rate(link.used_bytes_per_s), link.partial)}"
                    f" of {format_rate(link.capacity_bytes_per_s)}"
                ),
            )
            for robot, link in sample.links.items()
        ),
    ]


def _render_host_link_rows(sample: HostSample) -> list[Row]:
    rows: list[Row] = [
        (
            Cell(robot, "name"),
            format_rate(link.capacity_bytes_per_s),
            link.capacity_source.value,
            render_capacity_age(link),
            format_rate(link.nominal_bytes_per_s),
            format_traffic(format_rate(link.used_bytes_per_s), link.partial),
            "-" if link.rtt_ms is None else f"{link.rtt_ms:.1f}ms",
        )
        for robot, link in sample.links.items()
    ]
    return [_LINK_HEAD, *rows] if rows else []


def _render_interface_rows(found: Mapping[str, InterfaceSample]) -> list[Row]:
    rows: list[Row] = [
        (
            name,
            format_rate(each.rx_bytes_per_s),
            format_rate(each.tx_bytes_per_s),
            "-" if each.speed_bytes_per_s is None else format_rate(each.speed_bytes_per_s),
        )
        for name, each in found.items()
    ]
    return [_INTERFACE_HEAD, *rows] if rows else []
