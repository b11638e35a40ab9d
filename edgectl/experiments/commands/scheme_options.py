"""The options of replay and simulate that select the schemes to compare."""

import math
from typing import Annotated

from typer import Option

from edgectl.config.weights import parse_weights
from edgectl.errors import UsageError
from edgectl.experiments.model.schemes import Scheme, build_schemes
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.units import QuantityError, parse_share

PoliciesOption = Annotated[
    str,
    Option(
        "--policy",
        metavar="LIST",
        show_default=False,
        help="Any of utility, static, local, least-loaded, pack, ..",
    ),
]
WeightsListOption = Annotated[
    str | None,
    Option(
        "--weights",
        "-W",
        metavar="LIST",
        show_default=False,
        help="Presets such as cpu,all; or one set: cpu=.5,task=1.",
    ),
]

EquivalenceOption = Annotated[
    str | None,
    Option(
        "--equivalence", metavar="SHARE", show_default=False, help="Call schemes equal only within this: 5%."
    ),
]


def parse_equivalence(text: str | None) -> float | None:
    """The bound of equivalence, a share above 0; None if there is none.

    Raises:
        UsageError: ``text`` is no such share.
    """
    if text is None:
        return None
    try:
        bound = parse_share(text)
    except QuantityError as error:
        raise UsageError(f"--equivalence: {error.message}", hint=error.hint) from None
    if bound <= 0:
        raise UsageError(f"--equivalence: must be above 0%, not {text}", hint="write 5%")
    return bound


def parse_schemes(
    base: Policy, policies: str, weights: str | None, margins: list[float]
) -> tuple[Scheme, ...]:
    """Every combination of the policies, weights and margins given.

    Raises:
        UsageError: an unknown policy or preset, or invalid weights.
    """
    known = [policy.value for policy in PolicyName]
    names = [name.strip() for name in policies.split(",")]
    for name in names:
        if name not in known:
            raise UsageError(
                f"--policy: unknown policy {name!r}",
                hint=f"write some of {', '.join(known)}, separated by commas",
            )
    try:
        weight_sets = parse_weight_sets(weights) if weights is not None else {}
    except QuantityError as error:
        raise UsageError(f"--weights: {error.message}", hint=error.hint) from None
    return build_schemes(base, [PolicyName(name) for name in names], weight_sets, margins)


def parse_weight_sets(text: str) -> dict[str, Weights]:
    """Presets separated by commas, or a single custom set such as ``cpu=.5,task=1``.

    Raises:
        QuantityError: neither.
    """
    if "=" in text:
        return {text: parse_weights(text)}
    names = [name.strip() for name in text.split(",")]
    return {name: parse_weights(name) for name in names}


def parse_margins(text: str | None) -> list[float]:
    """Move margins separated by commas; empty if ``text`` is None.

    Raises:
        UsageError: a part is not a number >= 0.
    """
    try:
        margins = [float(part) for part in text.split(",")] if text is not None else []
    except ValueError:
        margins = [math.nan]
    if not all(math.isfinite(margin) and margin >= 0 for margin in margins):
        raise UsageError(
            f"--margin: invalid margins {text!r}",
            hint="write numbers of 0 or more, separated by commas: 0,0.1",
        )
    return margins
