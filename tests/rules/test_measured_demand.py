# SPDX-License-Identifier: Apache-2.0
"""Classes of hosts: the label, else cores and nominal memory."""

import pytest

from edgectl.rules.measured_demand import classify_host
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
