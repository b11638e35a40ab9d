# SPDX-License-Identifier: Apache-2.0
"""The model of docs/model in small bounds, and that it notices each rule that is missing."""

from pathlib import Path

import pytest

from tests.protocol.tlc import INVARIANTS, Bounds, check_model, format_config

# The smallest bounds in which the rule matters.
BROKEN = {
    "a host obeys runs without its lease": Bounds(checks_lease=False, runs=2, reboots=0),
    "what another manager may have placed on a silent host is started": Bounds(holds_unseen=False, reboots=0),
    "a start is written down after it": Bounds(books_first=False, runs=2, reboots=0),
    "the same with etcd": Bounds(books_first=False, runs=2, reboots=0, uses_etcd=True),
    "a move starts before the old instance is proven gone": Bounds(proves_stop=False, runs=2, reboots=0),
    "a host grants the fleet at once after a boot": Bounds(waits_after_boot=False, runs=2),
    "the managers share neither a host nor an etcd": Bounds(has_common_host=False, runs=2, reboots=0),
}


@pytest.mark.parametrize("bounds", [Bounds(runs=2), Bounds(uses_etcd=True)], ids=["hosts", "etcd"])
def test_every_state_of_a_small_fleet_is_safe(bounds: Bounds, tmp_path: Path) -> None:
    verdict = check_model(tmp_path, format_config(bounds))
    assert verdict.violated == ""
    assert verdict.states > 1_000


@pytest.mark.parametrize("rule", BROKEN)
def test_a_rule_that_is_missing_is_noticed(rule: str, tmp_path: Path) -> None:
    verdict = check_model(tmp_path, format_config(BROKEN[rule]))
    assert verdict.violated in INVARIANTS, verdict.text[-2000:]
