"""The profilers that stay on the hosts, as text, as a document and as names."""

from collections.abc import Iterable, Sequence

from edgectl.formats.document import FORMAT_VERSION, Document, encode_number, encode_optional, without_none
from edgectl.model.profiler import Profiler, ProfilerState
from edgectl.units import format_bytes, format_duration
from edgectl.views.plan_sections import render_notes
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns

_PROFILER_STATE_STYLES = {
    ProfilerState.STALLED: "warn",
    ProfilerState.UNREACHABLE: "bad",
    ProfilerState.STOPPED: "dim",
    ProfilerState.NOT_RUNNING: "dim",
}


def render_profilers(values: Sequence[Profiler], look: RenderOptions = PLAIN) -> str:
    """One line per host: how long its profiler has run, how old its last sample is, what it costs (of one core) and when it would end."""
    rows: list[Row] = [("HOST", "STATE", "PID", "AGE", "EVERY", "LAST", "CPU", "MEMORY", "TTL LEFT")]
    rows += [_render_profiler_row(value) for value in values]
    return render_columns(rows, look) + render_notes(_list_profiler_notes(values), look)


def _render_profiler_row(value: Profiler) -> Row:
    state = Cell(value.state.value, _PROFILER_STATE_STYLES.get(value.state, "good"))
    if not value.state.alive:
        return (Cell(value.host, "name"), state, *("-",) * 7)
    return (
        Cell(value.host, "name"),
        state,
        str(value.pid),
        format_duration(value.age),
        format_duration(value.period),
        "-" if value.sample_age is None else format_duration(value.sample_age),
        f"{value.used_cores:.2%}",
        format_bytes(value.used_bytes),
        format_duration(value.ttl_left),
    )


def _list_profiler_notes(values: Iterable[Profiler]) -> list[str]:
    return [f"{value.host}: {note}" for value in values if (note := _format_profiler_note(value))]


def _format_profiler_note(value: Profiler) -> str:
    """What a reader should know of one host; empty where all is well."""
    if value.state is ProfilerState.UNREACHABLE:
        return value.error + (f" ({value.hint})" if value.hint else "")
    if value.state is ProfilerState.NOT_RUNNING and value.detail:
        return f"the last one is gone: {value.detail} (edgectl profilers start)"
    if not value.current:
        return "it measures other links or tasks than the files want, or is of another version (edgectl profilers start)"
    if value.period > 1.5 * value.every > 0:
        return f"samples are dear here, so they come every {format_duration(value.period)} instead of {format_duration(value.every)}"
    return ""


def encode_profilers(values: Iterable[Profiler]) -> Document:
    """As JSON types."""
    return {"format_version": FORMAT_VERSION, "profilers": [_encode_profiler(value) for value in values]}


def _encode_profiler(value: Profiler) -> Document:
    entry: Document = {"host": value.host, "state": value.state.value}
    if value.state.alive:
        entry |= {
            "pid": value.pid,
            "age_s": encode_number(value.age),
            "every_s": encode_number(value.every),
            "period_s": encode_number(value.period),
            "samples": value.samples,
            "sample_age_s": encode_optional(value.sample_age),
            "used_cores": encode_number(value.used_cores),
            "used_bytes": encode_number(value.used_bytes),
            "ttl_s": encode_number(value.ttl),
            "ttl_left_s": encode_number(value.ttl_left),
            "current": value.current,
        }
    return entry | without_none(
        detail=value.detail or None, error=value.error or None, hint=value.hint or None
    )


def render_profiler_names(values: Iterable[Profiler], _look: RenderOptions = PLAIN) -> str:
    """The hosts that have one, as profiler/HOST."""
    return "".join(f"profiler/{value.host}\n" for value in values if value.state.alive)
