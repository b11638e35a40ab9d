# SPDX-License-Identifier: Apache-2.0
"""Classes of hosts: the label, else cores and nominal memory. Demands that managers share."""

import pytest

from edgectl.model.manager_state import MeasuredDemand
from edgectl.rules.measured_demand import (
    MAX_SHARED,
    classify_host,
    prefer_own_demands,
    select_shared_demands,
)
from tests.builders import GI, an_edge


@pytest.mark.parametrize(
    ("cores", "memory", "name"),
    [
        (4.0, 3.7 * GI, "4c-4Gi"), (4.0, 4 * GI, "4c-4Gi"), (8.0, 7.44 * GI, "8c-8Gi"), (8.0, 7.52 * GI, "8c-8Gi"), (12.0, 11.6 * GI, "12c-12Gi"),
        (16.0, 62.7 * GI, "16c-64Gi"), (1.5, 0.94 * GI, "1.5c-1Gi"), (0.25, 0.5 * GI, "0.2c-0.5Gi"), (4.0, 4 * GI + 1, "4c-6Gi"),
    ],
)  # fmt: skip
def test_hosts_of_one_make_are_of_one_class(cores: float, memory: float, name: str) -> None:
    assert classify_host(an_edge(), cores, memory) == name


def test_the_label_says_otherwise() -> None:
    assert classify_host(an_edge(labels={"class": "orin", "gpu": "ampere"}), 8.0, 7.4 * GI) == "orin"


def measure(cpu: float, samples: int = 60, spec_hash: str = "s") -> MeasuredDemand:
    return MeasuredDemand(samples=samples, span_s=300.0, used={"cpu": cpu}, spec_hash=spec_hash)


KEY = ("slam", "4c-8Gi")


@pytest.mark.parametrize(
    ("new", "taken"),
    [
        (measure(1.09), False), (measure(1.11), True), (measure(0.91), False), (measure(0.89), True),
        (measure(5.0, samples=59), False), (measure(1.0, spec_hash="t"), True), (measure(1.0, samples=1000), False),
    ],
)  # fmt: skip
def test_a_demand_is_shared_anew_where_it_is_off_by_a_tenth(new: MeasuredDemand, taken: bool) -> None:
    assert select_shared_demands({KEY: measure(1.0)}, {KEY: new}, ["slam"]) == {
        KEY: new if taken else measure(1.0)
    }


def test_a_bounded_number_is_shared_those_of_the_file_first() -> None:
    measured = {(f"t{number}", "c"): measure(1.0) for number in range(MAX_SHARED)}
    mine = {("zz", "c"): measure(1.0)}
    found = select_shared_demands({}, {**measured, **mine}, ["zz"])
    assert (len(found), found["zz", "c"]) == (MAX_SHARED, measure(1.0))
    assert select_shared_demands(found, {**measured, **mine}, ["zz"]) == found


def test_own_samples_win_once_there_are_enough() -> None:
    shared = {KEY: measure(2.0, samples=1000)}
    assert prefer_own_demands({KEY: measure(1.0)}, shared) == {KEY: measure(1.0)}
    assert prefer_own_demands({KEY: measure(1.0, samples=59)}, shared) == shared
    assert prefer_own_demands({}, shared) == shared
