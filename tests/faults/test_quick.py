"""The short form of the fault matrix: the most important faults, once each, three at a time, on the best hosts that can be had here."""

import os
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from tests.faults import matrix
from tests.faults.fleet import How
from tests.faults.registry import Row, quick_cases, run

CASES = {each.name: (each, kind) for each, kind in quick_cases() if matrix.MODULES}


@pytest.fixture(scope="module")
def rows() -> Iterator[dict[str, "Future[Row]"]]:
    with ThreadPoolExecutor(3) as pool:
        yield {name: pool.submit(run, each, kind, 1, 1, How(sample=True)) for name, (each, kind) in CASES.items()}
        pool.shutdown(cancel_futures=True)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", CASES)
def test_survived(rows: dict[str, "Future[Row]"], name: str) -> None:
    row = rows[name].result()
    if row.not_run:
        assert not (row.kind == "namespace" and os.geteuid() == 0), f"root, but {row.not_run}"
        pytest.skip(f"{name} ({row.kind}): not run: {row.not_run}")
    assert row.good, "\n".join(row.failures)
