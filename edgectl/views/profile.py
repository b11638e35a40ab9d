"""What tasks were measured to use: median, p95 and most of each resource, beside what is declared."""

from collections.abc import Callable, Iterable, Iterator

from edgectl.formats.document import FORMAT_VERSION, Document, encode_number
from edgectl.model.measured_demand import MIN_SAMPLES
from edgectl.model.profile import ClassProfile, UsagePercentiles
from edgectl.model.resource import RESOURCES, Resource
from edgectl.model.task import Quantity
from edgectl.units import format_duration
from edgectl.views.demands import encode_declared_demand
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, is_within_width, render_columns

_NO_SAMPLES = "No samples yet. Let the task run while edgectl probes or watches.\n"


def render_profiles(values: Iterable[ClassProfile], look: RenderOptions = PLAIN) -> str:
    """One line for each task, class of hosts and resource; without span and hosts where the terminal is too narrow for them."""
    rows: list[Row] = [
        ("TASK", "CLASS", "RESOURCE", "DECLARED", "P50", "P95", "MAX", "SAMPLES", "SPAN", "HOSTS")
    ]
    for value in values:
        rows += _render_profile_rows(value)
    fitting = (
        rows if is_within_width(rows, look) else [row[:-2] for row in rows]
    )  # the class says enough of the hosts, n of the span
    return (
        render_columns(fitting, look, right={3, 4, 5, 6, 7, 8}, wrap={0, 1, 3})
        if len(rows) > 1
        else _NO_SAMPLES
    )


def _render_profile_rows(value: ClassProfile) -> Iterator[Row]:
    found = value.profile
    samples = Cell(str(found.samples)) if value.enough else Cell(f"{found.samples} of {MIN_SAMPLES}", "warn")
    head: tuple[Cell, ...] = (Cell(value.task.name, "name"), Cell(value.kind))
    tail = (samples, format_duration(found.span_s), ", ".join(value.hosts))
    for resource, spread in _list_resource_spreads(value):
        show = resource.unit.format_small
        figures = (show(spread.p50), Cell(show(spread.p95), "bold"), show(spread.most))
        yield (
            *head,
            resource.demand_key,
            _format_declared_demand(value.task.demand[resource.name], show),
            *figures,
            *tail,
        )
        head, tail = (Cell(""), Cell("")), (Cell(""), "", "")


def _list_resource_spreads(value: ClassProfile) -> list[tuple[Resource, UsagePercentiles]]:
    return [
        (resource, value.profile.used[resource.name])
        for resource in RESOURCES
        if value.task.robots or not resource.per_link
    ]


def _format_declared_demand(quantity: Quantity | None, show: Callable[[float], str]) -> str:
    """As the file has it: nothing, an amount, a share; and whether it only counts until it is measured."""
    if quantity is None:
        return "-"
    amount = f"{quantity.value * 100:.4g}%" if quantity.relative else show(quantity.value)
    if not quantity.measured:
        return amount
    return f"until: {amount}" if quantity.value else "measured"


def encode_profiles(values: Iterable[ClassProfile]) -> Document:
    """The same as JSON types, in cores, bytes and bytes/s."""
    return {"format_version": FORMAT_VERSION, "profiles": [_encode_class_profile(value) for value in values]}


def _encode_class_profile(value: ClassProfile) -> Document:
    return {
        "task": value.task.name,
        "class": value.kind,
        "hosts": list(value.hosts),
        "samples": value.profile.samples,
        "span_s": encode_number(value.profile.span_s),
        "enough": value.enough,
        "demand": {
            resource.demand_key: {
                "declared": encode_declared_demand(value.task.demand[resource.name]),
                **_encode_spread(spread),
            }
            for resource, spread in _list_resource_spreads(value)
        },
    }


def _encode_spread(spread: UsagePercentiles) -> Document:
    return {
        "p50": encode_number(spread.p50),
        "p95": encode_number(spread.p95),
        "max": encode_number(spread.most),
    }
