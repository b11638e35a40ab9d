# SPDX-License-Identifier: Apache-2.0
"""Cycles of a watch: the line and the document of each, and the tally of the live view."""

from collections.abc import Mapping
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.formats.document import Document, without_none
from edgectl.formats.event_document import encode_event
from edgectl.model.assignment import Reason
from edgectl.model.cycle import Cycle
from edgectl.model.event import Event, EventKind
from edgectl.model.plan import Action
from edgectl.model.policy import WEIGHT_PRESETS, Weights
from edgectl.model.resource import CPU
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.snapshot import HostSample, Snapshot, find_doubled_tasks
from edgectl.rules.lost_places import describe_lost_place, list_lost_tasks
from edgectl.rules.other_managers import describe_unlisted_host, list_tasks_on_unlisted_hosts
from edgectl.units import format_instant
from edgectl.views.glossary import list_shown_weights
from edgectl.views.notes import join_words
from edgectl.views.output import ItemView
from edgectl.views.output_format import CYCLE_FORMATS
from edgectl.views.results import format_action_result
from edgectl.views.rows import encode_host_usage
from edgectl.views.sparkline import SPARKLINE_SAMPLES
from edgectl.views.text import escape_unprintable

# Lines of the past that a live view keeps.
_MAX_KEPT_LINES = 50


def list_cycle_news(before: Cycle | None, cycle: Cycle) -> list[str]:
    """What is new in ``cycle``, one text each; empty in a steady one. Lasting trouble is new once."""
    news = [
        format_event(event)
        for event in cycle.events
        if event.kind is not EventKind.PLANNED or cycle.results is None
    ]
    if not news and cycle.results is not None:
        news = [_format_cycle_action(action) for action in cycle.results.actions]
    known = set(before.warnings) if before is not None else set()
    news += [f"warning: {warning}" for warning in cycle.warnings if warning not in known]
    if cycle.busy and (before is None or not before.busy):
        news.append(f"waiting: {cycle.busy}")
    if cycle.error and (before is None or cycle.error != before.error):
        news.append(f"error: {cycle.error}")
    elif before is not None and before.error and not cycle.error:
        news.append("recovered")
    return [escape_unprintable(text) for text in news]


def format_event(event: Event) -> str:
    """``task-moved slam on edge2: from edge1``."""
    what = " on ".join(name for name in (event.task, event.host) if name)
    return " ".join(part for part in (event.kind.value, what) if part) + (
        f": {event.message}" if event.message else ""
    )


def _format_cycle_action(action: ActionResult) -> str:
    where = f" on {action.located}" if action.located else ""
    return f"{action.action} {action.task}{where} {action.outcome}: {format_action_result(action)}"


def render_cycle_line(before: Cycle | None, cycle: Cycle) -> str:
    """The line of a cycle with news or another health than the one before, else empty."""
    news = list_cycle_news(before, cycle)
    health, known = _describe_health(cycle), _describe_health(before) if before is not None else ""
    if health is not None and known is not None and health != known:
        news.append(f"health: {health or 'ok'}")
    return f"{format_instant(float(int(cycle.at)))} {'; '.join(news)}\n" if news else ""


def _describe_health(cycle: Cycle) -> str | None:
    """What is wrong with hosts and wanted tasks; empty: nothing, None: the cycle did not measure."""
    if cycle.snapshot is None:
        return None
    given_up = [
        step.task
        for step in (cycle.plan.steps if cycle.plan is not None else ())
        if step.decision.reason is Reason.GIVEN_UP
    ]
    seen = cycle.snapshot
    parts = [f"{name} does not answer" for name in seen.silent_hosts]
    parts += [f"{task} runs on {join_words(hosts)}" for task, hosts in find_doubled_tasks(seen).items()]
    parts += [f"{task} {describe_lost_place(place)}" for task, place in list_lost_tasks(seen).items()]
    unlisted = list_tasks_on_unlisted_hosts(cycle.plan)
    parts += [f"{task} {describe_unlisted_host(host)}" for task, host in unlisted.items()]
    return ", ".join([*parts, *(f"{task} is given up" for task in given_up)])


class CycleView(ItemView):
    """One cycle of a watch (docs/concepts/watch.md)."""

    kind = "cycle"
    formats = CYCLE_FORMATS

    def __init__(self, cycle: Cycle) -> None:
        self._cycle = cycle

    def item(self) -> Document:
        """The cycle as JSON types."""
        cycle = self._cycle
        hosts = cycle.snapshot.hosts if cycle.snapshot is not None else {}
        actions = cycle.results.actions if cycle.results is not None else ()
        return without_none(
            cycle=cycle.number,
            at=format_instant(cycle.at),
            duration_s=cycle.seconds,
            next_in_s=cycle.next_in,
            paused=cycle.paused,
            hosts={name: _encode_cycle_host(host) for name, host in hosts.items()},
            placements=collect_task_hosts(cycle.snapshot),
            pending=_encode_pending_steps(cycle),
            actions=[_encode_cycle_action(action) for action in actions],
            events=[encode_event(event) for event in cycle.events],
            resting=list(cycle.resting),
            warnings=list(cycle.warnings),
            lock=cycle.busy or None,
            error=cycle.error or None,
        )


def _encode_pending_steps(cycle: Cycle) -> list[Document]:
    """The changes of the plan that were not made."""
    return [
        {
            "task": step.task,
            "action": step.action.value,
            "host": step.decision.host,
            "previous_host": step.decision.previous_host,
        }
        for step in (cycle.plan.steps if cycle.plan is not None and cycle.results is None else ())
        if step.action.changes
    ]


def _encode_cycle_host(host: HostSample) -> Document:
    if not host.measured:
        return {"status": host.status.value, "error": host.error}
    return {
        "status": host.status.value,
        "sample_age_s": host.sample_age_s,
        **encode_host_usage(host),
    }


def _encode_cycle_action(action: ActionResult) -> Document:
    return without_none(
        task=action.task,
        action=action.action.value,
        outcome=action.outcome.value,
        host=action.host,
        previous_host=action.previous_host,
        located=action.located,
        downtime_s=action.downtime_s,
        gap_s=action.gap_s,
        error=action.error or None,
    )


def collect_task_hosts(snapshot: Snapshot | None) -> dict[str, str]:
    """Host of each task that is alive."""
    hosts = snapshot.hosts if snapshot is not None else {}
    return {
        name: host
        for host, sample in hosts.items()
        for name, task in sample.tasks.items()
        if task.state.alive
    }


def format_weights(weights: Weights) -> str:
    """The name of a preset, else the weights themselves."""
    used = weights.normalised()
    known = next((name for name, preset in WEIGHT_PRESETS.items() if preset.normalised() == used), None)
    return known or " ".join(f"{name}={weight:.3g}" for name, weight in list_shown_weights(used).items())


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchTally:
    """Sum of the cycles so far; bounded, however many they are.

    ``moves`` and ``moved_at`` (s since 1970): tasks that were moved, and the last time. ``steady``: cycles
    without a change. ``shares``: used share of each host's cores, oldest first, None where it did not answer.
    ``past``: (instant, text), oldest first. ``due``: start of the next cycle.
    """

    cycles: int = 0
    moves: int = 0
    moved_at: float | None = None
    steady: int = 0
    shares: Mapping[str, tuple[float | None, ...]] = field(default_factory=dict)
    past: tuple[tuple[float, str], ...] = ()
    due: float | None = None
    last: Cycle | None = None
    snapshot: Snapshot | None = None


def add_cycle_to_tally(tally: WatchTally, cycle: Cycle) -> WatchTally:
    """``tally`` with one more cycle."""
    moves = sum(
        a.action is Action.MOVE and a.outcome is Outcome.DONE
        for a in (cycle.results.actions if cycle.results else ())
    )
    ended = cycle.at + cycle.seconds
    quiet = cycle.plan is not None and not cycle.plan.changes and not cycle.error
    snapshot = cycle.snapshot or tally.snapshot
    return WatchTally(
        cycles=tally.cycles + 1,
        moves=tally.moves + moves,
        moved_at=ended if moves else tally.moved_at,
        steady=tally.steady + 1 if quiet else tally.steady if cycle.paused else 0,
        shares=_append_cpu_shares(tally, cycle.snapshot),
        past=(*tally.past, *((cycle.at, text) for text in list_cycle_news(tally.last, cycle)))[
            -_MAX_KEPT_LINES:
        ],
        due=None if cycle.next_in is None else ended + cycle.next_in,
        last=cycle,
        snapshot=snapshot,
    )


def _append_cpu_shares(
    tally: WatchTally, snapshot: Snapshot | None
) -> Mapping[str, tuple[float | None, ...]]:
    if snapshot is None:
        return tally.shares
    return {
        name: (*tally.shares.get(name, ()), _get_cpu_share(host))[-SPARKLINE_SAMPLES:]
        for name, host in snapshot.hosts.items()
    }


def _get_cpu_share(host: HostSample) -> float | None:
    return host.usage[CPU.name].share if CPU.name in host.usage else None
