"""Demands of a plan and their sources: declared, or measured from a number of samples."""

from collections.abc import Iterable, Sequence

from edgectl.formats.document import Document
from edgectl.model.assignment import DemandSource, DemandSpread, ResourceDemand
from edgectl.model.plan import Plan
from edgectl.model.resource import RESOURCES
from edgectl.model.task import Quantity
from edgectl.rules.measured_demand import MIN_SAMPLES
from edgectl.views.glossary import head
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns

_SOURCE_STYLES = {
    DemandSource.DECLARED: "",
    DemandSource.MEASURED: "good",
    DemandSource.MEASURED_ELSEWHERE: "warn",
    DemandSource.NONE: "warn",
}
_MEASURED_SOURCES = (DemandSource.MEASURED, DemandSource.MEASURED_ELSEWHERE)
_MAX_LISTED = 4


def render_demands(value: Plan, look: RenderOptions = PLAIN) -> str:
    """Every demand that was charged, with its source; a measured one also on the other hosts."""
    columns = (f"{resource.name}.demand_{resource.unit.name}" for resource in RESOURCES)
    rows = [head("task", "host", *columns)]
    for step in value.steps:
        decision = step.decision
        rows += (
            [_render_demand_row(step.task, decision.host or decision.nearest or "-", decision.demand)]
            if decision.demand
            else []
        )
        rows += [
            _render_demand_row("", ranked.host, ranked.demand)
            for ranked in decision.ranking
            if ranked.demand and ranked.host != decision.host
        ]
    return (
        "Demands:\n" + render_columns(rows, look, wrap=set(range(2, 1 + len(RESOURCES))))
        if len(rows) > 1
        else ""
    )


def _render_demand_row(task: str, host: str, demand: tuple[ResourceDemand, ...]) -> Row:
    found = {rho.resource: rho for rho in demand}
    return (Cell(task, "name"), host, *(_render_demand_cell(found.get(resource)) for resource in RESOURCES))


def _render_demand_cell(rho: ResourceDemand | None) -> Cell:
    return (
        Cell("-")
        if rho is None or (rho.resource.declared_only and not rho.value)
        else Cell(
            f"{rho.resource.unit.format_small(rho.value)} {format_demand_source(rho)}",
            _SOURCE_STYLES[rho.source],
        )
    )


def format_demand_source(rho: ResourceDemand) -> str:
    """``declared``, ``measured n=412``, or the samples so far."""
    if rho.samples is None:
        return rho.source.value
    if rho.source is DemandSource.MEASURED:
        return f"measured n={rho.samples}"
    return rho.source.value + (
        f" ({rho.samples} of {MIN_SAMPLES} samples)" if 0 < rho.samples < MIN_SAMPLES else ""
    )


def list_demand_notes(value: Plan) -> list[str]:
    """Notes on demands that are measured, unknown, or different amounts on different hosts."""
    known = [(step.task, rho) for step in value.steps for rho in step.decision.demand]
    measured, unknown = (
        _format_tasks_by_source(known, _MEASURED_SOURCES),
        _format_tasks_by_source(known, (DemandSource.NONE,)),
    )
    lines = [f"demand measured (p95): {_join_first_items(measured)}"] if measured else []
    lines += [f"demand unknown, 0 until it is measured: {_join_first_items(unknown)}"] if unknown else []
    return lines + list_demand_spread_notes(value.demand_spreads)


def encode_declared_demand(quantity: Quantity | None) -> Document | None:
    """A demand of a task file as JSON types; null where it is left out."""
    if quantity is None:
        return None
    return {"amount": quantity.value, "relative": quantity.relative, "until_measured": quantity.measured}


def list_demand_spread_notes(found: Sequence[DemandSpread]) -> list[str]:
    """One line for all percent demands that mean different amounts."""
    return (
        [
            "percent demands mean different amounts on unlike hosts: "
            + _join_first_items([_describe_demand_spread(each) for each in found])
        ]
        if found
        else []
    )


def _format_tasks_by_source(
    known: Iterable[tuple[str, ResourceDemand]], sources: Iterable[DemandSource]
) -> list[str]:
    """Each task with those of its resources that have such a source."""
    found: dict[str, list[str]] = {}
    counts: dict[str, int] = {}
    for task, rho in known:
        if rho.source in sources:
            found.setdefault(task, []).append(rho.resource.demand_key)
            counts[task] = rho.samples or 0
    return [
        f"{task} {' and '.join(names)}" + (f" (n={counts[task]})" if counts[task] else "")
        for task, names in found.items()
    ]


def _describe_demand_spread(found: DemandSpread) -> str:
    unit = found.resource.unit
    show = unit.format_small
    small, large = found.hosts
    amounts = f"{show(found.least)}{unit.word} on {small}, {show(found.most)} on {large}"
    return f"{found.task} {found.resource.demand_key} {found.share * 100:.4g}% is {amounts}"


def _join_first_items(items: list[str]) -> str:
    """The first few; the others stand in the wide form."""
    return "; ".join(items[:_MAX_LISTED]) + (
        f"; and {len(items) - _MAX_LISTED} more" if len(items) > _MAX_LISTED else ""
    )
