"""Where the demands of a plan come from: declared, or measured from how many samples."""

from collections.abc import Callable, Iterable, Sequence

from edgectl.formats.base import Document, number
from edgectl.model.assignment import DemandSource, Resource, Rho, Uneven
from edgectl.model.demand import ENOUGH_SAMPLES
from edgectl.model.plan import Plan
from edgectl.model.task import Quantity
from edgectl.units import format_bytes, format_cores, format_rate
from edgectl.views.text import PLAIN, Cell, Look, Row, columns

# As the task files call them.
NAMES = {Resource.CPU: "cpu", Resource.MEMORY: "memory", Resource.NETWORK: "throughput"}


def _cores(value: float) -> str:
    """Small demands are told from none."""
    return f"{value:.3f}" if 0 < value < 0.1 else format_cores(value)


FORMATS: dict[Resource, Callable[[float], str]] = {
    Resource.CPU: _cores, Resource.MEMORY: format_bytes, Resource.NETWORK: format_rate,
}  # fmt: skip
_STYLES = {DemandSource.DECLARED: "", DemandSource.MEASURED: "good", DemandSource.MEASURED_ELSEWHERE: "warn", DemandSource.NONE: "warn"}
_MEASURED = (DemandSource.MEASURED, DemandSource.MEASURED_ELSEWHERE)
_MOST = 4


def demands(value: Plan, look: Look = PLAIN) -> str:
    """Every demand that was charged, with its source; of a measured one also what it would be on the other hosts."""
    rows: list[Row] = [("TASK", "HOST", "CPU", "MEMORY", "THROUGHPUT")]
    for step in value.steps:
        decision = step.decision
        rows += [_row(step.task, decision.host or decision.nearest or "-", decision.demand)] if decision.demand else []
        rows += [_row("", ranked.host, ranked.demand) for ranked in decision.ranking if ranked.demand and ranked.host != decision.host]
    return "Demands:\n" + columns(rows, look, wrap={0, 1, 2, 3}) if len(rows) > 1 else ""


def _row(task: str, host: str, demand: tuple[Rho, ...]) -> Row:
    found = {rho.resource: rho for rho in demand}
    return (Cell(task, "name"), host, *(_cell(found.get(resource)) for resource in Resource))


def _cell(rho: Rho | None) -> Cell:
    return Cell("-") if rho is None else Cell(f"{FORMATS[rho.resource](rho.value)} {source(rho)}", _STYLES[rho.source])


def source(rho: Rho) -> str:
    """``declared``, ``measured n=412``, or how far the measuring is."""
    if rho.samples is None:
        return rho.source.value
    if rho.source is DemandSource.MEASURED:
        return f"measured n={rho.samples}"
    return rho.source.value + (f" ({rho.samples} of {ENOUGH_SAMPLES} samples)" if 0 < rho.samples < ENOUGH_SAMPLES else "")


def demand_notes(value: Plan) -> list[str]:
    """What a reader of the table should know of the demands: which are measured, which are unknown, which mean little."""
    known = [(step.task, rho) for step in value.steps for rho in step.decision.demand]
    measured, unknown = _tasks(known, _MEASURED), _tasks(known, (DemandSource.NONE,))
    lines = [f"demand measured (p95): {_some(measured)}"] if measured else []
    lines += [f"demand unknown, 0 until it is measured: {_some(unknown)}"] if unknown else []
    return lines + uneven_notes(value.uneven)


def stated(quantity: Quantity | None) -> Document | None:
    """A demand of a task file as JSON types; null where it is left out."""
    if quantity is None:
        return None
    return {"value": number(quantity.value), "relative": quantity.relative, "until_measured": quantity.measured}


def uneven_notes(found: Sequence[Uneven]) -> list[str]:
    """One line for all percent demands that mean different amounts."""
    return [f"percent demands mean different amounts on unlike hosts: {_some([_uneven(each) for each in found])}"] if found else []


def _tasks(known: Iterable[tuple[str, Rho]], sources: Iterable[DemandSource]) -> list[str]:
    """Each task with those of its resources that have such a source."""
    found: dict[str, list[str]] = {}
    counts: dict[str, int] = {}
    for task, rho in known:
        if rho.source in sources:
            found.setdefault(task, []).append(NAMES[rho.resource])
            counts[task] = rho.samples or 0
    return [f"{task} {' and '.join(names)}" + (f" (n={counts[task]})" if counts[task] else "") for task, names in found.items()]


def _uneven(found: Uneven) -> str:
    show = FORMATS[found.resource]
    unit = " cores" if found.resource is Resource.CPU else ""
    small, large = found.hosts
    amounts = f"{show(found.least)}{unit} on {small}, {show(found.most)} on {large}"
    return f"{found.task} {NAMES[found.resource]} {found.share * 100:.4g}% is {amounts}"


def _some(items: list[str]) -> str:
    """The first few; the others stand in the wide form."""
    return "; ".join(items[:_MOST]) + (f"; and {len(items) - _MOST} more" if len(items) > _MOST else "")
