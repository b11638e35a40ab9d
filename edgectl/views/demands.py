# SPDX-License-Identifier: Apache-2.0
"""Demands of a plan and their sources: declared, or measured from a number of samples."""

from collections.abc import Iterable, Iterator, Sequence

from edgectl.formats.document import Document
from edgectl.model.assignment import DemandSource, DemandSpread, ResourceDemand
from edgectl.model.demand import Quantity
from edgectl.model.plan import Plan
from edgectl.model.resource import MEASURED_HOST_RESOURCES, RESOURCES, TASK_RESOURCES
from edgectl.model.snapshot import TaskSample
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
_AMOUNTS = ("NOW", "RESERVED", "DEMAND")


def render_demands(value: Plan, look: RenderOptions = PLAIN) -> str:
    """What every task reserves, the source of its demand and what it uses now; a measured demand also on the
    other hosts.
    """
    columns = (f"{resource.name}.demand_{resource.unit.name}" for resource in RESOURCES)
    rows = [head("task", "host", *columns)]
    for step in value.steps:
        decision = step.decision
        rows += (
            [
                _render_demand_row(
                    step.task,
                    decision.host or decision.nearest or "-",
                    decision.demand,
                    _find_run(value, step.task, decision.previous_host),
                )
            ]
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


def _find_run(value: Plan, task: str, host: str | None) -> TaskSample | None:
    """The run of ``task`` on its present host, if it lives."""
    sample = value.snapshot.hosts.get(host or "")
    run = sample.tasks.get(task) if sample is not None else None
    return run if run is not None and run.state.alive else None


def _render_demand_row(
    task: str, host: str, demand: Sequence[ResourceDemand], run: TaskSample | None = None
) -> Row:
    found = {rho.resource: rho for rho in demand}
    return (
        Cell(task, "name"),
        host,
        *(_render_demand_cell(found.get(resource), run) for resource in RESOURCES),
    )


def _render_demand_cell(rho: ResourceDemand | None, run: TaskSample | None) -> Cell:
    if rho is None or (rho.resource.optional and not rho.value):
        return Cell("-")
    now = _format_usage_now(rho, run)
    style = "bad" if rho.demanded is not None else _SOURCE_STYLES[rho.source]
    return Cell(f"{_format_demand(rho)}{now}", style)


def _format_demand(rho: ResourceDemand) -> str:
    """``0.40 declared``; ``1.20 in use, 0.30 declared`` where a task uses more than its demand."""
    show = rho.resource.unit.format
    if rho.demanded is None:
        return f"{show(rho.value)} {format_demand_source(rho)}"
    return f"{show(rho.value)} in use, {show(rho.demanded)} {format_demand_source(rho)}"


def _format_usage_now(rho: ResourceDemand, run: TaskSample | None) -> str:
    """``, now 0.12``: what the task uses of its reservation; of the network over all its links."""
    if run is None or rho.demanded is not None or rho.resource not in TASK_RESOURCES:
        return ""
    return f", now {rho.resource.unit.format(run.used[rho.resource.name])}"


def render_reservations(value: Plan, look: RenderOptions = PLAIN) -> str:
    """By host: its load now, and what its tasks reserve and demand after the plan."""
    rows: list[Row] = [
        (
            *head("host"),
            *(
                Cell(f"{resource.title} {word}", "head")
                for resource in MEASURED_HOST_RESOURCES
                for word in _AMOUNTS
            ),
        )
    ]
    for name in value.expected:
        here = [step.decision.demand for step in value.steps if step.decision.host == name]
        rows.append((Cell(name, "name"), *_list_reservation_cells(value, name, here)))
    title = "Load now, and what the tasks of this plan reserve and demand:\n"
    return title + render_columns(rows, look) if value.expected else ""


def _list_reservation_cells(
    value: Plan, host: str, demands: Sequence[Sequence[ResourceDemand]]
) -> Iterator[str]:
    sample = value.snapshot.hosts.get(host)
    for resource in MEASURED_HOST_RESOURCES:
        show = resource.unit.format
        found = [rho for demand in demands for rho in demand if rho.resource == resource]
        known = sample is not None and resource.name in sample.usage
        yield show(sample.usage[resource.name].used) if sample is not None and known else "-"
        yield show(sum(rho.value for rho in found))
        yield show(sum(rho.value if rho.demanded is None else rho.demanded for rho in found))


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
    show = found.resource.unit.format_in_text
    small, large = found.hosts
    amounts = f"{show(found.least)} on {small}, {show(found.most)} on {large}"
    return f"{found.task} {found.resource.demand_key} {found.share * 100:.4g}% is {amounts}"


def _join_first_items(items: list[str]) -> str:
    """The first few; the others stand in the wide form."""
    return "; ".join(items[:_MAX_LISTED]) + (
        f"; and {len(items) - _MAX_LISTED} more" if len(items) > _MAX_LISTED else ""
    )
