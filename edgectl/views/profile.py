# SPDX-License-Identifier: Apache-2.0
"""Measured usage of tasks by class of hosts, beside the declaration."""

from collections.abc import Callable, Iterable, Iterator, Sequence

from edgectl.formats.document import Document
from edgectl.model.demand import Quantity
from edgectl.model.profile import ClassProfile, ClassService, UsagePercentiles
from edgectl.model.resource import TASK_RESOURCES, Resource
from edgectl.model.task import Task
from edgectl.rules.measured_demand import MIN_SAMPLES
from edgectl.units import format_duration
from edgectl.views.demands import encode_declared_demand
from edgectl.views.glossary import head
from edgectl.views.output import ListView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, is_within_width, render_columns

_HEAD = head("task", "class", "resource", "declared", "p50", "p95", "max", "samples", "span_s", "host_names")
_NO_SAMPLES = "no samples yet; let the task run while edgectl probes or watches"


class ProfileView(ListView):
    """Measured usage by task and class of hosts."""

    kind = "profile"
    formats = ITEM_FORMATS

    def __init__(self, profiles: Iterable[ClassProfile]) -> None:
        self._profiles = list(profiles)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per task, class and resource; a narrow terminal leaves out span and hosts."""
        if not self._profiles:
            return ""
        rows = [_HEAD, *(row for value in self._profiles for row in _render_profile_rows(value))]
        fitting = rows if is_within_width(rows, look) else [row[:-2] for row in rows]
        return render_columns(fitting, look, right={3, 4, 5, 6, 7, 8}, wrap={1, 3})

    def notes(self) -> Sequence[str]:
        """That there are none."""
        return [] if self._profiles else [_NO_SAMPLES]

    def items(self) -> Sequence[Document]:
        """The profiles as JSON types."""
        return [_encode_class_profile(value) for value in self._profiles]


def _render_profile_rows(value: ClassProfile) -> Iterator[Row]:
    found = value.profile
    samples = Cell(str(found.samples)) if value.enough else Cell(f"{found.samples} of {MIN_SAMPLES}", "warn")
    head: tuple[Cell, ...] = (Cell(value.task.name, "name"), Cell(value.kind))
    tail = (samples, format_duration(found.span_s), ", ".join(value.hosts))
    for resource, spread in _list_resource_spreads(value):
        show = resource.unit.format
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
        for resource in TASK_RESOURCES
        if value.task.robots or not resource.per_link
    ]


def _format_declared_demand(quantity: Quantity | None, show: Callable[[float], str]) -> str:
    """The declaration of the file: an amount or a share, and whether it counts only until measured."""
    if quantity is None:
        return "-"
    amount = f"{quantity.value * 100:.4g}%" if quantity.relative else show(quantity.value)
    if not quantity.measured:
        return amount
    return f"until: {amount}" if quantity.value else "measured"


def _encode_class_profile(value: ClassProfile) -> Document:
    return {
        "task": value.task.name,
        "class": value.kind,
        "host_names": list(value.hosts),
        "samples": value.profile.samples,
        "span_s": value.profile.span_s,
        "enough": value.enough,
        "resources": {
            resource.name: {
                "declared": encode_declared_demand(value.task.demand[resource.name]),
                **_encode_spread(spread),
            }
            for resource, spread in _list_resource_spreads(value)
        },
    }


def _encode_spread(spread: UsagePercentiles) -> Document:
    return {
        "p50": spread.p50,
        "p95": spread.p95,
        "max": spread.most,
    }


def list_service_lines(tasks: Iterable[Task], metric: str, found: Sequence[ClassService]) -> list[str]:
    """Service times by class of hosts, as a line of the task file; or that there are none."""
    lines = []
    for task in tasks:
        own = [each for each in found if each.task is task]
        times = ", ".join(
            f"{each.kind}: {{p50: {_format_ms(each.service.p50)}, p95: {_format_ms(each.service.p95)}}}"
            for each in own
        )
        samples = sum(each.samples for each in own)
        lines.append(
            f"{task.name}  service_time: {{{times}}}  # {samples} samples of {metric} at low load"
            if own
            else f"{task.name} has no sample of {metric} while its host was nearly idle"
        )
    return lines


def _format_ms(seconds: float) -> str:
    return f"{1000.0 * seconds:.3g}ms"
