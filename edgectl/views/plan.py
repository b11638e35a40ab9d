# SPDX-License-Identifier: Apache-2.0
"""The plan: what changes, why, and the expected load; as a table, in full, as a document and as a comment."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from edgectl.formats.document import Document
from edgectl.formats.kinds import PLAN_KIND
from edgectl.model.assignment import Decision, RankedHost
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import WEIGHT_PRESETS, PolicyName, Weights
from edgectl.model.resource import RESOURCES, TERMS
from edgectl.model.task import Tasks
from edgectl.units import format_duration, format_instant
from edgectl.views.demands import render_demands, render_reservations
from edgectl.views.glossary import head, list_shown_weights
from edgectl.views.notes import render_notes
from edgectl.views.output import View
from edgectl.views.output_format import PLAN_FORMATS
from edgectl.views.plan_sections import (
    ACTION_STYLES,
    format_utility,
    list_plan_notes,
    render_expected_load,
    render_plan_summary,
)
from edgectl.views.reasons import (
    describe_reason,
    describe_rejection,
    is_left_out,
    is_not_found,
    list_equal_hosts,
)
from edgectl.views.standbys import render_standby_rows
from edgectl.views.text import (
    PLAIN,
    Cell,
    RenderOptions,
    Row,
    escape_unprintable,
    render_columns,
    render_fleet_line,
    render_header,
    style_text,
    wrap_text,
)

if TYPE_CHECKING:
    from edgectl.views.taken_along import LastMoves

# A CI job finds its comment by it, and edits that instead of adding one.
PLAN_COMMENT_MARKER = "<!-- edgectl-plan -->"
_MARKDOWN_HEAD = "| | task | now | next | utility | lead | reason |\n|---|---|---|---|---:|---:|---|\n"
_MARKDOWN_ESCAPES = str.maketrans({character: f"\\{character}" for character in "\\`*_[]<>|#~&"})
# What forges make a link or a mention of even without markup; behind it an invisible space ends that.
_LIVE_TEXT = re.compile(r"@|\b(?:https?|ftp|mailto|xmpp):|\bwww(?=\.)", re.IGNORECASE)
_INVISIBLE_BREAK = "&#8203;"


class PlanView(View):
    """A plan; its document is the one that ``edgectl apply PLAN`` reads."""

    formats = PLAN_FORMATS

    def __init__(
        self,
        plan: Plan,
        tasks: Tasks | None = None,
        carried: "LastMoves | None" = None,
        *,
        now: float | None = None,
    ) -> None:
        """``tasks`` state what moves take along; ``carried``: by task, the last move that did. ``now``: time
        by which the age of the snapshot is shown.
        """
        self._plan, self._tasks, self._carried, self._now = plan, tasks, carried or {}, now

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The changes with their reasons, the load that is expected afterwards, and a line that counts.

        What stays where it is, is one line; without any change the expected load is left out.
        """
        steps = select_shown_steps(self._plan.steps)
        rows = [_STEP_HEAD]
        for step in steps:
            rows += [_render_step_row(step), *render_standby_rows(step, format_utility)]
        return _join_parts(
            self._render_header(look) if self._plan.expected else render_fleet_line(self._plan.fleet, look),
            (render_columns(rows, look, right={4, 5}, wrap={1, 2, 3}) if steps else "")
            + (render_folded_steps(self._plan.steps, look) if self._plan.changes or steps else ""),
            render_expected_load(self._plan, look) if steps else "",
            render_plan_summary(self._plan, look),
        )

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with every candidate of every task, the demands, and what moves take along."""
        changing = [step for step in self._plan.steps if step.changes]
        steps = [*changing, *(step for step in self._plan.steps if not step.changes)]
        weights = self._plan.policy.weights
        rows = [
            _CANDIDATE_HEAD,
            *(row for step in steps for row in _render_candidate_rows(step, weights)),
        ]
        return _join_parts(
            self._render_header(look),
            render_columns(rows, look, right=_TERM_COLUMNS, wrap={1, 2}) if steps else "",
            render_demands(self._plan, look),
            render_reservations(self._plan, look),
            self._render_taken_along(look),
            render_expected_load(self._plan, look),
            render_legend(steps, look) if steps else "",
            render_plan_summary(self._plan, look),
        )

    def _render_taken_along(self, look: RenderOptions) -> str:
        if self._tasks is None:
            return ""
        from edgectl.views.taken_along import render_taken_along

        return render_taken_along(self._plan, self._tasks, self._carried, look)

    def _render_header(self, look: RenderOptions = PLAIN) -> str:
        return render_plan_header(self._plan, look, now=self._now)

    def notes(self) -> Sequence[str]:
        """Notes on hosts, deferred tasks and demands."""
        return list_plan_notes(self._plan)

    def document(self) -> Document:
        """The plan file. Its numbers are exact, for it is read back."""
        return PLAN_KIND.encode(self._plan)

    def rows(self) -> Sequence[Document]:
        """The decisions."""
        return PLAN_KIND.encode(self._plan)["decisions"]  # type: ignore[return-value]

    def names(self) -> Sequence[str]:
        """The tasks of the plan."""
        return [f"task/{step.task}" for step in self._plan.steps]

    def gitlab(self) -> str:
        """The counts that a merge request of GitLab shows (``artifacts:reports:terraform``)."""
        from edgectl.views.gitlab import render_plan_counts

        return render_plan_counts(self._plan)

    def markdown(self) -> str:
        """A comment on a pull request; the expected load and the demands folded away."""
        rows = "".join(
            _render_markdown_row(step) + _render_markdown_standbys(step) for step in self._plan.steps
        )
        load = render_expected_load(self._plan).replace("```", "'''")
        demands = render_demands(self._plan).replace("```", "'''")
        folded = _render_folded_section("Expected load", load) + _render_folded_section("Demands", demands)
        notes = "".join(
            f"\n> {escape_markdown(line)}\n" for line in render_notes(self.notes(), PLAIN).splitlines()
        )
        summary = render_plan_summary(self._plan).strip()
        return (
            f"{PLAN_COMMENT_MARKER}\n**{summary}**\n\n{_MARKDOWN_HEAD}{rows}{notes}{folded}"
            f"\n{escape_markdown(self._render_header().rstrip())}\n"
        )


# Above this age a snapshot is an old one: its date says more.
_MAX_AGE_S = 3600.0
_SYMBOL_WORDS = {
    Action.NONE: "none: nothing is done",
    Action.UNPLACED: "unplaced: no host fits",
    Action.HOLD: "hold: its host does not answer",
    Action.DEFER: "defer: later",
}
_STEP_HEAD = head("", "task", "now_host", "next_host", "total", "lead", "reason")
_CANDIDATE_HEAD = head("", "task", "host", *(f"utility.{term}" for term in TERMS), "total", "reason")
_TERM_COLUMNS = frozenset(range(3, 4 + len(TERMS)))


def format_lead(decision: Decision) -> str:
    """The lead over the next host; a tie is no number."""
    return "tie" if list_equal_hosts(decision) else format_utility(decision.lead, signed=True)


def _join_parts(*parts: str) -> str:
    return "\n".join(part for part in parts if part)


def _render_step_row(step: Step) -> Row:
    decision, style = step.decision, ACTION_STYLES[step.action]
    return (
        Cell(step.action.symbol, style),
        Cell(step.task, "name"),
        decision.previous_host or "-",
        Cell(_find_next_host(step) or "-", "bold" if step.action.changes else ""),
        format_utility(decision.total),
        format_lead(decision),
        Cell(describe_reason(step), style),
    )


def _find_next_host(step: Step) -> str | None:
    """Host of the task after the plan."""
    if is_left_out(step):
        return step.decision.previous_host
    return None if step.action in (Action.STOP, Action.COMPLETE, Action.NONE) else step.decision.host


def _render_candidate_rows(step: Step, weights: Weights) -> list[Row]:
    decision, style = step.decision, ACTION_STYLES[step.action]
    chosen = next((ranked for ranked in decision.ranking if ranked.host == decision.host), None)
    others = sorted(
        (ranked for ranked in decision.ranking if ranked is not chosen),
        key=lambda ranked: (not ranked.feasible, ranked.rank),
    )
    first: Row = (
        Cell(step.action.symbol, style),
        Cell(step.task, "name"),
        Cell(_format_route(step), "bold"),
        *_format_terms(chosen, weights),
        Cell(describe_reason(step), style),
    )
    rows = [first, *(_render_losing_host_row(ranked, weights) for ranked in others)]
    left_out = ", ".join(f"{count} {rule}" for rule, count in decision.rejection_counts.items())
    blank = [""] * (len(TERMS) + 1)
    if left_out:
        rows.append(("", "", Cell("..", "dim"), *blank, Cell(f"not shown: {left_out}", "dim")))
    for symbol, label, now, then, total, _, reason in render_standby_rows(step, format_utility):
        rows.append((symbol, label, now if then == "-" else then, *blank[1:], total, reason))
    return rows


def _render_losing_host_row(ranked: RankedHost, weights: Weights) -> Row:
    return (
        "",
        "",
        Cell(ranked.host, "dim"),
        *_format_terms(ranked, weights),
        Cell(_describe_losing_host(ranked), "dim"),
    )


def _format_route(step: Step) -> str:
    decision = step.decision
    if decision.previous_host and decision.host and decision.previous_host != decision.host:
        return f"{decision.previous_host} -> {decision.host}"
    return decision.host or (f"{decision.previous_host} ->" if decision.previous_host else "-")


def _format_terms(ranked: RankedHost | None, weights: Weights) -> tuple[str, ...]:
    if ranked is None:
        return ("-",) * (len(TERMS) + 1)
    shown = list_shown_weights(weights)
    terms = (
        format_utility(value if name in shown and ranked.total is not None else None)
        for name, value in ranked.terms.items()
    )
    return (*terms, format_utility(ranked.total))


def _describe_losing_host(ranked: RankedHost) -> str:
    return (
        ", ".join(describe_rejection(entry) for entry in ranked.rejections)
        if ranked.rejections
        else f"rank {ranked.rank}"
    )


def _render_folded_section(title: str, text: str) -> str:
    return f"\n<details><summary>{title}</summary>\n\n```text\n{text}```\n\n</details>\n" if text else ""


def _render_markdown_row(step: Step) -> str:
    decision = step.decision
    fields = (
        step.task,
        decision.previous_host or "-",
        decision.host or "-",
        format_utility(decision.total),
        format_lead(decision),
        describe_reason(step),
    )
    return f"| `{step.action.symbol}` | " + " | ".join(escape_markdown(field) for field in fields) + " |\n"


def _render_markdown_standbys(step: Step) -> str:
    """The copies of a task, below its row."""
    lines = []
    for symbol, *cells in render_standby_rows(step, format_utility):
        texts = (cell.text if isinstance(cell, Cell) else cell for cell in cells)
        mark = symbol.text if isinstance(symbol, Cell) else symbol
        lines.append(f"| `{mark}` | " + " | ".join(escape_markdown(text) for text in texts) + " |\n")
    return "".join(lines)


def escape_markdown(text: str) -> str:
    """``text`` with the characters that Markdown interprets escaped, and no live mention or link."""
    escaped = escape_unprintable(text).translate(_MARKDOWN_ESCAPES)
    return _LIVE_TEXT.sub(rf"\g<0>{_INVISIBLE_BREAK}", escaped)


def render_plan_header(value: Plan, look: RenderOptions = PLAIN, *, now: float | None = None) -> str:
    """One line: fleet, policy unless it is the usual one, weights, and age of the snapshot.

    ``now`` (s since 1970); None: the date of the snapshot, which is the same whenever the plan is shown.
    """
    age = None if now is None else max(0.0, now - value.created_at)
    parts = [
        *([f"fleet {escape_unprintable(value.fleet)}"] if value.fleet else []),
        *([f"policy {value.policy.name}"] if value.policy.name is not PolicyName.UTILITY else []),
        f"weights {_format_weights(value)}",
        f"snapshot {format_duration(age)} ago"
        if age is not None and age <= _MAX_AGE_S
        else f"snapshot of {format_instant(math.floor(value.created_at))}",
    ]
    return render_header(parts, look)


def _format_weights(value: Plan) -> str:
    """The name of the weights, or each of them."""
    weights = value.policy.weights
    named = next((name for name, preset in WEIGHT_PRESETS.items() if preset == weights), "")
    return named or " ".join(f"{name} {weight:.3g}" for name, weight in list_shown_weights(weights).items())


def select_shown_steps(steps: Iterable[Step]) -> list[Step]:
    """The steps that say something new: first the changes, then what is held, deferred or without a host."""
    shown = [step for step in steps if not _is_folded(step)]
    return sorted(shown, key=lambda step: not step.changes)


def _is_folded(step: Step) -> bool:
    stays = step.action in (Action.KEEP, Action.NONE) and not is_not_found(step)
    return stays and not step.changes


def render_folded_steps(steps: Iterable[Step], look: RenderOptions = PLAIN) -> str:
    """One line that counts the steps that are not shown."""
    words = Counter(
        "left out" if is_left_out(step) else "kept" if step.action is Action.KEEP else "completed before"
        for step in steps
        if _is_folded(step)
    )
    if not words:
        return ""
    counts = ", ".join(f"{count} {word}" for word, count in words.items())
    return style_text(wrap_text(f"{Action.KEEP.symbol}  {counts} (-o wide shows all)", look, 3), "dim", look)


def render_legend(steps: Iterable[Step], look: RenderOptions = PLAIN) -> str:
    """What the symbols and the columns of the wide form mean."""
    used = dict.fromkeys(step.action for step in steps)
    symbols = ", ".join(f"{each.symbol} {_SYMBOL_WORDS.get(each, each.value)}" for each in used)
    terms = ", ".join(resource.title for resource in RESOURCES if not resource.optional)
    lines = [
        f"Symbols: {symbols}." if symbols else "",
        f"{terms}: share of the host or link that is free with the task there; below 0, what it lacks.",
        "AFFINITY: share of the tasks it works with that are there. UTILITY: the weighted sum.",
        "LEAD (-o table): UTILITY above that of the next host. rank 2: the second choice.",
    ]
    return "Legend:\n" + "".join(wrap_text("  " + line, look, 4) for line in lines if line)
