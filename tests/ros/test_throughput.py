# SPDX-License-Identifier: Apache-2.0
"""Byte counters against the interface, for some of the mixes of ``make throughput``."""

import pytest

from tests.network_hosts import find_missing_for_counters
from tests.ros.throughput import SHORT, Mix, measure_mix

# Of short readings; those of docs/performance.md are longer.
MOST = 0.03


@pytest.mark.timeout(600)
@pytest.mark.parametrize("mix", SHORT, ids=str)
def test_the_counters_agree_with_the_interface(mix: Mix, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not find_missing_for_counters(), "these tests are never skipped: they need root, nft and sudo"
    monkeypatch.setenv("EDGECTL_STATE_DIR", "replaced by the measurement")
    found = measure_mix(mix, 5.0)
    assert abs(found.error) < MOST
    assert found.task_error is None or abs(found.task_error) < MOST
