"""What the options of replay and simulate mean: the schemes to compare."""

import math

from edgectl.errors import UsageError
from edgectl.experiments.model.comparison import Scheme
from edgectl.experiments.model.schemes import build_schemes, parse_weight_sets
from edgectl.model.policy import Policy, PolicyName


def parse_schemes(
    base: Policy, policies: str, weights: str | None, margins: list[float]
) -> tuple[Scheme, ...]:
    """Every combination of the lists.

    Raises:
        UsageError: a name that is none.
    """
    known = [policy.value for policy in PolicyName]
    names = [name.strip() for name in policies.split(",")]
    for name in names:
        if name not in known:
            raise UsageError(
                f"--policy: no policy {name!r}", hint=f"write some of {', '.join(known)}, joined by commas"
            )
    try:
        listed = parse_weight_sets(weights) if weights is not None else []
    except ValueError as error:
        message, _, hint = str(error).partition("; ")
        raise UsageError(f"--weights: {message}", hint=hint) from None
    return build_schemes(base, [PolicyName(name) for name in names], listed, margins)


def parse_margins(text: str | None) -> list[float]:
    """Margins joined by commas; none where nothing is given.

    Raises:
        UsageError: a part that is no number of 0 or more.
    """
    try:
        found = [float(part) for part in text.split(",")] if text is not None else []
    except ValueError:
        found = [math.nan]
    if not all(math.isfinite(margin) and margin >= 0 for margin in found):
        raise UsageError(
            f"--margin: {text!r} are no margins", hint="write numbers of 0 or more, joined by commas: 0,0.1"
        )
    return found
