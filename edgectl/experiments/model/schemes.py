"""The schemes that are compared: policies, weights and margins, each combination under a name."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from edgectl.experiments.model.comparison import Scheme
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.weights import WEIGHT_PRESETS, parse_weights

# These place without weighing, so weights and margins make no difference.
_POLICIES_WITHOUT_WEIGHTS = (PolicyName.STATIC, PolicyName.LOCAL)


def parse_weight_sets(text: str) -> list[str]:
    """Presets joined by commas, or one custom set such as ``cpu=.5,task=1``.

    Raises:
        ValueError: neither.
    """
    if "=" in text:
        parse_weights(text)
        return [text]
    names = [name.strip() for name in text.split(",")]
    for name in names:
        parse_weights(name)
    return names


def build_schemes(
    base: Policy, policies: Sequence[PolicyName], weights: Sequence[str], margins: Sequence[float]
) -> tuple[Scheme, ...]:
    """Every combination; ``base`` gives what is not varied. Empty lists stand for what ``base`` says."""
    return tuple(_generate_schemes(base, policies or [base.name], weights, margins))


def _generate_schemes(
    base: Policy, policies: Iterable[PolicyName], weights: Sequence[str], margins: Sequence[float]
) -> Iterator[Scheme]:
    for policy in policies:
        if policy in _POLICIES_WITHOUT_WEIGHTS:
            yield Scheme(name=policy.value, policy=replace(base, name=policy))
            continue
        for words in weights or [""]:
            chosen = replace(base, name=policy, weights=parse_weights(words) if words else base.weights)
            name = f"{policy} {words or _describe_weights(base)}"
            if policy is PolicyName.PAPER or not margins:
                yield Scheme(name=name, policy=chosen)
            else:
                yield from (
                    Scheme(name=f"{name} margin {margin:g}", policy=replace(chosen, move_margin=margin))
                    for margin in margins
                )


def _describe_weights(base: Policy) -> str:
    return next(
        (name for name, weights in WEIGHT_PRESETS.items() if weights == base.weights),
        "weights of the task files",
    )
