"""What tasks were measured to use: median, p95 and most of each resource, beside what is declared."""

from collections.abc import Callable, Iterable, Iterator

from edgectl.formats.base import FORMAT_VERSION, Document, number
from edgectl.model.assignment import Resource
from edgectl.model.demand import ENOUGH_SAMPLES
from edgectl.model.profile import ClassProfile, Spread
from edgectl.model.task import Quantity
from edgectl.units import format_duration
from edgectl.views.demands import FORMATS, NAMES, stated
from edgectl.views.text import PLAIN, Cell, Look, Row, columns, fits

_NONE = "No samples yet. Let the task run while edgectl probes or watches.\n"


def text(values: Iterable[ClassProfile], look: Look = PLAIN) -> str:
    """One line for each task, class of hosts and resource; without span and hosts where the terminal is too narrow for them."""
    rows: list[Row] = [("TASK", "CLASS", "RESOURCE", "DECLARED", "P50", "P95", "MAX", "SAMPLES", "SPAN", "HOSTS")]
    for value in values:
        rows += _rows(value)
    fitting = rows if fits(rows, look) else [row[:-2] for row in rows]  # the class says enough of the hosts, n of the span
    return columns(fitting, look, right={3, 4, 5, 6, 7, 8}, wrap={0, 1, 3}) if len(rows) > 1 else _NONE


def _rows(value: ClassProfile) -> Iterator[Row]:
    found = value.profile
    samples = Cell(str(found.samples)) if value.enough else Cell(f"{found.samples} of {ENOUGH_SAMPLES}", "warn")
    head: tuple[Cell, ...] = (Cell(value.task.name, "name"), Cell(value.kind))
    tail = (samples, format_duration(found.span_s), ", ".join(value.hosts))
    for resource, spread in _spreads(value):
        show = FORMATS[resource]
        figures = (show(spread.p50), Cell(show(spread.p95), "bold"), show(spread.most))
        yield (*head, NAMES[resource], _declared(_stated(value, resource), show), *figures, *tail)
        head, tail = (Cell(""), Cell("")), (Cell(""), "", "")


def _spreads(value: ClassProfile) -> list[tuple[Resource, Spread]]:
    found = [(Resource.CPU, value.profile.cpu), (Resource.MEMORY, value.profile.memory)]
    return [*found, (Resource.NETWORK, value.profile.throughput)] if value.task.robots else found


def _stated(value: ClassProfile, resource: Resource) -> Quantity | None:
    stated: Quantity | None = getattr(value.task.demand, NAMES[resource])
    return stated


def _declared(quantity: Quantity | None, show: Callable[[float], str]) -> str:
    """As the file has it: nothing, an amount, a share; and whether it only counts until it is measured."""
    if quantity is None:
        return "-"
    amount = f"{quantity.value * 100:.4g}%" if quantity.relative else show(quantity.value)
    if not quantity.measured:
        return amount
    return f"until: {amount}" if quantity.value else "measured"


def document(values: Iterable[ClassProfile]) -> Document:
    """The same as JSON types, in cores, bytes and bytes/s."""
    return {"format_version": FORMAT_VERSION, "profiles": [_profile(value) for value in values]}


def _profile(value: ClassProfile) -> Document:
    return {
        "task": value.task.name,
        "class": value.kind,
        "hosts": list(value.hosts),
        "samples": value.profile.samples,
        "span_s": number(value.profile.span_s),
        "enough": value.enough,
        "demand": {
            NAMES[resource]: {"declared": stated(_stated(value, resource)), **_figures(spread)} for resource, spread in _spreads(value)
        },
    }


def _figures(spread: Spread) -> Document:
    return {"p50": number(spread.p50), "p95": number(spread.p95), "max": number(spread.most)}
