"""The short form of the fault matrix: the most important faults, once each, on the best available hosts."""

import os

import pytest

from tests.faults import matrix
from tests.faults.fleet import How
from tests.faults.registry import quick_cases, run

CASES = {each.name: (each, kind) for each, kind in quick_cases() if matrix.MODULES}


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", CASES)
def test_survived(name: str) -> None:
    row = run(*CASES[name], 1, 1, How(sample=True))
    if row.not_run:
        assert not (row.kind == "namespace" and os.geteuid() == 0), f"root, but {row.not_run}"
        pytest.skip(f"{name} ({row.kind}): not run: {row.not_run}")
    assert row.good, "\n".join(row.failures)
