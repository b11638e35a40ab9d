# SPDX-License-Identifier: Apache-2.0
"""Schemes to compare: each combination of policies, weights and move margins, under a name."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from edgectl.model.encoding import in_document
from edgectl.model.policy import WEIGHT_PRESETS, Policy, PolicyName, Weights

# Weights and margins are compared under these policies; the others have one scheme each, under the
# policy's name.
_POLICIES_WITH_WEIGHTS = (PolicyName.UTILITY, PolicyName.PAPER)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheme:
    """A policy with its weights, under a unique name.

    ``oracle``: in simulations only, hosts are chosen by true speeds and links instead.
    """

    name: str
    policy: Policy = field(metadata=in_document(inline=True))
    oracle: bool = False


def build_schemes(
    base: Policy, policies: Sequence[PolicyName], weights: Mapping[str, Weights], margins: Sequence[float]
) -> tuple[Scheme, ...]:
    """All combinations; ``weights`` are weights by the name that they have in a scheme's name.

    An empty argument stands for the value of ``base``, which also provides all other settings.
    """
    return tuple(_generate_schemes(base, policies or [base.name], weights, margins))


def _generate_schemes(
    base: Policy, policies: Iterable[PolicyName], weights: Mapping[str, Weights], margins: Sequence[float]
) -> Iterator[Scheme]:
    for policy in policies:
        if policy not in _POLICIES_WITH_WEIGHTS:
            yield Scheme(name=policy.value, policy=replace(base, name=policy))
            continue
        for weights_name, values in (weights or {_describe_weights(base): base.weights}).items():
            chosen = replace(base, name=policy, weights=values)
            name = f"{policy} {weights_name}"
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
