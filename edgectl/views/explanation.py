# SPDX-License-Identifier: Apache-2.0
"""The explanation of one placement: the decision, its terms, and the changes that would alter it."""

from collections.abc import Iterable, Sequence

from edgectl.formats.document import Document
from edgectl.model.assignment import Decision, RejectionRule
from edgectl.model.explanation import ChangeKind, Explanation, FirstMove, Flip, Tie, TieRule
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Step
from edgectl.model.resource import RESOURCES_BY_NAME
from edgectl.model.result import ActionResult
from edgectl.model.task import Task
from edgectl.views.glossary import head, list_shown_weights
from edgectl.views.notes import join_words
from edgectl.views.output import ItemView
from edgectl.views.output_format import WIDE_FORMATS
from edgectl.views.plan_sections import format_utility
from edgectl.views.predicted_latency import encode_latencies, render_latencies
from edgectl.views.reasons import describe_reason
from edgectl.views.results import encode_carried_state
from edgectl.views.standbys import encode_standby_steps, explain_standbys
from edgectl.views.taken_along import explain_taken_along
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns, style_text, wrap_text

_TIE_RULES = {
    TieRule.RUNS_THERE: "it does not leave the host where it runs",
    TieRule.FREE_SHARE: "more is free on the chosen host, over all resources",
    TieRule.FEWEST_TASKS: "fewer tasks were placed on the chosen host",
    TieRule.NAMES: "the order of names decides",
}
_RULES_BETWEEN_TASKS = {
    RejectionRule.APART: "Its files keep it off {hosts}, where {other} is (apart).",
    RejectionRule.TOGETHER: "Its files keep it with {other} (together), which leaves out {hosts}.",
    RejectionRule.SPREAD: "Its files spread its entry evenly: {hosts} has its part, such as {other}.",
}
_NO_CHANGE_FOUND = "No single change of a load or a weight was found that would change this."
_NOT_BY_TOTALS = "The totals alone did not decide this, so no change of a load or a weight is named."
_WEIGHT_CHANGES = (ChangeKind.WEIGHT_RISES, ChangeKind.WEIGHT_FALLS)


class ExplanationView(ItemView):
    """The decision of a task, the contribution of each term, and the changes that would alter it.

    ``unanswered``: notes on the hosts that did not answer, which the decision leaves out. ``manager``: knows
    how long the task took to become active on each host. ``task``: states what a move takes along;
    ``carried``: the last move that took its state along.
    """

    kind = "explanation"
    formats = WIDE_FORMATS

    def __init__(
        self,
        step: Step,
        explanation: Explanation,
        unanswered: Sequence[str] = (),
        manager: ManagerState | None = None,
        *,
        task: Task | None = None,
        carried: ActionResult | None = None,
    ) -> None:
        self._step, self._explanation, self._unanswered = step, explanation, unanswered
        self._manager, self._task, self._carried = manager, task, carried

    def table(self, look: RenderOptions = PLAIN) -> str:
        """With the smallest changes only."""
        return self._render(look, every=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """With every change that would alter the decision."""
        return self._render(look, every=True)

    def _render(self, look: RenderOptions, *, every: bool) -> str:
        step, value = self._step, self._explanation
        title = style_text(f"{step.task} -> {value.decision.host or 'nowhere'}", "bold", look)
        lines = [
            *self._list_sentences(every=every),
            *explain_standbys(step, self._manager),
            *explain_taken_along(step, self._task, self._carried),
        ]
        sentences = "".join(wrap_text(line, look) for line in lines)
        parts = (
            title + "\n" + wrap_text(describe_reason(step), look),
            _render_contributions(value, look) if value.contributions else "",
            render_latencies(value, look, every=every),
            sentences,
        )
        return "\n".join(part for part in parts if part)

    def _list_sentences(self, *, every: bool) -> Iterable[str]:
        if self._step.action is Action.HOLD:
            return ["Nothing is decided until its host answers, or is declared powered off (edgectl fence)."]
        return _list_sentences(self._explanation, every=every, complete=not self._unanswered)

    def warnings(self) -> Sequence[str]:
        """The hosts that did not answer."""
        return self._unanswered

    def item(self) -> Document:
        """The explanation as JSON types; ``flips`` smallest first."""
        step, value = self._step, self._explanation
        decision = value.decision
        document: Document = {
            "task": step.task,
            "action": step.action.value,
            "reason": describe_reason(step),
            "host": decision.host,
            "previous_host": decision.previous_host,
            "runner_up": value.runner_up,
            "standbys": encode_standby_steps(step),
            "total": decision.total,
            "lead": decision.lead,
            "slack": value.slack,
            "noise": value.noise,
            "fragile": value.fragile,
            "pinned_to": value.pin or _find_pinned_host(decision),
            "equal_hosts": [] if value.tie is None else list(value.tie.hosts),
            "tie_rule": None if value.tie is None else value.tie.rule.value,
            "contributions": [
                {
                    "term": each.term,
                    "weight": each.weight,
                    "here": each.here,
                    "there": each.there,
                    "adds": each.lead,
                }
                for each in value.contributions
            ],
            "flips": [_encode_flip(flip) for flip in value.flips],
        }
        moved = self._carried
        if moved is not None and moved.state is not None:
            document["carried"] = encode_carried_state(moved.state)
        return document | encode_latencies(value)


def _render_contributions(value: Explanation, look: RenderOptions) -> str:
    here, there = value.decision.host or "", value.runner_up or ""
    hosts = (Cell(here, "head"), Cell(there, "head"))
    rows: list[Row] = [(*head("term", "weight"), *hosts, Cell("ADDS TO LEAD", "head"))]
    shown = list_shown_weights({each.term: each.weight for each in value.contributions})
    for each in (each for each in value.contributions if each.term in shown):
        shown_lead = round(each.lead, 3)
        style = "good" if shown_lead > 0 else "bad" if shown_lead < 0 else "dim"
        rows.append(
            (
                each.term,
                f"{each.weight:.3f}",
                format_utility(each.here),
                format_utility(each.there),
                Cell(format_utility(each.lead, signed=True), style),
            )
        )
    decision, total = value.decision, sum(each.lead for each in value.contributions)
    other = None if decision.total is None else decision.total - total
    rows.append(
        (
            Cell("total", "bold"),
            "",
            format_utility(decision.total),
            format_utility(other),
            Cell(format_utility(total, signed=True), "bold"),
        )
    )
    return render_columns(rows, look, right={1, 2, 3, 4})


def _list_sentences(value: Explanation, *, every: bool, complete: bool) -> Iterable[str]:
    flips = value.flips if every else _select_smallest_flips(value.flips)
    if value.tie is not None:
        yield _describe_tie(value.tie)
    pinned = value.pin or _find_pinned_host(value.decision)
    if pinned is not None:
        yield _describe_pin(value, pinned)
    yield from _describe_rules_between_tasks(value.decision)
    for flip in flips:
        outcome = _describe_flip_outcome(flip, value.decision)
        yield f"{outcome} if {_describe_flip_condition(flip, flip.amount)}."
        if flip.first is not None:
            yield _describe_first_move(flip, flip.first)
    if value.decision.host is not None and not value.contributions:
        among = "" if complete else " of those that answer"
        yield f"No other host{among} fits (edgectl plan -o wide shows what each lacks)."
    if not value.flips and pinned is None:
        yield (
            _NO_CHANGE_FOUND
            if value.weighed
            else _NOT_BY_TOTALS
            if value.rule is None
            else f"Policy {value.rule} decides by a rule of its own; changes are named for utility only."
        )
    if value.bends:
        yield "Changes of loads are left out: the predicted latency counts, which is not linear in them."
    elif not value.linear:
        yield (
            "Changes of a link's load are left out: with several robots the worst link counts, "
            "which is not linear."
        )
    if value.fragile and value.slack is not None and value.noise is not None:
        yield (
            f"fragile: it would change {value.slack:.3f} below, "
            f"and the measurements alone vary by {value.noise:.3f}."
        )


def _describe_pin(value: Explanation, host: str) -> str:
    alone = "no load and no weight sends it anywhere else"
    if value.pin is not None:
        return f"Its task file pins it to {host}: {alone}."
    return f"edgectl move pinned it to {host}: {alone} (edgectl unpin {value.decision.task})."


def _find_pinned_host(decision: Decision) -> str | None:
    """The host that an operator has pinned the task to, where that counts."""
    return decision.pin.host if decision.pin is not None and decision.pin.set_aside is None else None


def _select_smallest_flips(flips: Iterable[Flip]) -> list[Flip]:
    """The smallest change of a load and the smallest of a weight."""
    loads = [flip for flip in flips if flip.change not in _WEIGHT_CHANGES]
    weights = [flip for flip in flips if flip.change in _WEIGHT_CHANGES]
    return loads[:1] + weights[:1]


def _describe_rules_between_tasks(decision: Decision) -> Iterable[str]:
    """The hosts that rules between tasks exclude, by rule and the other task."""
    found: dict[tuple[RejectionRule, str], list[str]] = {}
    for entry in decision.ranking:
        for rejection in entry.rejections:
            if rejection.rule in _RULES_BETWEEN_TASKS and rejection.task is not None:
                found.setdefault((rejection.rule, rejection.task), []).append(entry.host)
    for (rule, other), hosts in found.items():
        yield _RULES_BETWEEN_TASKS[rule].format(task=decision.task, hosts=join_words(hosts), other=other)


def _describe_tie(tie: Tie) -> str:
    are = "is" if len(tie.hosts) == 1 else "are"
    return f"{join_words(tie.hosts)} {are} equal; {_TIE_RULES[tie.rule]}."


def _describe_first_move(flip: Flip, first: FirstMove) -> str:
    """The move of another task before that change."""
    goes = f"moves to {first.host}" if first.host else "finds no host"
    return f"Before that, {first.task} {goes} if {_describe_flip_condition(flip, first.amount)}."


def _describe_flip_outcome(flip: Flip, decision: Decision) -> str:
    if flip.winner is not None and flip.winner == decision.host:
        return f"{decision.task} stays even"
    return f"{flip.winner} would win" if flip.winner else "It would fit nowhere"


def _describe_flip_condition(flip: Flip, amount: float) -> str:
    if flip.change in _WEIGHT_CHANGES:
        word = "above" if flip.change is ChangeKind.WEIGHT_RISES else "below"
        return f"the weight of {flip.term} were {word} {amount:.3f}, the others sharing the rest"
    what = (
        f"the load of the link {flip.host} to {flip.robot}"
        if flip.robot
        else f"the {flip.term} load of {flip.host}"
    )
    verb = "rose" if flip.change is ChangeKind.LOAD_RISES else "fell"
    format_amount = RESOURCES_BY_NAME[flip.term].unit.format_exact
    nothing = format_amount(amount) == format_amount(0.0)
    return f"{what} {verb} " + ("at all" if nothing else f"by more than {format_amount(amount)}")


def _encode_flip(flip: Flip) -> Document:
    return {
        "change": flip.change.value,
        "term": flip.term,
        "host": flip.host,
        "robot": flip.robot,
        "amount": flip.amount,
        "unit": "weight" if flip.change in _WEIGHT_CHANGES else RESOURCES_BY_NAME[flip.term].unit.name,
        "size": flip.size,
        "winner": flip.winner,
        "moves_first": None
        if flip.first is None
        else {"task": flip.first.task, "host": flip.first.host, "amount": flip.first.amount},
    }
