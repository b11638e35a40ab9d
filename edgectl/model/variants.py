"""The schemes that are compared: policies, weights and margins, each combination under a name."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from edgectl.model.evidence import Variant
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.weights import PRESETS, parse_weights

# These place without weighing, so weights and margins make no difference.
_FIXED = (PolicyName.STATIC, PolicyName.LOCAL)


def weights_listed(text: str) -> list[str]:
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


def variants(base: Policy, policies: Sequence[PolicyName], weights: Sequence[str], margins: Sequence[float]) -> tuple[Variant, ...]:
    """Every combination; ``base`` gives what is not varied. Empty lists stand for what ``base`` says."""
    return tuple(_variants(base, policies or [base.name], weights, margins))


def _variants(base: Policy, policies: Iterable[PolicyName], weights: Sequence[str], margins: Sequence[float]) -> Iterator[Variant]:
    for policy in policies:
        if policy in _FIXED:
            yield Variant(name=policy.value, policy=replace(base, name=policy))
            continue
        for words in weights or [""]:
            chosen = replace(base, name=policy, weights=parse_weights(words) if words else base.weights)
            name = f"{policy} {words or _preset(base)}"
            if policy is PolicyName.PAPER or not margins:
                yield Variant(name=name, policy=chosen)
            else:
                yield from (Variant(name=f"{name} margin {margin:g}", policy=replace(chosen, move_margin=margin)) for margin in margins)


def _preset(base: Policy) -> str:
    return next((name for name, weights in PRESETS.items() if weights == base.weights), "weights of the task files")
