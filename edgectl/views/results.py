# SPDX-License-Identifier: Apache-2.0
"""The results of an apply, a stop, a restart, a rollback or a drain: each action with its phases."""

from collections.abc import Iterable, Sequence

from edgectl.formats.document import Document, without_none
from edgectl.model.result import ActionResult, CarriedState, Outcome, PhaseResult, Results, StandbyResult
from edgectl.units import format_duration
from edgectl.views.output import ItemView
from edgectl.views.output_format import NAMED_FORMATS
from edgectl.views.plan_sections import ACTION_STYLES
from edgectl.views.text import (
    PLAIN,
    Cell,
    RenderOptions,
    Row,
    escape_unprintable,
    render_columns,
    style_text,
)

_OUTCOME_STYLES = {
    Outcome.DONE: "good",
    Outcome.FAILED: "bad",
    Outcome.DEFERRED: "warn",
    Outcome.SKIPPED: "dim",
    Outcome.UNREACHABLE: "bad",
}


class ResultsView(ItemView):
    """The results of one plan; None: there was nothing to do."""

    kind = "result"
    formats = NAMED_FORMATS

    def __init__(self, results: Results | None, *, fleet: str = "") -> None:
        self._results, self._fleet = results, fleet

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The outcome of each action, a line that counts, and hints."""
        return "" if self._results is None else render_results(self._results, look, self._fleet)

    def item(self) -> Document:
        """The results as JSON types."""
        if self._results is None:
            return {"revision": None, "done": True, "interrupted": False, "actions": []}
        return _encode_results(self._results)

    def names(self) -> Sequence[str]:
        """The tasks that were changed."""
        return [f"task/{action.task}" for action in self._results.actions] if self._results else []


class DrainView(ItemView):
    """The passes of a drain, and the tasks that are left on its hosts as (task, host)."""

    kind = "drain"
    formats = NAMED_FORMATS

    def __init__(
        self, passes: Sequence[Results], left: Iterable[tuple[str, str]], *, done: bool, fleet: str = ""
    ) -> None:
        self._passes, self._left, self._done, self._fleet = passes, tuple(left), done, fleet

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Every pass."""
        return "\n".join(render_results(each, look, self._fleet) for each in self._passes)

    def item(self) -> Document:
        """The passes in order, and the rest."""
        return {
            "done": self._done,
            "left": [{"task": task, "host": host} for task, host in self._left],
            "passes": [_encode_results(each) for each in self._passes],
        }

    def names(self) -> Sequence[str]:
        """The tasks that were changed."""
        return [f"task/{action.task}" for each in self._passes for action in each.actions]


def render_results(value: Results, look: RenderOptions, fleet: str = "") -> str:
    """The outcome of each action of one plan."""
    done = sum(action.outcome is Outcome.DONE for action in value.actions)
    took = format_duration(value.seconds)
    where = f" of fleet {fleet}" if fleet else ""
    text = f"Applied {done} of {len(value.actions)} in {took}. Revision {value.revision}{where}."
    stopped = " Interrupted." if value.interrupted else ""
    return (
        render_actions(value.actions, look)
        + render_columns([_render_standby_row(copy) for copy in value.standbys], look)
        + style_text(text + stopped, "bold" if value.done else "bad", look)
        + "\n"
        + _render_hints((*value.actions, *value.standbys))
    )


def render_actions(actions: Iterable[ActionResult], look: RenderOptions) -> str:
    """One line per action: symbol, task, outcome, phases."""
    return render_columns([_render_action_row(action) for action in actions], look)


def _render_action_row(action: ActionResult) -> Row:
    return (
        Cell(action.action.symbol, ACTION_STYLES[action.action]),
        Cell(action.task, "name"),
        Cell(action.outcome.value, _OUTCOME_STYLES[action.outcome]),
        format_action_result(action),
    )


def _render_standby_row(copy: StandbyResult) -> Row:
    took = f" {format_duration(copy.seconds)}" if copy.seconds else ""
    return (
        Cell(" "),
        Cell(copy.task, "name"),
        Cell(copy.outcome.value, _OUTCOME_STYLES[copy.outcome]),
        f"{copy.action} standby on {copy.host}{took}" + (f"; {copy.error}" if copy.error else ""),
    )


def format_action_result(action: ActionResult) -> str:
    """The phases of one action, the gap that it caused, and its error."""
    parts = [" > ".join(_format_phase_result(phase) for phase in action.phases)] if action.phases else []
    if action.felt_gap_s is not None:
        parts.append(format_gap(action))
    if action.error and not any(phase.detail == action.error for phase in action.phases if not phase.ok):
        parts.append(action.error)
    return "; ".join(parts) or str(action.action)


def format_gap(action: ActionResult) -> str:
    """The gap of a move: as its robot heard it, else from stop to ready."""
    heard = "" if action.gap_s is None else " heard"
    return f"gap {format_duration(action.felt_gap_s or 0.0)}{heard}"


def _format_phase_result(phase: PhaseResult) -> str:
    failed = "" if phase.ok else " FAILED"
    return f"{phase.phase} {phase.host} {format_duration(phase.seconds)}{failed}" + (
        f" ({phase.detail})" if phase.detail else ""
    )


def _render_hints(actions: Iterable[ActionResult | StandbyResult]) -> str:
    """The hints of the actions that failed, each once."""
    hints = dict.fromkeys(action.hint for action in actions if action.hint)
    return "".join(f"hint: {escape_unprintable(hint)}\n" for hint in hints)


def _encode_results(value: Results) -> Document:
    return {
        "revision": value.revision,
        "duration_s": value.seconds,
        "done": value.done,
        "interrupted": value.interrupted,
        "actions": [encode_action_result(action) for action in value.actions],
        "standbys": [_encode_standby_result(copy) for copy in value.standbys],
    }


def _encode_standby_result(copy: StandbyResult) -> Document:
    document: Document = {
        "task": copy.task,
        "host": copy.host,
        "action": copy.action.value,
        "outcome": copy.outcome.value,
        "duration_s": copy.seconds,
    }
    return document | without_none(error=copy.error or None, hint=copy.hint or None)


def encode_action_result(action: ActionResult) -> Document:
    """One action with its phases as JSON types."""
    document: Document = {
        "task": action.task,
        "action": action.action.value,
        "outcome": action.outcome.value,
        "host": action.host,
        "previous_host": action.previous_host,
        "located": action.located,
        "downtime_s": action.downtime_s,
        "gap_s": action.gap_s,
        **({} if action.state is None else {"carried": encode_carried_state(action.state)}),
        "phases": [_encode_phase_result(phase) for phase in action.phases],
    }
    return document | without_none(error=action.error or None, hint=action.hint or None)


def encode_carried_state(state: CarriedState) -> Document:
    """The state that a move took along as JSON types: never the state itself."""
    return {
        "host": state.host or None,
        "size_bytes": state.size_bytes,
        "sent_bytes": state.sent_bytes,
        "sha256": state.sha256,
        "save_s": state.save_s,
        "transfer_s": state.transfer_s,
        "load_s": state.load_s,
        "age_s": state.age_s,
    }


def _encode_phase_result(phase: PhaseResult) -> Document:
    document: Document = {
        "phase": phase.phase.value,
        "host": phase.host,
        "duration_s": phase.seconds,
        "ok": phase.ok,
    }
    return document | without_none(detail=phase.detail or None)
