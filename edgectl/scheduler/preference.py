# SPDX-License-Identifier: Apache-2.0
"""Sign of the terms: whether more or less that is free makes a host the better one (ADR 73)."""

from dataclasses import replace

from edgectl.model.policy import Policy, Preference, Weights
from edgectl.model.resource import RESOURCES_BY_NAME


def sign_weights(policy: Policy) -> Policy:
    """``policy``; with ``prefer: pack`` the weights of the resource terms are negative, so that of the hosts
    with room the fullest has the highest total.
    """
    if policy.prefer is not Preference.PACK:
        return policy
    signed = {
        name: -weight if name in RESOURCES_BY_NAME else weight for name, weight in policy.weights.items()
    }
    return replace(policy, weights=Weights(signed))
