"""The words for every reason and every rejection. They stand here and nowhere else."""

from collections import Counter
from collections.abc import Callable, Iterable

from edgectl.model.assignment import Decision, RankedHost, Reason, Rejection, Resource, Rule, Verdict
from edgectl.model.plan import Action, Step
from edgectl.units import format_bytes, format_duration, format_rate

_RULES = {
    Rule.UNREACHABLE: "unreachable",
    Rule.CORDONED: "cordoned",
    Rule.WITHOUT: "left out by --without",
    Rule.STALE: "measured too long ago",
    Rule.NOT_ONLY: "not in hosts.only",
    Rule.NEVER: "in hosts.never",
    Rule.LABELS: "without the labels",
    Rule.PIN: "not the pinned host",
    Rule.ONBOARD: "excluded by onboard",
    Rule.NO_LINK: "without a link",
    Rule.NO_CAPACITY: "without capacity",
    Rule.INSUFFICIENT: "short of",
}
LEFT_OUT = "left out by --target or -l"
_FORMAT: dict[Resource, Callable[[float], str]] = {
    Resource.CPU: lambda value: f"{value:.3f} cores",
    Resource.MEMORY: format_bytes,
    Resource.NETWORK: format_rate,
}
_PLACED = {
    Reason.BEST: "highest utility",
    Reason.ONLY_FEASIBLE: "the only host that fits",
    Reason.BEST_EFFORT: "nothing fits; best effort",
    Reason.PINNED: "pinned",
    Reason.FIRST_PLACEMENT: "first placement (policy static)",
    Reason.ONBOARD_LOCAL: "on its robot (policy local)",
    Reason.STILL_BEST: "still the best host",
    Reason.UNSETTLED: "no settled plan exists, so it stays",
    Reason.NEVER_MOVED: "placed once, never moved (policy static)",
    Reason.DONE: "completed",
    Reason.OPERATOR: "asked for by name",
    Reason.LEFT_FILE: "no longer in the task files",
    Reason.MOVES_FROZEN: "too many edges are silent; nothing moves",
}


def reason(step: Step) -> str:
    """Why the step is what it is, in one line that begins with the action."""
    return f"{step.action}: {LEFT_OUT if left_out(step) else _because(step)}" + _also_stopped(step)


def left_out(step: Step) -> bool:
    """Whether the step was decided, but not chosen by ``--target`` or ``-l``."""
    return step.action is Action.NONE and step.decision.verdict is not Verdict.COMPLETED and not not_found(step)


def not_found(step: Step) -> bool:
    """Whether the task is not managed by edgectl and runs nowhere."""
    return step.action is Action.NONE and step.decision.reason is Reason.UNMANAGED


def _because(step: Step) -> str:
    decision = step.decision
    special = _SPECIAL.get(decision.reason)
    text = special(step) if special is not None else _PLACED[decision.reason]
    return f"{text}; over capacity" if decision.overcommitted and decision.reason is not Reason.NOTHING_FITS else text


def _also_stopped(step: Step) -> str:
    return f"; stop the one on {listed(step.stop)}" if step.stop and step.action in (Action.KEEP, Action.HOLD, Action.NONE) else ""


def _with_predecessor(step: Step) -> str:
    return f"with its predecessor {step.decision.subject}" if step.decision.subject else "with its predecessors"


def _gain(step: Step) -> str:
    return f"{_gain_by(step)}, more than the move margin"


def _gain_by(step: Step) -> str:
    decision = step.decision
    ahead = f" by {decision.amount:.3f}" if decision.amount is not None else ""
    return f"{decision.host} beats {decision.previous_host or 'the present host'}{ahead}"


def _infeasible(step: Step) -> str:
    previous = next((ranked for ranked in step.decision.ranking if ranked.host == step.decision.previous_host), None)
    if previous is None or not previous.rejections:
        return f"{step.decision.previous_host} no longer fits"
    return f"{previous.host} " + " and ".join(rejection(entry) for entry in previous.rejections)


def _below_margin(step: Step) -> str:
    decision = step.decision
    ahead = _by(decision.lead)
    margin = f" {decision.amount:.2f}" if decision.amount is not None else ""
    return f"{decision.challenger or 'another host'} leads{ahead}, below move margin{margin}"


def _gain_over_cost(step: Step) -> str:
    return f"{_gain_by(step)}, more than {_cost(step.decision)}"


def _cost_above_gain(step: Step) -> str:
    decision = step.decision
    return f"{decision.challenger or 'another host'} leads{_by(decision.lead)}, no more than {_cost(decision)}"


def _cost(decision: Decision) -> str:
    cost = decision.cost
    if cost is None:
        return "the measured downtime costs"
    return f"the {cost.needed:.3f} that {format_duration(cost.downtime_s)} of downtime cost over {format_duration(cost.stay_s)}"


def _dwell(step: Step) -> str:
    decision = step.decision
    left = f"; {format_duration(decision.amount)} left of min_dwell" if decision.amount is not None else ", but min_dwell has not passed"
    return f"{decision.challenger or 'another host'} leads{_by(decision.lead)}{left}"


def _max_moves(step: Step) -> str:
    return f"{step.decision.challenger or 'another host'} leads{_by(step.decision.lead)}, but max_moves is used up"


def _by(lead: float | None) -> str:
    return f" by {abs(lead):.3f}" if lead is not None else ""


def _left_behind(step: Step) -> str:
    return fits(step.decision) + "; it stays where it runs"


def _unplaced(step: Step) -> str:
    nearest = f"; nearest is {step.decision.nearest}" if step.decision.nearest else ""
    return fits(step.decision) + nearest


def _missing(step: Step) -> str:
    return f"its predecessor {step.decision.subject} is neither placed nor running"


def _silent(step: Step) -> str:
    left = step.decision.amount
    return f"{_quiet(step)} does not answer" + (f"; replaced in {format_duration(left)}" if left is not None else "")


def _quiet(step: Step) -> str:
    return step.decision.subject or step.decision.host or "its host"


def _given_up(step: Step) -> str:
    decision = step.decision
    word = "exited by itself" if decision.amount == 0 else "failed"
    code = f" (last exit {decision.amount:.0f})" if decision.amount is not None else ""
    return f"{word} on {decision.subject}{code} and is given up; edgectl restart {step.task}, or a changed spec, starts it again"


def _replaced(step: Step) -> str:
    return f"{_quiet(step)} does not answer, and what ran there is fenced off"


def _spec_changed(step: Step) -> str:
    return "its spec changed" if step.changed in ((), ("spec",)) else f"{listed(step.changed)} changed"


def _duplicate(step: Step) -> str:
    return f"it also runs on {step.decision.subject}" if step.decision.subject else "it runs twice"


_SPECIAL: dict[Reason, Callable[[Step], str]] = {
    Reason.WITH_PREDECESSOR: _with_predecessor,
    Reason.GAIN: _gain,
    Reason.FORCED_INFEASIBLE: _infeasible,
    Reason.FORCED_DRAIN: lambda step: f"{step.decision.previous_host} is drained",
    Reason.FORCED_RULE: lambda step: f"{step.decision.previous_host} is excluded" + _why_excluded(step),
    Reason.BELOW_MARGIN: _below_margin,
    Reason.GAIN_OVER_COST: _gain_over_cost,
    Reason.COST_ABOVE_GAIN: _cost_above_gain,
    Reason.REPLACED: _replaced,
    Reason.DWELL: _dwell,
    Reason.MAX_MOVES: _max_moves,
    Reason.NOTHING_FITS: _left_behind,
    Reason.NO_CANDIDATE: _unplaced,
    Reason.NO_FEASIBLE_HOST: _unplaced,
    Reason.PREDECESSOR_MISSING: _missing,
    Reason.PREDECESSOR_INCOMPLETE: lambda step: f"its predecessor {step.decision.subject} has not completed yet; plan again once it has",
    Reason.HOST_SILENT: _silent,
    Reason.ROBOT_SILENT: _silent,
    Reason.GIVEN_UP: _given_up,
    Reason.UNMANAGED: lambda step: "not managed by edgectl" + (", and found nowhere" if not_found(step) else ""),
    Reason.SPEC_CHANGED: _spec_changed,
    Reason.DUPLICATE: _duplicate,
    Reason.ROLLBACK: lambda step: f"as after revision {step.decision.amount or 0:.0f}",
}


def _why_excluded(step: Step) -> str:
    previous = next((ranked for ranked in step.decision.ranking if ranked.host == step.decision.previous_host), None)
    return f": {', '.join(rejection(entry) for entry in previous.rejections)}" if previous and previous.rejections else ""


def rejection(entry: Rejection) -> str:
    """One rejection in words: ``short of cpu by 0.31 cores (need 0.60, free 0.29)``."""
    if entry.rule is not Rule.INSUFFICIENT or entry.resource is None:
        return _RULES[entry.rule] + _detail(entry)
    show = _FORMAT[entry.resource]
    where = f" to {entry.robot}" if entry.robot else ""
    if entry.demand is None or entry.capacity is None:
        return f"short of {entry.resource}{where}"
    free = entry.capacity - (entry.used or 0.0)
    return f"short of {entry.resource}{where} by {show(entry.demand - free)} (need {show(entry.demand)}, free {_signed(show, free)})"


def _detail(entry: Rejection) -> str:
    if entry.robot:
        return f" to {entry.robot}"
    return f" of {entry.resource}" if entry.resource and entry.rule is Rule.NO_CAPACITY else ""


def _signed(show: Callable[[float], str], value: float) -> str:
    return show(value) if value >= 0 else f"-{show(-value)}"


def fits(decision: Decision) -> str:
    """How many hosts fit and what the others lack: ``0/3 hosts fit: 2 short of cpu (need 2.40 cores, free 1.12 and 1.20), 1 cordoned``."""
    left_out = sum(decision.rejection_counts.values())
    total = len(decision.ranking) + left_out
    if total == 0:
        return "no host may run it"
    fitting = sum(ranked.feasible for ranked in decision.ranking)
    lacks = [*_shortages(decision.ranking), *_other_rules(decision)]
    return f"{fitting}/{total} hosts fit" + (f": {', '.join(lacks)}" if lacks else "")


def _first_of(ranked: RankedHost) -> Rejection | None:
    return ranked.rejections[0] if ranked.rejections else None


def _shortages(ranking: Iterable[RankedHost]) -> list[str]:
    firsts = [
        entry for entry in map(_first_of, ranking) if entry is not None and entry.rule is Rule.INSUFFICIENT and entry.resource is not None
    ]
    groups: dict[Resource, list[Rejection]] = {}
    for entry in firsts:
        if entry.resource is not None:
            groups.setdefault(entry.resource, []).append(entry)
    return [_shortage(resource, entries) for resource, entries in groups.items()]


def _shortage(resource: Resource, entries: list[Rejection]) -> str:
    show = _FORMAT[resource]
    needs = sorted({show(entry.demand) for entry in entries if entry.demand is not None})
    free = [entry.capacity - (entry.used or 0.0) for entry in entries if entry.capacity is not None]
    if not needs or not free:
        return f"{len(entries)} short of {resource}"
    shown = [_signed(show, value) for value in sorted(free)[:3]]
    return f"{len(entries)} short of {resource} (need {' or '.join(needs)}, free {listed(shown)}{' ..' if len(free) > len(shown) else ''})"


def _other_rules(decision: Decision) -> list[str]:
    rules = Counter(
        entry.rule.value for entry in map(_first_of, decision.ranking) if entry is not None and entry.rule is not Rule.INSUFFICIENT
    )
    rules.update(decision.rejection_counts)
    return [f"{count} {_RULES[Rule(rule)] if rule != Rule.INSUFFICIENT else 'others too small'}" for rule, count in rules.items()]


def listed(words: Iterable[str]) -> str:
    """Words as people list them: ``a, b and c``."""
    *head, last = list(words) or [""]
    return f"{', '.join(head)} and {last}" if head else last
