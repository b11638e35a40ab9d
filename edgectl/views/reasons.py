# SPDX-License-Identifier: Apache-2.0
"""Reasons of decisions and rejections in words."""

from collections import Counter
from collections.abc import Callable, Iterable

from edgectl.model.assignment import (
    Decision,
    OperatorPin,
    RankedHost,
    Reason,
    Rejection,
    RejectionRule,
    Verdict,
)
from edgectl.model.manager_state import Pin
from edgectl.model.plan import Action, Step
from edgectl.model.resource import Resource
from edgectl.rules.lost_places import describe_lost_place, get_lost_place
from edgectl.rules.other_managers import describe_unlisted_host
from edgectl.units import format_duration, format_instant
from edgectl.views.notes import join_first_words, join_words

# Utilities that differ by less are equal (ADR 8).
_EQUAL = 1e-9
_RULE_TEXTS = {
    RejectionRule.UNREACHABLE: "unreachable",
    RejectionRule.CORDONED: "cordoned",
    RejectionRule.WITHOUT: "left out by --without",
    RejectionRule.STALE: "measured too long ago",
    RejectionRule.NOT_ONLY: "not in hosts.only",
    RejectionRule.NEVER: "in hosts.never",
    RejectionRule.LABELS: "without the labels",
    RejectionRule.PIN: "not the pinned host",
    RejectionRule.ONBOARD: "excluded by onboard",
    RejectionRule.NO_ENGINE: "without its container engine",
    RejectionRule.NO_LINK: "without a link",
    RejectionRule.NO_CAPACITY: "without capacity",
    RejectionRule.INSUFFICIENT: "short of",
    RejectionRule.APART: "with a task that it is apart from",
    RejectionRule.TOGETHER: "without room for all that go together",
    RejectionRule.SPREAD: "with their part of the spread",
    RejectionRule.DEADLINE_MISSED: "misses the deadline",
    RejectionRule.NOT_LISTED: "not in the inventory",
}
# Of a pin of an operator, where the words of a ranking would not be true.
_OBSTACLE_TEXTS = {
    RejectionRule.INSUFFICIENT: "too small for it",
    RejectionRule.DEADLINE_MISSED: "too slow for its hard deadline",
    RejectionRule.TOGETHER: "not where a task that goes with it is pinned",
    RejectionRule.APART: "pinned by a task that it is apart from",
}
LEFT_OUT_TEXT = "left out by --target or -l"
_FIXED_REASON_TEXTS = {
    Reason.BEST: "highest utility",
    Reason.ONLY_FEASIBLE: "the only host that fits",
    Reason.BEST_EFFORT: "nothing fits; best effort",
    Reason.REBALANCED: "the sum of all utilities is higher (--rebalance)",
    Reason.OPTIMAL: "so in the best plan found (--optimal)",
    Reason.ROOM_MADE: "fits since other tasks made room",
    Reason.PINNED: "pinned",
    Reason.LEAST_LOADED: "the least loaded host",
    Reason.FULLEST: "the fullest host that fits",
    Reason.IN_TURN: "the next host in turn",
    Reason.DRAWN: "drawn at random from the hosts that fit",
    Reason.FIRST_PLACEMENT: "first placement (policy static)",
    Reason.ONBOARD_LOCAL: "on its robot (policy local)",
    Reason.STILL_BEST: "still the best host",
    Reason.UNSETTLED: "no settled plan exists, so it stays",
    Reason.NEVER_MOVED: "placed once, never moved (policy static)",
    Reason.STILL_FITS: "still fits",
    Reason.DONE: "completed",
    Reason.OPERATOR: "requested",
    Reason.LEFT_FILE: "no longer in its task file",
    Reason.PRUNED: "in none of the given task files (--prune)",
    Reason.MOVES_FROZEN: "too many edges do not answer; no moves",
}


def describe_reason(step: Step) -> str:
    """The reason of a step, in one line that begins with the action."""
    return (
        f"{step.action}: {LEFT_OUT_TEXT if is_left_out(step) else _describe_cause(step)}"
        + _describe_pin_beside(step)
        + _describe_extra_stops(step)
    )


def is_left_out(step: Step) -> bool:
    """Whether the step was decided, but not chosen by ``--target`` or ``-l``."""
    return (
        step.action is Action.NONE
        and step.decision.verdict is not Verdict.COMPLETED
        and not is_not_found(step)
    )


def is_not_found(step: Step) -> bool:
    """Whether the task is not managed by edgectl and runs nowhere."""
    return step.action is Action.NONE and step.decision.reason is Reason.UNMANAGED


def _describe_cause(step: Step) -> str:
    decision = step.decision
    special = _REASON_DESCRIBERS.get(decision.reason)
    text = special(step) if special is not None else _FIXED_REASON_TEXTS[decision.reason]
    if decision.reason in (Reason.STILL_BEST, Reason.ONLY_FEASIBLE, Reason.PINNED) and is_pinned(decision):
        text = f"pinned to {decision.host}"
    elif decision.reason in (Reason.STILL_BEST, Reason.BEST) and (equal := list_equal_hosts(decision)):
        stays = decision.host == decision.previous_host
        text = f"tie with {join_first_words(equal)}; " + (
            "it stays where it runs" if stays else "chosen by the tie rule"
        )
    return (
        f"{text}; over capacity"
        if decision.overcommitted and decision.reason is not Reason.NOTHING_FITS
        else text
    )


def is_pinned(decision: Decision) -> bool:
    """Whether the task file allows this host alone."""
    if decision.lead is not None or decision.pin is not None:
        return False  # another host may have it, so the ranking need not be made (ADR 75)
    ruled_out = (entry.rule for ranked in decision.ranking for entry in ranked.rejections)
    return RejectionRule.PIN in decision.rejection_counts or RejectionRule.PIN in ruled_out


def list_equal_hosts(decision: Decision) -> list[str]:
    """The other hosts whose utility is that of the chosen one."""
    if decision.total is None or decision.lead is None or abs(decision.lead) > _EQUAL:
        return []
    return [
        ranked.host
        for ranked in decision.ranking
        if ranked.feasible
        and ranked.host != decision.host
        and ranked.total is not None
        and abs(ranked.total - decision.total) <= _EQUAL
    ]


def describe_pin(pin: OperatorPin | Pin) -> str:
    """``pinned to edge2 until 2026-11-23T14:05:00Z``."""
    return f"pinned to {pin.host}" + ("" if pin.until is None else f" until {format_instant(int(pin.until))}")


def describe_obstacle(rule: RejectionRule) -> str:
    """What keeps a task off a host that it is pinned to."""
    return _OBSTACLE_TEXTS.get(rule) or _RULE_TEXTS[rule]


def _describe_pin_beside(step: Step) -> str:
    """The pin of an operator where it is not the reason of the place."""
    pin = step.decision.pin
    if pin is None or step.decision.reason is Reason.PINNED_BY_OPERATOR:
        return ""
    if pin.set_aside is None:
        return f"; {describe_pin(pin)} (edgectl unpin {step.task})"
    return f"; its pin does not count: {pin.host} is {describe_obstacle(pin.set_aside)}"


def _describe_operator_pin(step: Step) -> str:
    pin = step.decision.pin
    return f"{describe_pin(pin)} by edgectl move" if pin is not None else "pinned by edgectl move"


def _describe_extra_stops(step: Step) -> str:
    return (
        f"; stop the one on {join_words(step.stop)}"
        if step.stop and step.action in (Action.KEEP, Action.HOLD, Action.NONE)
        else ""
    )


def _describe_with_predecessor(step: Step) -> str:
    return (
        f"with its predecessor {step.decision.subject}" if step.decision.subject else "with its predecessors"
    )


def _describe_gain(step: Step) -> str:
    return f"{_format_gain(step)}, more than the move margin"


def _format_gain(step: Step) -> str:
    decision = step.decision
    ahead = f" by {decision.amount:.3f}" if decision.amount is not None else ""
    return f"{decision.host} beats {decision.previous_host or 'the present host'}{ahead}"


def _describe_infeasible(step: Step) -> str:
    previous = next(
        (ranked for ranked in step.decision.ranking if ranked.host == step.decision.previous_host), None
    )
    if previous is None or not previous.rejections:
        return f"{step.decision.previous_host} no longer fits"
    return f"{previous.host} " + " and ".join(describe_rejection(entry) for entry in previous.rejections)


def _describe_below_margin(step: Step) -> str:
    decision = step.decision
    ahead = _format_lead(decision.lead)
    margin = f" {decision.amount:.2f}" if decision.amount is not None else ""
    return f"{decision.challenger or 'another host'} leads{ahead}, below move margin{margin}"


def _describe_gain_over_cost(step: Step) -> str:
    return f"{_format_gain(step)}, more than {_describe_downtime_cost(step.decision)}"


def _describe_cost_above_gain(step: Step) -> str:
    decision = step.decision
    leader = f"{decision.challenger or 'another host'} leads{_format_lead(decision.lead)}"
    return f"{leader}, no more than {_describe_downtime_cost(decision)}"


def _describe_downtime_cost(decision: Decision) -> str:
    cost = decision.cost
    if cost is None:
        return "the measured downtime costs"
    downtime, stay = format_duration(cost.downtime_s), format_duration(cost.stay_s)
    return f"the {cost.needed:.3f} that {downtime} of downtime cost over {stay}"


def _describe_dwell(step: Step) -> str:
    decision = step.decision
    left = (
        f"; {format_duration(decision.amount)} left of min_dwell"
        if decision.amount is not None
        else ", but min_dwell has not passed"
    )
    return f"{decision.challenger or 'another host'} leads{_format_lead(decision.lead)}{left}"


def _describe_max_moves(step: Step) -> str:
    leader = f"{step.decision.challenger or 'another host'} leads{_format_lead(step.decision.lead)}"
    return f"{leader}, but max_moves is used up"


def _format_lead(lead: float | None) -> str:
    return f" by {abs(lead):.3f}" if lead is not None else ""


def _describe_nothing_fits(step: Step) -> str:
    return describe_fitting_hosts(step.decision) + "; it stays where it runs"


def _describe_no_host(step: Step) -> str:
    nearest = f"; nearest is {step.decision.nearest}" if step.decision.nearest else ""
    return describe_fitting_hosts(step.decision) + nearest


def _describe_missing_predecessor(step: Step) -> str:
    return f"its predecessor {step.decision.subject} is neither placed nor running"


def _describe_silent_host(step: Step) -> str:
    left = step.decision.amount
    return f"{_get_silent_host(step)} does not answer" + (
        f"; replaced in {format_duration(left)}" if left is not None else ""
    )


def _get_silent_host(step: Step) -> str:
    return step.decision.subject or step.decision.host or "its host"


def _describe_given_up(step: Step) -> str:
    decision = step.decision
    word = "exited by itself" if decision.amount == 0 else "failed"
    code = f" (last exit {decision.amount:.0f})" if decision.amount is not None else ""
    remedy = f"edgectl restart {step.task}, or a changed spec, starts it again"
    return f"{word} on {decision.subject}{code} and is given up; {remedy}"


def _describe_left_host(step: Step) -> str:
    lost = get_lost_place(step.decision)
    return describe_lost_place(lost) if lost is not None else ""


def _describe_replaced(step: Step) -> str:
    return f"{_get_silent_host(step)} does not answer, and its copy there is fenced off"


def _describe_spec_change(step: Step) -> str:
    return "its spec changed" if step.changed in ((), ("spec",)) else f"{join_words(step.changed)} changed"


def _describe_duplicate(step: Step) -> str:
    return f"it also runs on {step.decision.subject}" if step.decision.subject else "it runs twice"


_REASON_DESCRIBERS: dict[Reason, Callable[[Step], str]] = {
    Reason.WITH_PREDECESSOR: _describe_with_predecessor,
    Reason.PINNED_BY_OPERATOR: _describe_operator_pin,
    Reason.GAIN: _describe_gain,
    Reason.FORCED_INFEASIBLE: _describe_infeasible,
    Reason.RELIEF: lambda step: (
        f"no host fits; the worst overload falls by {step.decision.amount or 0.0:.0%} of the capacity"
    ),
    Reason.FORCED_DRAIN: lambda step: f"{step.decision.previous_host} is drained",
    Reason.FORCED_RULE: lambda step: f"{step.decision.previous_host} is excluded" + _describe_exclusion(step),
    Reason.TOGETHER: lambda step: f"together with {step.decision.subject or 'others'}",
    Reason.GROUP: lambda step: f"{step.decision.subject or 'another task'} of its group has no host",
    Reason.MADE_ROOM: lambda step: f"made room for {step.decision.subject or 'another task'}",
    Reason.PREEMPTED: lambda step: f"preempted by {step.decision.subject or 'a task'} of higher priority",
    Reason.BELOW_MARGIN: _describe_below_margin,
    Reason.GAIN_OVER_COST: _describe_gain_over_cost,
    Reason.COST_ABOVE_GAIN: _describe_cost_above_gain,
    Reason.STANDBY_ACTIVATED: lambda step: f"its standby on {step.decision.host} becomes active",
    Reason.REPLACED: _describe_replaced,
    Reason.DWELL: _describe_dwell,
    Reason.MAX_MOVES: _describe_max_moves,
    Reason.NOTHING_FITS: _describe_nothing_fits,
    Reason.NO_CANDIDATE: _describe_no_host,
    Reason.NO_FEASIBLE_HOST: _describe_no_host,
    Reason.PREDECESSOR_MISSING: _describe_missing_predecessor,
    Reason.PREDECESSOR_INCOMPLETE: lambda step: (
        f"its predecessor {step.decision.subject} has not completed yet; plan again once it has"
    ),
    Reason.HOST_SILENT: _describe_silent_host,
    Reason.HOST_UNSURE: lambda step: (
        f"may run on {step.decision.subject}, which does not answer: another manager has acted since all "
        f"hosts were last seen; edgectl fence {step.decision.subject} if it is off"
    ),
    Reason.HOST_UNLISTED: lambda step: describe_unlisted_host(step.decision.subject or "a host"),
    Reason.ROBOT_SILENT: _describe_silent_host,
    Reason.HOST_LEFT: _describe_left_host,
    Reason.HOST_READDRESSED: _describe_left_host,
    Reason.GIVEN_UP: _describe_given_up,
    Reason.UNMANAGED: lambda step: (
        "not managed by edgectl" + (", and found nowhere" if is_not_found(step) else "")
    ),
    Reason.ORPHANED: lambda step: (
        "its supervisor was lost; a new one takes over"
        if step.action is Action.ADOPT
        else "its supervisor was lost and cannot be replaced"
    ),
    Reason.NEED_RESTARTED: lambda step: f"{step.decision.subject or 'a task that it needs'} restarted",
    Reason.SPEC_CHANGED: _describe_spec_change,
    Reason.DUPLICATE: _describe_duplicate,
    Reason.ROLLBACK: lambda step: f"as after revision {step.decision.amount or 0:.0f}",
}


def _describe_exclusion(step: Step) -> str:
    previous = next(
        (ranked for ranked in step.decision.ranking if ranked.host == step.decision.previous_host), None
    )
    return (
        f": {', '.join(describe_rejection(entry) for entry in previous.rejections)}"
        if previous and previous.rejections
        else ""
    )


def describe_rejection(entry: Rejection) -> str:
    """One rejection in words: ``short of cpu by 0.31 cores (need 0.60, free 0.29)``."""
    if entry.rule is not RejectionRule.INSUFFICIENT or entry.resource is None:
        return _RULE_TEXTS[entry.rule] + _format_rejection_detail(entry)
    show = entry.resource.unit.format_exact
    where = f" to {entry.robot}" if entry.robot else ""
    if entry.demand is None or entry.capacity is None:
        return f"short of {entry.resource}{where}"
    free = entry.capacity - (entry.used or 0.0)
    amounts = f"need {show(entry.demand)}, free {_format_signed(show, free)}"
    return f"short of {entry.resource}{where} by {show(entry.demand - free)} ({amounts})"


def _format_rejection_detail(entry: Rejection) -> str:
    if entry.robot:
        return f" to {entry.robot}"
    if entry.task:
        return f" ({entry.task})"
    if entry.rule is RejectionRule.DEADLINE_MISSED and entry.demand is not None:
        return f" ({entry.demand:.0f} ms at p95, deadline {entry.capacity or 0.0:.0f} ms)"
    return f" of {entry.resource}" if entry.resource and entry.rule is RejectionRule.NO_CAPACITY else ""


def _format_signed(show: Callable[[float], str], value: float) -> str:
    return show(value) if value >= 0 else f"-{show(-value)}"


def describe_fitting_hosts(decision: Decision) -> str:
    """The number of hosts that fit and the shortages of the others.

    ``0/3 hosts fit: 2 short of cpu (need 2.40 cores, free 1.12 and 1.20), 1 cordoned``
    """
    left_out = sum(decision.rejection_counts.values())
    total = len(decision.ranking) + left_out
    if total == 0:
        return "no host may run it"
    fitting = sum(ranked.feasible for ranked in decision.ranking)
    lacks = [*_describe_shortages(decision.ranking), *_describe_other_rejections(decision)]
    return f"{fitting}/{total} hosts fit" + (f": {', '.join(lacks)}" if lacks else "")


def _find_first_rejection(ranked: RankedHost) -> Rejection | None:
    return ranked.rejections[0] if ranked.rejections else None


def _describe_shortages(ranking: Iterable[RankedHost]) -> list[str]:
    firsts = [
        entry
        for entry in map(_find_first_rejection, ranking)
        if entry is not None and entry.rule is RejectionRule.INSUFFICIENT and entry.resource is not None
    ]
    groups: dict[Resource, list[Rejection]] = {}
    for entry in firsts:
        if entry.resource is not None:
            groups.setdefault(entry.resource, []).append(entry)
    return [_describe_shortage(resource, entries) for resource, entries in groups.items()]


def _describe_shortage(resource: Resource, entries: list[Rejection]) -> str:
    show = resource.unit.format_exact
    needs = sorted({show(entry.demand) for entry in entries if entry.demand is not None})
    free = [entry.capacity - (entry.used or 0.0) for entry in entries if entry.capacity is not None]
    if not needs or not free:
        return f"{len(entries)} short of {resource}"
    shown = [_format_signed(show, value) for value in sorted(free)[:3]]
    listed = join_words(shown) + (" .." if len(free) > len(shown) else "")
    return f"{len(entries)} short of {resource} (need {' or '.join(needs)}, free {listed})"


def _describe_other_rejections(decision: Decision) -> list[str]:
    rules = Counter(
        entry.rule.value
        for entry in map(_find_first_rejection, decision.ranking)
        if entry is not None and entry.rule is not RejectionRule.INSUFFICIENT
    )
    rules.update(decision.rejection_counts)
    texts = {**_RULE_TEXTS, RejectionRule.INSUFFICIENT: "others too small"}
    return [f"{count} {texts[RejectionRule(rule)]}" for rule, count in rules.items()]
