# SPDX-License-Identifier: Apache-2.0
"""What is said of probes of idle links."""

import pytest

from tests.experiments.lab.probes import describe


@pytest.mark.parametrize(
    ("readings", "said"),
    [
        ([1e6, None, 3e6, 2e6], "3 of 4 read it: 1.00 of it (0.50 to 1.50)"),
        ([None, 2e6], "1 of 2 read it"),
        ([], "0 of 0 read it"),
    ],
)
def test_quartiles_are_shares_of_what_the_link_carries(readings: list[float | None], said: str) -> None:
    assert describe(readings, 2e6) == said
