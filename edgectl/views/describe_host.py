"""Everything that is known of an edge or a robot: what the inventory states, what is measured, what happened last."""

from collections.abc import Mapping, Sequence

from edgectl.formats.document import FORMAT_VERSION, Document, without_none
from edgectl.model.event import Event
from edgectl.model.inventory import Host, Inventory
from edgectl.model.snapshot import HostSample, InterfaceSample, ResourceUsage, Snapshot
from edgectl.model.task import Tasks
from edgectl.units import format_bytes, format_cores, format_duration, format_instant, format_rate
from edgectl.views import events as events_view
from edgectl.views.describe import Field, format_pairs, render_events_section, render_fields, render_section
from edgectl.views.listing import encode_listed_host
from edgectl.views.state import render_host_status
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row
from edgectl.views.top import render_task_rows_of_host
from edgectl.views.usage import render_usage_share


def render_host_details(
    name: str,
    value: Snapshot,
    inventory: Inventory,
    tasks: Tasks,
    events: Sequence[Event] | None,
    look: RenderOptions = PLAIN,
) -> str:
    """One edge or robot. ``events``: the last ones, oldest first; None: not asked for."""
    stated, sample = inventory.hosts[name], value.hosts.get(name)
    parts = [render_fields(_list_host_fields(stated, sample, value), look)]
    if sample is not None and sample.ok:
        parts += [
            render_section("Use", _render_host_usage_rows(stated, sample, look), look),
            render_section("Links", _render_host_link_rows(sample), look),
            render_section("Tasks", render_task_rows_of_host(value, inventory, tasks, on=name), look),
            render_section("Interfaces", _render_interface_rows(sample.device.interfaces), look),
        ]
    return "".join([*parts, render_events_section(events, look)])


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
        found += [("Cause", sample.error), ("Mend", sample.hint)]
    return [
        *found,
        (
            "Last contact",
            "" if contact is None else f"{format_duration(max(0.0, value.taken_at - contact))} ago",
        ),
        ("Labels", format_pairs(stated.labels)),
        ("Capacity", _format_host_capacity(stated, sample)),
        ("Limits", f"cpu {stated.limits['cpu']:.0%}, memory {stated.limits['memory']:.0%}"),
        ("Onboard", "a candidate for its own tasks" if stated.onboard else ""),
        ("Runtime", stated.runtime.value),
        ("Prelude", stated.prelude),
        ("Environment", format_pairs(stated.env)),
        ("Env command", " ".join(stated.env_command)),
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


def _format_host_capacity(stated: Host, sample: HostSample | None) -> str:
    if stated.is_slice and stated.capacity is not None:
        base = f"; base load {format_cores(stated.base['cpu'])} cores, {format_bytes(stated.base['memory'])}"
        declared = f"{format_cores(stated.capacity['cpu'])} cores, {format_bytes(stated.capacity['memory'])} (declared)"
        return declared + (base if stated.base["cpu"] or stated.base["memory"] else "")
    if sample is None or not sample.measured:
        return ""
    return f"{format_cores(sample.usage['cpu'].capacity)} cores, {format_bytes(sample.usage['memory'].capacity)} (measured)"


def _format_device(sample: HostSample) -> str:
    device = sample.device
    known = {
        "load": None if device.load_1m is None else f"{device.load_1m:.2f}",
        "temperature": None if device.temperature_c is None else f"{device.temperature_c:.0f}C",
        "gpu": None if device.gpu_share is None else f"{device.gpu_share:.0%}",
        "clock": None if device.clock_skew_s is None else _format_clock_skew(device.clock_skew_s),
        "boot": device.boot_id[:8] or None,
    }
    return ", ".join(f"{what} {text}" for what, text in known.items() if text)


def _format_clock_skew(seconds: float) -> str:
    return f"{abs(seconds):.1f}s {'behind' if seconds < 0 else 'ahead'}"


def _render_host_usage_rows(stated: Host, sample: HostSample, look: RenderOptions) -> list[Row]:
    if not sample.measured:
        return []
    cpu, memory = sample.usage["cpu"], sample.usage["memory"]
    return [
        (
            "cpu",
            render_usage_share(cpu, stated.limits["cpu"], look),
            f"{format_cores(cpu.used)} of {format_cores(cpu.capacity)} cores",
        ),
        (
            "memory",
            render_usage_share(memory, stated.limits["memory"], look),
            f"{format_bytes(memory.used)} of {format_bytes(memory.capacity)}",
        ),
        *(
            (
                robot,
                render_usage_share(
                    ResourceUsage(capacity=link.capacity_bytes_per_s, used=link.used_bytes_per_s), 1.0, look
                ),
                f"{format_rate(link.used_bytes_per_s)} of {format_rate(link.capacity_bytes_per_s)}",
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
            format_rate(link.used_bytes_per_s),
            "-" if link.rtt_ms is None else f"{link.rtt_ms:.1f}ms",
        )
        for robot, link in sample.links.items()
    ]
    return [("ROBOT", "CAPACITY", "SOURCE", "USED", "RTT"), *rows] if rows else []


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
    return [("NAME", "IN", "OUT", "SPEED"), *rows] if rows else []


def encode_host_details(
    name: str, value: Snapshot, inventory: Inventory, events: Sequence[Event]
) -> Document:
    """One host as JSON types."""
    stated = inventory.hosts[name]
    contact = value.manager.contact.get(name) if value.manager else None
    return {
        "format_version": FORMAT_VERSION,
        "taken_at": format_instant(value.taken_at),
        **encode_listed_host(stated, value),
        **without_none(
            port=stated.port,
            user=stated.user,
            proxy_jump=stated.proxy_jump,
            runtime=stated.runtime.value,
            env={key: str(text) for key, text in stated.env.items()},
            last_contact=None if contact is None else format_instant(contact),
        ),
        "events": [events_view.encode_event(event) for event in events],
    }
