# SPDX-License-Identifier: Apache-2.0
"""Maps of resources: complete, immutable, and equal by what they hold."""

import copy
import pickle

import pytest

from edgectl.model.assignment import UtilityTerms
from edgectl.model.demand import Demand, Quantity
from edgectl.model.inventory import Limits
from edgectl.model.policy import WEIGHT_PRESETS, Weights
from edgectl.model.resource import (
    AFFINITY,
    HOST_RESOURCES,
    LATENCY,
    RATING,
    RESOURCES,
    RESOURCES_BY_NAME,
    TERMS,
    Usage,
)


def test_what_is_not_given_has_its_default() -> None:
    assert Limits(cpu=0.8) == {resource.name: 1.0 for resource in HOST_RESOURCES} | {"cpu": 0.8}
    assert Limits(cpu=0.8).stated == {"cpu": 0.8}
    assert tuple(Usage(network=1.0)) == tuple(RESOURCES_BY_NAME)


def test_a_map_of_complete_values_is_like_any_other() -> None:
    values = dict.fromkeys(TERMS, 0.5)
    assert UtilityTerms.from_complete(values) == UtilityTerms(values)
    assert tuple(UtilityTerms.from_complete(values)) == TERMS


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(TypeError, match="Limits has no disk"):
        Limits(disk=0.5)


@pytest.mark.parametrize("change", ["__setitem__", "__delitem__", "update", "setdefault", "pop", "clear"])
def test_a_map_cannot_be_changed(change: str) -> None:
    with pytest.raises(TypeError, match="Usage cannot be changed"):
        getattr(Usage(cpu=1.0), change)("cpu")


def test_a_map_is_copied_pickled_and_hashed_by_value() -> None:
    demand = Demand(cpu=Quantity(value=1.0))
    assert copy.deepcopy(demand) == pickle.loads(pickle.dumps(demand)) == demand
    assert hash(Demand(cpu=Quantity(value=1.0))) == hash(demand)


def test_the_terms_are_the_resources_the_affinity_the_latency_and_the_rating() -> None:
    assert (*(resource.name for resource in RESOURCES), AFFINITY, LATENCY, RATING) == TERMS
    assert WEIGHT_PRESETS.keys() == {*TERMS, "all", "resources"}
    assert WEIGHT_PRESETS["all"] == Weights()
