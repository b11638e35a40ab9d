# SPDX-License-Identifier: Apache-2.0
"""Events of a mission and the recovery after them: a row per scheme, a column per kind; and as JSON types."""

from collections.abc import Iterable, Iterator, Sequence

from edgectl.experiments.model.comparison import EventResult, RecoveryResult, SchemeResult
from edgectl.experiments.model.mission_event import MissionEvent
from edgectl.experiments.views.scheme_table import render_scheme_name, render_scheme_table
from edgectl.formats.document import Document, encode_optional
from edgectl.views.text import RenderOptions, Row, escape_unprintable


def build_recovery_rows(results: Sequence[SchemeResult]) -> Sequence[Row]:
    """The heading and a row per scheme: mean recovery in s by kind of event. Empty without events."""
    kinds = list(dict.fromkeys(kind for result in results for kind in result.recoveries))
    if not kinds:
        return []
    rows: list[Row] = [("RECOVERY s", *(kind.upper() for kind in kinds))]
    for result in results:
        cells = [_format_recovery(result.recoveries.get(kind)) for kind in kinds]
        rows.append((render_scheme_name(result), *cells))
    return rows


def _format_recovery(found: RecoveryResult | None) -> str:
    if found is None:
        return "-"
    if found.recovery is None:
        return "not recovered"
    spread = f"±{found.recovery.half_ci95:.1f}" if found.recovery.count > 1 else ""
    missing = f" ({found.not_recovered} of {found.count} not)" if found.not_recovered else ""
    return f"{found.recovery.mean:.1f}{spread}{missing}"


def render_recovery_table(results: Sequence[SchemeResult], look: RenderOptions) -> str:
    """The table with an empty line before it; "" without events."""
    rows = build_recovery_rows(results)
    return f"\n{render_scheme_table(rows, look)}" if rows else ""


def describe_recovery(results: Sequence[SchemeResult], events: Iterable[MissionEvent]) -> Iterator[str]:
    """The notes on the table of recovery, and on ``events`` that failed or did not happen."""
    if any(result.recoveries for result in results):
        yield (
            "Recovery: time after an event until its tasks are as good as before, mean over runs ± half of "
            "the 95 % interval, by kind of event; not: not recovered before the next event or the end."
        )
    for result in results:
        for event in result.events:
            if event.failed:
                yield escape_unprintable(
                    f"{result.scheme.name}: event {event.event} failed {event.failed} of "
                    f"{event.recoveries.count} times"
                )

    yield from map(escape_unprintable, filter(None, (_describe_left_out(each, results) for each in events)))


def _describe_left_out(event: MissionEvent, results: Sequence[SchemeResult]) -> str:
    """In which runs the event did not happen; "" where it did in all."""
    missing = {result.scheme.name: result.runs - _count_runs(event, result) for result in results}
    runs = {result.scheme.name: result.runs for result in results}
    where = ", ".join(f"{name} {count} of {runs[name]}" for name, count in missing.items() if count)
    return f"event {event.name} did not happen, since the mission ended first; runs: {where}" if where else ""


def _count_runs(event: MissionEvent, result: SchemeResult) -> int:
    return next((found.runs for found in result.events if found.event == event.name), 0)


def encode_events(result: SchemeResult, events: Iterable[MissionEvent]) -> Document:
    """The events of a scheme, those of ``events`` that never happened last, and the recovery by kind, as JSON
    types.
    """
    happened = {found.event for found in result.events}
    never = [_build_never(each) for each in events if each.name not in happened and result.runs]
    return {
        "mission_events": [_encode_event(event) for event in (*result.events, *never)],
        "recoveries": {kind: _encode_recovery(found) for kind, found in result.recoveries.items()},
    }


def _build_never(event: MissionEvent) -> EventResult:
    nothing = RecoveryResult(count=0, not_recovered=0, recovery=None)
    return EventResult(
        event=event.name,
        kind=event.kind or event.change,
        subject=event.subject,
        runs=0,
        failed=0,
        at=None,
        recoveries=nothing,
    )


def _encode_event(event: EventResult) -> Document:
    return {
        "event_name": event.event,
        "kind": event.kind,
        "subject": event.subject,
        "run_count": event.runs,
        "begin_s": encode_optional(event.at.mean if event.at else None),
        "failures": event.failed,
        **_encode_recovery(event.recoveries),
    }


def _encode_recovery(found: RecoveryResult) -> Document:
    """The mean has no interval where a single run has one."""
    estimate = found.recovery
    several = estimate is not None and estimate.count > 1
    return {
        "occurrences": found.count,
        "not_recovered": found.not_recovered,
        "recovery_s": encode_optional(estimate.mean if estimate else None),
        "recovery_half_ci95_s": encode_optional(estimate.half_ci95 if estimate and several else None),
    }
