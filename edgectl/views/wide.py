"""Everything the scheduler weighed: the terms of every host, losers and the rejected with what they lack."""

from collections.abc import Iterable

from edgectl.model.assignment import RankedHost
from edgectl.model.explanation import Explanation
from edgectl.model.plan import Plan, Step
from edgectl.model.resource import TERMS
from edgectl.model.snapshot import BandwidthMeasurement, HostSample, InterfaceSample, LinkSample, Snapshot
from edgectl.units import format_duration, format_rate
from edgectl.views import plan_sections, table
from edgectl.views.demands import render_demands
from edgectl.views.explanation import render_explanation
from edgectl.views.listing import render_wide_listing as listing
from edgectl.views.listing import render_wide_listing_changes as listing_more
from edgectl.views.plan_sections import ACTION_STYLES, format_utility
from edgectl.views.reasons import describe_reason, describe_rejection
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns
from edgectl.views.top import render_wide_top_hosts as top_hosts
from edgectl.views.top import render_wide_top_tasks as top_tasks

__all__ = [
    "bandwidth",
    "explanation",
    "listing",
    "listing_more",
    "plan",
    "snapshot",
    "top_hosts",
    "top_tasks",
]


def plan(value: Plan, look: RenderOptions = PLAIN) -> str:
    """The table form with every candidate of every task."""
    rows: list[Row] = [("", "TASK", "HOST", *(name.upper() for name in TERMS), "TOTAL", "REASON")]
    for step in value.steps:
        rows += _render_candidate_rows(step)
    body = render_columns(rows, look, right=set(range(3, 4 + len(TERMS))), wrap={1, 2}) if value.steps else ""
    end = plan_sections.render_plan_notes(value, look) + plan_sections.render_plan_summary(value, look)
    parts = (
        plan_sections.render_plan_header(value, look),
        body,
        render_demands(value, look),
        plan_sections.render_expected_load(value, look),
        end,
    )
    return "\n".join(part for part in parts if part)


def explanation(step: Step, value: Explanation, look: RenderOptions = PLAIN) -> str:
    """The table form with every change that would send the task elsewhere."""
    return render_explanation(step, value, look, every=True)


def _render_candidate_rows(step: Step) -> list[Row]:
    decision, style = step.decision, ACTION_STYLES[step.action]
    chosen = next((ranked for ranked in decision.ranking if ranked.host == decision.host), None)
    others = sorted(
        (ranked for ranked in decision.ranking if ranked is not chosen),
        key=lambda ranked: (not ranked.feasible, ranked.rank),
    )
    first: Row = (
        Cell(step.action.symbol, style),
        Cell(step.task, "name"),
        Cell(_format_route(step), "bold"),
        *_format_terms(chosen),
        Cell(describe_reason(step), style),
    )
    rows = [first, *map(_render_losing_host_row, others)]
    left_out = ", ".join(f"{count} {rule}" for rule, count in decision.rejection_counts.items())
    return (
        [*rows, ("", "", Cell("..", "dim"), *[""] * (len(TERMS) + 1), Cell(f"not shown: {left_out}", "dim"))]
        if left_out
        else rows
    )


def _render_losing_host_row(ranked: RankedHost) -> Row:
    return (
        "",
        "",
        Cell(ranked.host, "dim"),
        *_format_terms(ranked),
        Cell(_describe_losing_host(ranked), "dim"),
    )


def _format_route(step: Step) -> str:
    decision = step.decision
    if decision.previous_host and decision.host and decision.previous_host != decision.host:
        return f"{decision.previous_host} -> {decision.host}"
    return decision.host or (f"{decision.previous_host} ->" if decision.previous_host else "-")


def _format_terms(ranked: RankedHost | None) -> tuple[str, ...]:
    if ranked is None:
        return ("-",) * (len(TERMS) + 1)
    return tuple(format_utility(value) for value in (*ranked.terms.values(), ranked.total))


def _describe_losing_host(ranked: RankedHost) -> str:
    return (
        ", ".join(describe_rejection(entry) for entry in ranked.rejections)
        if ranked.rejections
        else f"rank {ranked.rank}"
    )


def snapshot(value: Snapshot, look: RenderOptions = PLAIN) -> str:
    """The table form, then load, temperature, GPU, age of the sample, links in full and interfaces of each host."""
    rows: list[Row] = [("NAME", "AGE", "LOAD", "TEMPERATURE", "GPU", "LINKS", "INTERFACES")]
    rows += [_render_device_row(name, host) for name, host in value.hosts.items() if host.ok]
    return table.snapshot(value, look) + "\n" + render_columns(rows, look, wrap={0, 5})


def bandwidth(value: Snapshot, links: Iterable[BandwidthMeasurement], look: RenderOptions = PLAIN) -> str:
    """What each link was just measured to carry, then the wide snapshot."""
    return table.render_link_bandwidths(links, look) + "\n" + snapshot(value, look)


def _render_device_row(name: str, host: HostSample) -> Row:
    device = host.device
    return (
        Cell(name, "name"),
        format_duration(host.sample_age_s) + (" profiler" if host.resident else ""),
        "-" if device.load_1m is None else f"{device.load_1m:.2f}",
        "-" if device.temperature_c is None else f"{device.temperature_c:.0f}C",
        "-" if device.gpu_share is None else f"{device.gpu_share:.0%}",
        ", ".join(_format_link_details(robot, link) for robot, link in host.links.items()) or "-",
        ", ".join(_format_interface(interface, sample) for interface, sample in device.interfaces.items())
        or "-",
    )


def _format_link_details(robot: str, link: LinkSample) -> str:
    return f"{robot} {format_rate(link.used_bytes_per_s)} of {format_rate(link.capacity_bytes_per_s)} ({link.capacity_source})"


def _format_interface(name: str, sample: InterfaceSample) -> str:
    speed = f" of {format_rate(sample.speed_bytes_per_s)}" if sample.speed_bytes_per_s else ""
    return f"{name} in {format_rate(sample.rx_bytes_per_s)} out {format_rate(sample.tx_bytes_per_s)}{speed}"
