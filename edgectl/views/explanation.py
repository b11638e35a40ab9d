"""Why one task goes where it goes, as text and as a document."""

from collections.abc import Callable, Iterable

from edgectl.formats.base import FORMAT_VERSION, Document, number, optional
from edgectl.model.explanation import Change, Explanation, Flip, Term
from edgectl.model.plan import Step
from edgectl.units import format_bytes, format_rate
from edgectl.views.reasons import reason
from edgectl.views.sections import figure
from edgectl.views.text import PLAIN, Cell, Look, Row, columns, flowed, paint

_SHOW: dict[Term, Callable[[float], str]] = {
    Term.CPU: lambda amount: f"{amount:.3f} cores",
    Term.MEMORY: format_bytes,
    Term.NETWORK: format_rate,
}
_WEIGHTS = (Change.WEIGHT_RISES, Change.WEIGHT_FALLS)


def text(step: Step, value: Explanation, look: Look = PLAIN, *, every: bool = False) -> str:
    """The decision, what each term adds to the lead, and what would change it: the smallest changes, or ``every`` one of them."""
    parts = [paint(f"{step.task} -> {value.decision.host or 'nowhere'}", "bold", look) + "\n" + flowed(reason(step), look)]
    if value.contributions:
        parts.append(_contributions(value, look))
    parts.append("".join(flowed(line, look) for line in _sentences(value, every=every)))
    return "\n".join(part for part in parts if part)


def _contributions(value: Explanation, look: Look) -> str:
    here, there = value.decision.host or "", value.runner_up or ""
    rows: list[Row] = [("TERM", "WEIGHT", here, there, "ADDS TO THE LEAD")]
    for each in value.contributions:
        style = "good" if each.lead > 0 else "bad" if each.lead < 0 else "dim"
        rows.append((each.term, f"{each.weight:.3f}", figure(each.here), figure(each.there), Cell(f"{each.lead:+.3f}", style)))
    decision, total = value.decision, sum(each.lead for each in value.contributions)
    other = None if decision.total is None else decision.total - total
    rows.append((Cell("total", "bold"), "", figure(decision.total), figure(other), Cell(f"{total:+.3f}", "bold")))
    return columns(rows, look, right={1, 2, 3, 4})


def _sentences(value: Explanation, *, every: bool) -> Iterable[str]:
    flips = value.flips if every else _smallest(value.flips)
    for flip in flips:
        yield f"{_outcome(flip)} if {_condition(flip)}."
    if value.decision.host is not None and not value.contributions:
        yield "No other host fits (edgectl plan -o wide shows what each lacks)."
    if not value.flips:
        yield "No single change of a load or a weight would change this."
    if not value.linear:
        yield "Changes of a link's load are left out: with several robots the worst link counts, which is not linear."
    if value.fragile and value.slack is not None and value.noise is not None:
        yield f"fragile: it would change {value.slack:.3f} below, and the measurements alone vary by {value.noise:.3f}."


def _smallest(flips: Iterable[Flip]) -> list[Flip]:
    """The smallest change of a load and the smallest of a weight."""
    loads = [flip for flip in flips if flip.change not in _WEIGHTS]
    weights = [flip for flip in flips if flip.change in _WEIGHTS]
    return loads[:1] + weights[:1]


def _outcome(flip: Flip) -> str:
    return f"{flip.winner} would win" if flip.winner else "It would fit nowhere"


def _condition(flip: Flip) -> str:
    if flip.change in _WEIGHTS:
        word = "above" if flip.change is Change.WEIGHT_RISES else "below"
        return f"the weight of {flip.term} were {word} {flip.amount:.3f}, the others sharing the rest"
    what = f"the load of the link {flip.host} to {flip.robot}" if flip.robot else f"the {flip.term} load of {flip.host}"
    verb = "rose" if flip.change is Change.LOAD_RISES else "fell"
    return f"{what} {verb} by more than {_SHOW[flip.term](flip.amount)}"


def document(step: Step, value: Explanation) -> Document:
    """The explanation as JSON types; ``flips`` smallest first."""
    decision = value.decision
    return {
        "format_version": FORMAT_VERSION,
        "task": step.task,
        "action": step.action.value,
        "reason": reason(step),
        "host": decision.host,
        "previous_host": decision.previous_host,
        "runner_up": value.runner_up,
        "total": optional(decision.total),
        "lead": optional(decision.lead),
        "slack": optional(value.slack),
        "noise": optional(value.noise),
        "fragile": value.fragile,
        "contributions": [
            {"term": each.term.value, "weight": number(each.weight), "here": number(each.here), "there": number(each.there),
             "adds": number(each.lead)}
            for each in value.contributions
        ],
        "flips": [_flip(flip) for flip in value.flips],
    }  # fmt: skip


def _flip(flip: Flip) -> Document:
    return {
        "change": flip.change.value, "term": flip.term.value, "host": flip.host, "robot": flip.robot, "amount": number(flip.amount),
        "unit": "weight" if flip.change in _WEIGHTS else _UNITS[flip.term], "size": number(flip.size), "winner": flip.winner,
    }  # fmt: skip


_UNITS = {Term.CPU: "cores", Term.MEMORY: "bytes", Term.NETWORK: "bytes_per_s"}
