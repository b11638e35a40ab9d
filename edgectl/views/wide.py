"""Everything the scheduler weighed: four terms of every host, losers and the rejected with what they lack."""

from collections.abc import Iterable, Sequence

from edgectl.model.assignment import RankedHost
from edgectl.model.bandwidth import Measurement
from edgectl.model.evidence import Column, Reality
from edgectl.model.experiment import Run
from edgectl.model.explanation import Explanation
from edgectl.model.plan import Plan, Step
from edgectl.model.scenario import Scenario
from edgectl.model.snapshot import HostSample, InterfaceSample, LinkSample, Snapshot
from edgectl.units import format_duration, format_rate
from edgectl.views import measured as measured_view
from edgectl.views import sections, table
from edgectl.views import simulated as simulated_view
from edgectl.views.demands import demands
from edgectl.views.explanation import text
from edgectl.views.listing import wide_more as listing_more
from edgectl.views.listing import wide_text as listing
from edgectl.views.reasons import reason, rejection
from edgectl.views.sections import STYLES, figure
from edgectl.views.text import PLAIN, Cell, Look, Row, columns
from edgectl.views.top import wide_hosts as top_hosts
from edgectl.views.top import wide_tasks as top_tasks

__all__ = ["bandwidth", "explanation", "listing", "listing_more", "measured", "plan", "simulated", "snapshot", "top_hosts", "top_tasks"]


def plan(value: Plan, look: Look = PLAIN) -> str:
    """The table form with every candidate of every task."""
    rows: list[Row] = [("", "TASK", "HOST", "CPU", "MEMORY", "NETWORK", "TASK", "TOTAL", "REASON")]
    for step in value.steps:
        rows += _rows(step)
    body = columns(rows, look, right={3, 4, 5, 6, 7}, wrap={1, 2}) if value.steps else ""
    end = sections.notes(value, look) + sections.summary(value, look)
    parts = (sections.header(value, look), body, demands(value, look), sections.expected(value, look), end)
    return "\n".join(part for part in parts if part)


def simulated(scenario: Scenario, values: Iterable[Column], real: Reality, look: Look = PLAIN) -> str:
    """The table form with every metric, each with its deviation."""
    return simulated_view.text(scenario, values, real, look, every=True)


def measured(run: Run, values: Sequence[Column], look: Look = PLAIN) -> str:
    """The table form with every metric, each with its deviation."""
    return measured_view.text(run, values, look, every=True)


def explanation(step: Step, value: Explanation, look: Look = PLAIN) -> str:
    """The table form with every change that would send the task elsewhere."""
    return text(step, value, look, every=True)


def _rows(step: Step) -> list[Row]:
    decision, style = step.decision, STYLES[step.action]
    chosen = next((ranked for ranked in decision.ranking if ranked.host == decision.host), None)
    others = sorted((ranked for ranked in decision.ranking if ranked is not chosen), key=lambda ranked: (not ranked.feasible, ranked.rank))
    first: Row = (
        Cell(step.action.symbol, style),
        Cell(step.task, "name"),
        Cell(_route(step), "bold"),
        *_terms(chosen),
        Cell(reason(step), style),
    )
    rows = [first, *map(_other_row, others)]
    left_out = ", ".join(f"{count} {rule}" for rule, count in decision.rejection_counts.items())
    return [*rows, ("", "", Cell("..", "dim"), "", "", "", "", "", Cell(f"not shown: {left_out}", "dim"))] if left_out else rows


def _other_row(ranked: RankedHost) -> Row:
    return ("", "", Cell(ranked.host, "dim"), *_terms(ranked), Cell(_loser(ranked), "dim"))


def _route(step: Step) -> str:
    decision = step.decision
    if decision.previous_host and decision.host and decision.previous_host != decision.host:
        return f"{decision.previous_host} -> {decision.host}"
    return decision.host or (f"{decision.previous_host} ->" if decision.previous_host else "-")


def _terms(ranked: RankedHost | None) -> tuple[str, ...]:
    if ranked is None:
        return ("-",) * 5
    terms = ranked.terms
    return tuple(figure(value) for value in (terms.cpu, terms.memory, terms.network, terms.task, ranked.total))


def _loser(ranked: RankedHost) -> str:
    return ", ".join(rejection(entry) for entry in ranked.rejections) if ranked.rejections else f"rank {ranked.rank}"


def snapshot(value: Snapshot, look: Look = PLAIN) -> str:
    """The table form, then load, temperature, GPU, age of the sample, links in full and interfaces of each host."""
    rows: list[Row] = [("NAME", "AGE", "LOAD", "TEMPERATURE", "GPU", "LINKS", "INTERFACES")]
    rows += [_device_row(name, host) for name, host in value.hosts.items() if host.ok]
    return table.snapshot(value, look) + "\n" + columns(rows, look, wrap={0, 5})


def bandwidth(value: Snapshot, links: Iterable[Measurement], look: Look = PLAIN) -> str:
    """What each link was just measured to carry, then the wide snapshot."""
    return table.carried(links, look) + "\n" + snapshot(value, look)


def _device_row(name: str, host: HostSample) -> Row:
    device = host.device
    return (
        Cell(name, "name"),
        format_duration(host.sample_age_s) + (" profiler" if host.resident else ""),
        "-" if device.load_1m is None else f"{device.load_1m:.2f}",
        "-" if device.temperature_c is None else f"{device.temperature_c:.0f}C",
        "-" if device.gpu_share is None else f"{device.gpu_share:.0%}",
        ", ".join(_link(robot, link) for robot, link in host.links.items()) or "-",
        ", ".join(_interface(interface, sample) for interface, sample in device.interfaces.items()) or "-",
    )


def _link(robot: str, link: LinkSample) -> str:
    return f"{robot} {format_rate(link.used_bytes_per_s)} of {format_rate(link.capacity_bytes_per_s)} ({link.capacity_source})"


def _interface(name: str, sample: InterfaceSample) -> str:
    speed = f" of {format_rate(sample.speed_bytes_per_s)}" if sample.speed_bytes_per_s else ""
    return f"{name} in {format_rate(sample.rx_bytes_per_s)} out {format_rate(sample.tx_bytes_per_s)}{speed}"
