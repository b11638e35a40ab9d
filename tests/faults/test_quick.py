# SPDX-License-Identifier: Apache-2.0
"""Short form of the fault matrix: the most important faults, once each, on the cheapest hosts that support them."""

import os

import pytest

from tests.faults import fault_list
from tests.faults.fleet import EdgectlVariant
from tests.faults.registry import list_quick_cases, run_fault

CASES = {each.name: (each, kind) for each, kind in list_quick_cases() if fault_list.MODULES}


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", CASES)
def test_survived(name: str) -> None:
    row = run_fault(*CASES[name], 1, 1, EdgectlVariant(sample=True, points=1))
    if row.not_run:
        assert not (row.kind in ("namespace", "containers") and os.geteuid() == 0), f"root, but {row.not_run}"
        pytest.skip(f"{name} ({row.kind}): not run: {row.not_run}")
    assert row.good, "\n".join(row.failures)
