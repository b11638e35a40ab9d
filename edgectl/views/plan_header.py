# SPDX-License-Identifier: Apache-2.0
"""Header of a plan, the line that folds what stays, and the legend of the wide form."""

import math
from collections import Counter
from collections.abc import Iterable

from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import WEIGHT_PRESETS, PolicyName
from edgectl.model.resource import RESOURCES
from edgectl.units import format_duration, format_instant
from edgectl.views.glossary import list_shown_weights
from edgectl.views.reasons import is_left_out, is_not_found
from edgectl.views.text import PLAIN, RenderOptions, style_text, wrap_text

# Above this age a snapshot is an old one: its date says more.
_MAX_AGE_S = 3600.0
_SYMBOL_WORDS = {
    Action.NONE: "none: nothing is done",
    Action.UNPLACED: "unplaced: no host fits",
    Action.HOLD: "hold: its host does not answer",
    Action.DEFER: "defer: later",
}


def render_plan_header(
    value: Plan, look: RenderOptions = PLAIN, *, fleet: str = "", now: float | None = None
) -> str:
    """One line: fleet, policy unless it is the usual one, weights, and age of the snapshot.

    ``now`` (s since 1970); None: the date of the snapshot, which is the same whenever the plan is shown.
    """
    age = None if now is None else max(0.0, now - value.created_at)
    parts = [
        *([f"fleet {fleet}"] if fleet else []),
        *([f"policy {value.policy.name}"] if value.policy.name is not PolicyName.UTILITY else []),
        f"weights {_format_weights(value)}",
        f"snapshot {format_duration(age)} ago"
        if age is not None and age <= _MAX_AGE_S
        else f"snapshot of {format_instant(math.floor(value.created_at))}",
    ]
    return render_header(parts, look)


def render_header(parts: Iterable[str], look: RenderOptions = PLAIN) -> str:
    """The line above a table."""
    line = (" · " if look.unicode else ", ").join(parts)
    return (
        "\n".join(
            style_text(each, "bold", look)
            for each in wrap_text(line[:1].upper() + line[1:], look).splitlines()
        )
        + "\n"
    )


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
    terms = ", ".join(resource.name.upper() for resource in RESOURCES)
    lines = [
        f"Symbols: {symbols}." if symbols else "",
        f"{terms}: share of the host or link that is free with the task there; below 0, what it lacks.",
        "AFFINITY: share of the tasks it works with that are there. UTILITY: the weighted sum.",
        "LEAD (-o table): UTILITY above that of the next host. rank 2: the second choice.",
    ]
    return "Legend:\n" + "".join(wrap_text("  " + line, look, 4) for line in lines if line)
