# SPDX-License-Identifier: Apache-2.0
"""Resident profilers of the hosts."""

from collections.abc import Iterable, Sequence

from edgectl.formats.document import Document, without_none
from edgectl.model.profiler import Profiler, ProfilerState
from edgectl.model.resource import MEASURED_HOST_RESOURCES
from edgectl.units import format_duration
from edgectl.views.glossary import head
from edgectl.views.output import ListView
from edgectl.views.output_format import NAMED_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns

_PROFILER_STATE_STYLES = {
    ProfilerState.STALLED: "warn",
    ProfilerState.UNREACHABLE: "bad",
    ProfilerState.STOPPED: "dim",
    ProfilerState.NOT_RUNNING: "dim",
}
_HEAD = head(
    "host", "state", "pid", "age_s", "every_s", "sample_age_s",
    *(f"{each.name}.{each.used_key}" for each in MEASURED_HOST_RESOURCES), "ttl_left_s",
)  # fmt: skip


class ProfilersView(ListView):
    """The profiler of each host: its age, its last sample, its cost and the time that it has left."""

    kind = "profiler"
    formats = NAMED_FORMATS

    def __init__(self, profilers: Iterable[Profiler]) -> None:
        self._profilers = list(profilers)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per host."""
        rows = [_HEAD, *map(_render_profiler_row, self._profilers)]
        return render_columns(rows, look, right=range(2, len(_HEAD)))

    def items(self) -> Sequence[Document]:
        """The profilers as JSON types."""
        return [_encode_profiler(value) for value in self._profilers]

    def warnings(self) -> Sequence[str]:
        """Remarks on single hosts."""
        return _list_profiler_notes(self._profilers)

    def names(self) -> Sequence[str]:
        """The hosts that have one, as profiler/HOST."""
        return [f"profiler/{value.host}" for value in self._profilers if value.state.alive]


def _render_profiler_row(value: Profiler) -> Row:
    state = Cell(value.state.value, _PROFILER_STATE_STYLES.get(value.state, "good"))
    if not value.state.alive:
        return (Cell(value.host, "name"), state, *("-",) * (len(_HEAD) - 2))
    return (
        Cell(value.host, "name"),
        state,
        str(value.pid),
        format_duration(value.age),
        format_duration(value.period),
        "-" if value.sample_age is None else format_duration(value.sample_age),
        *(each.unit.format(value.used[each.name]) for each in MEASURED_HOST_RESOURCES),
        format_duration(value.ttl_left),
    )


def _list_profiler_notes(values: Iterable[Profiler]) -> list[str]:
    return [f"{value.host}: {note}" for value in values if (note := _format_profiler_note(value))]


def _format_profiler_note(value: Profiler) -> str:
    """The remark on one host; empty where all is well."""
    if value.state is ProfilerState.UNREACHABLE:
        return value.error + (f" ({value.hint})" if value.hint else "")
    if value.state is ProfilerState.NOT_RUNNING and value.detail:
        return f"the last profiler ended: {value.detail} (edgectl profilers start)"
    if not value.current:
        return (
            "it measures other links or tasks than the files ask for, or has another version "
            "(edgectl profilers start)"
        )
    if value.period > 1.5 * value.every > 0:
        period, every = format_duration(value.period), format_duration(value.every)
        return f"samples are expensive here: every {period} instead of {every}"
    return ""


def _encode_profiler(value: Profiler) -> Document:
    entry: Document = {"host": value.host, "state": value.state.value}
    if value.state.alive:
        entry |= {
            "pid": value.pid,
            "age_s": value.age,
            "every_s": value.every,
            "period_s": value.period,
            "samples": value.samples,
            "sample_age_s": value.sample_age,
            **{each.name: {each.used_key: value.used[each.name]} for each in MEASURED_HOST_RESOURCES},
            "ttl_s": value.ttl,
            "ttl_left_s": value.ttl_left,
            "current": value.current,
        }
    return entry | without_none(
        detail=value.detail or None, error=value.error or None, hint=value.hint or None
    )
