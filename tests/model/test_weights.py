# SPDX-License-Identifier: Apache-2.0
"""Parsing of weights, always normalised to a sum of 1."""

import math

import pytest

from edgectl.config.weights import parse_weights
from edgectl.model.policy import WEIGHT_PRESETS, Weights
from edgectl.names import natural_key


def weights(cpu: float, memory: float, network: float, task: float) -> Weights:
    return Weights(cpu=cpu, memory=memory, network=network, task=task)


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        ("cpu", weights(1, 0, 0, 0)),
        ("memory", weights(0, 1, 0, 0)),
        ("network", weights(0, 0, 1, 0)),
        ("task", weights(0, 0, 0, 1)),
        (" all ", weights(0.25, 0.25, 0.25, 0.25)),
        ("resources", weights(1 / 3, 1 / 3, 1 / 3, 0)),
        ("cpu=.5,network=.5", weights(0.5, 0, 0.5, 0)),
        ("cpu = 2, task = 6", weights(0.25, 0, 0, 0.75)),
        ({"cpu": 0.4, "memory": 0.2, "network": 0.3, "task": 0.1}, weights(0.4, 0.2, 0.3, 0.1)),
        ({"memory": 7}, weights(0, 1, 0, 0)),
        ({"cpu": 1e308, "memory": 1e308, "network": 1e308, "task": 1e308}, weights(0.25, 0.25, 0.25, 0.25)),
    ],
)
def test_what_can_be_written(raw: object, expected: Weights) -> None:
    assert parse_weights(raw) == expected


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ("cpus", "unknown weights 'cpus'"),
        ("", "unknown weights ''"),
        ("cpu=x", "weight cpu must be a number, got 'x'"),
        ("cpu=.5,cpu=.5", "weight cpu is given twice"),
        ("disk=1", "unknown weight 'disk'"),
        ({"cpu": -1}, "weight cpu must be a finite number, 0 or more"),
        ({"cpu": math.nan}, "weight cpu must be a finite number, 0 or more"),
        ({"cpu": 10**400}, "weight cpu is too large"),
        ("cpu=inf", "weight cpu must be a finite number, 0 or more"),
        ({"cpu": 0}, "at least one weight must be more than 0"),
        ({}, "at least one weight must be more than 0"),
        ({"cpu": True}, "weight cpu must be a number"),
        ({1: 1}, "unknown weight 1"),
        (None, "cannot be read as weights: None"),
        (0.5, "cannot be read as weights: 0.5"),
    ],
)
def test_what_cannot(raw: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_weights(raw)


def test_presets_sum_to_one() -> None:
    for preset in WEIGHT_PRESETS.values():
        assert math.isclose(sum(preset.values()), 1.0)


def test_normalising_keeps_proportions() -> None:
    assert weights(1, 1, 2, 0).normalised() == weights(0.25, 0.25, 0.5, 0)
    assert parse_weights(weights(2, 2, 4, 0)) == weights(0.25, 0.25, 0.5, 0)


def test_names_are_ordered_as_people_count() -> None:
    assert sorted(["edge10", "edge2", "edge", "a1", "a01"], key=natural_key) == [
        "a01",
        "a1",
        "edge",
        "edge2",
        "edge10",
    ]
